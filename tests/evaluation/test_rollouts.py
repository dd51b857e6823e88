"""Episodes in environments of one's own, single and side by side."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

from magical_mj.evaluation import Episode, rollouts
from magical_mj.utils.errors import EvaluationError
from tests.helpers import agents
from tests.helpers.agents import Acting


def test_episodes_may_come_one_by_one_and_must_be_of_the_environment() -> None:
    name = "magical_mj/MoveToRegion-Demo-State-v0"
    several = SyncVectorEnv([lambda: gymnasium.make(name)], autoreset_mode=AutoresetMode.DISABLED)
    for env in (gymnasium.make(name), several):
        outcomes = list(rollouts(env, Acting(lambda _: 1), (Episode("MoveToRegion", "Demo", seed) for seed in (0, 1))))
        assert [len(outcome.actions) for outcome in outcomes] == [40, 40]
        with pytest.raises(EvaluationError, match="the environment is MoveToRegion Demo, and an episode MoveToCorner"):
            list(rollouts(env, Acting(lambda _: 1), [Episode("MoveToCorner", "Demo", 0)]))
        env.close()


@pytest.mark.parametrize("mode", AutoresetMode)
def test_vector_environments_in_every_autoreset_mode(mode: AutoresetMode) -> None:
    name = "magical_mj:magical_mj/MoveToRegion-TestLayout-State-v0"
    episodes = [Episode("MoveToRegion", "Layout", seed) for seed in range(5)]
    processes = mode == AutoresetMode.NEXT_STEP  # each of their own
    kwargs: dict[str, Any] = {"autoreset_mode": mode, **({"context": "spawn"} if processes else {})}
    envs = gymnasium.make_vec(name, 2, "async" if processes else "sync", vector_kwargs=kwargs)
    assert isinstance(envs, SyncVectorEnv | AsyncVectorEnv)
    results = {policy: list(rollouts(envs, policy(), episodes)) for policy in (agents.Counting, agents.Batch)}
    envs.close()
    for policy, side_by_side in results.items():
        plain = list(rollouts(gymnasium.make(name), policy(), episodes))
        assert [(r.key, r.score, r.actions, r.failure) for r in side_by_side] == [
            (r.key, r.score, r.actions, None) for r in plain
        ]


def test_results_do_not_depend_on_the_callers_floating_point_settings() -> None:
    name, episodes = "magical_mj/FindDupe-Demo-State-v0", [Episode("FindDupe", "Demo", seed) for seed in range(4)]
    env = gymnasium.make(name)
    usual = [(r.score, r.actions, r.failure) for r in rollouts(env, agents.Counting(), episodes)]
    with np.errstate(all="raise"):
        assert [(r.score, r.actions, r.failure) for r in rollouts(env, agents.Counting(), episodes)] == usual
    assert {failure for _, _, failure in usual} == {None}
    env.close()
