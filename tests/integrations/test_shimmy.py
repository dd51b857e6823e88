"""Shimmy: dm_env environments as Gymnasium's, and a policy of stable-baselines3 in them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import magical_mj
from magical_mj.actions import NOOP
from tests.helpers.cloning import cloned, network
from tests.helpers.libraries import demonstrations

pytest.importorskip("shimmy", reason="shimmy is missing: make integrations-test LIBRARY=shimmy")

from shimmy.dm_control_compatibility import DmControlCompatibilityV0
from stable_baselines3 import PPO
from stable_baselines3.common.logger import configure

pytestmark = pytest.mark.filterwarnings("default")  # the library's own are not ours to mend


def test_demonstrations_and_a_trained_policy_score_the_same(
    record_property: Callable[[str, object], None], tmp_path: Path
) -> None:
    """In the demo scene, since its resets do not draw the scenes of seeds."""
    env = DmControlCompatibilityV0(magical_mj.load("MoveToRegion", observations=("state",), reward="score"))
    demonstration = magical_mj.demos.load("MoveToRegion")[0]
    observation, _ = env.reset(seed=0)
    wanted = magical_mj.demos.observations(demonstration, "State")
    for number, action in enumerate(demonstration.actions):
        np.testing.assert_allclose(np.ravel(observation["state"]), wanted[number], atol=1e-6)
        observation, reward, *_ = env.step(int(action))
    assert reward == demonstration.score == 1.0
    model: Any = PPO("MultiInputPolicy", env, n_steps=128, seed=0, device="cpu")
    model.set_logger(configure(str(tmp_path), []))  # the usual one leaves a folder behind
    model.learn(512)
    data = demonstrations()
    draw = torch.Generator().manual_seed(0)
    samples = (torch.randint(len(data["actions"]), (64,), generator=draw).numpy() for _ in range(1500))
    rows = ((torch.from_numpy(data["observations"][one]), torch.from_numpy(data["actions"][one])) for one in samples)
    act = cloned(rows, network(data["observations"].shape[1]))
    scores = []
    for acts in (act, lambda _: NOOP):
        (score,) = magical_mj.evaluate(acts, tasks="MoveToRegion", preset="State", variants="Demo", episodes=1, jobs=1)[
            "score"
        ]
        (observation, _), reward, over = env.reset(), 0.0, False
        while not over:
            observation, reward, terminated, truncated, _ = env.step(acts(np.ravel(observation["state"])))
            over = terminated or truncated
        assert reward == score
        scores.append(score)
    assert scores == [1.0, 0.0]
    record_property("compared", "a demonstration, PPO of stable-baselines3, a cloned network and no-op, in Demo")
    record_property("result", "1.00 and 0.00 by both")
