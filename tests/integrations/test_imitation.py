"""imitation: its BC clones our demonstrations."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.libraries import EPISODES, compare, demonstrations

pytest.importorskip("imitation", reason="imitation is missing: make integrations-test LIBRARY=imitation")

from imitation.algorithms import bc
from imitation.data.types import Transitions
from imitation.util import logger
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import DummyVecEnv

import magical_mj

pytestmark = pytest.mark.filterwarnings("default")  # the library's own are not ours to mend


def test_bc_clones_and_scores_the_same_by_both_paths(
    record_property: Callable[[str, object], None], tmp_path: Path
) -> None:
    data, env = demonstrations(), magical_mj.MagicalEnv("MoveToRegion", "Demo", "State")
    transitions = Transitions(
        obs=data["observations"],
        acts=data["actions"].astype(np.int64),
        next_obs=data["next_observations"],
        dones=data["terminals"] | data["truncations"],
        infos=np.array([{}] * len(data["actions"])),
    )
    trainer = bc.BC(
        observation_space=env.observation_space,
        action_space=env.action_space,
        rng=np.random.default_rng(0),
        demonstrations=transitions,
        device="cpu",
        custom_logger=logger.configure(tmp_path, []),  # the usual one leaves a folder behind
    )
    trainer.train(n_epochs=100, progress_bar=False)
    compare(
        record_property,
        "BC on our arrays; scores by stable-baselines3's `evaluate_policy`",
        lambda env: evaluate_policy(
            trainer.policy, DummyVecEnv([lambda: env]), EPISODES, deterministic=True, return_episode_rewards=True
        )[0],
        lambda state: int(trainer.policy.predict(state, deterministic=True)[0]),
    )
