"""Episodes in environments of one's own, single and side by side."""

from __future__ import annotations

from typing import Any

import gymnasium
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

from magical_mj.evaluation import Episode, rollouts
from magical_mj.utils.errors import EvaluationError
from tests.helpers import agents


def test_episodes_may_come_one_by_one_and_must_be_of_the_environment() -> None:
    name = "magical_mj/MoveToRegion-Demo-State-v0"
    several = SyncVectorEnv([lambda: gymnasium.make(name)], autoreset_mode=AutoresetMode.DISABLED)
    for env in (gymnasium.make(name), several):
        outcomes = list(rollouts(env, agents.Constant(1), (Episode("MoveToRegion", "Demo", seed) for seed in (0, 1))))
        assert [len(outcome.actions) for outcome in outcomes] == [40, 40]
        with pytest.raises(EvaluationError, match="the environment is MoveToRegion Demo, and an episode MoveToCorner"):
            list(rollouts(env, agents.Constant(1), [Episode("MoveToCorner", "Demo", 0)]))
        env.close()


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("kind", ["sync", "async"])
def test_vector_environments_in_every_autoreset_mode(kind: str, mode: AutoresetMode) -> None:
    name = "magical_mj:magical_mj/MoveToRegion-TestLayout-State-v0"
    kwargs: dict[str, Any] = {"autoreset_mode": mode}
    if kind == "async":
        kwargs["context"] = "spawn"
    envs = gymnasium.make_vec(name, 2, kind, vector_kwargs=kwargs)
    assert isinstance(envs, SyncVectorEnv | AsyncVectorEnv)
    episodes = [Episode("MoveToRegion", "Layout", seed) for seed in range(5)]
    found = {policy: list(rollouts(envs, policy(), episodes)) for policy in (agents.Counting, agents.Batch)}
    envs.close()
    for policy, outcomes in found.items():
        plain = list(rollouts(gymnasium.make(name), policy(), episodes))
        assert [(o.score, o.actions, o.failure) for o in outcomes] == [(o.score, o.actions, None) for o in plain]
