"""Shimmy: dm_env environments as Gymnasium's, and a policy of stable-baselines3 in them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import magical_mj

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
    model.learn(1024)

    def act(states: Any) -> int:
        return int(model.predict({"state": np.reshape(states, env.observation_space["state"].shape)})[0])

    model.set_random_seed(0)
    ours = magical_mj.evaluate(act, tasks="MoveToRegion", variants="Demo", preset="State", episodes=5, jobs=1)
    model.set_random_seed(0)
    theirs = []
    for _ in range(5):
        (observation, _), over = env.reset(), False
        while not over:
            observation, reward, terminated, truncated, _ = env.step(act(observation["state"]))
            over = terminated or truncated
        theirs.append(reward)
    assert theirs == ours["score"].tolist()
    record_property("compared", "a demonstration; PPO of stable-baselines3, 1,024 steps in Demo")
    record_property("result", f"1.00, {np.mean(theirs):.2f} by both")
