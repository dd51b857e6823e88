"""Helpers for tests of other libraries: data to clone from, and one policy's scores by both paths."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

import magical_mj
from magical_mj.actions import NOOP
from magical_mj.datasets import make_env_and_datasets

TASK, VARIANTS = "MoveToRegion", ("Jitter", "All")
"""Policies solve Jitter, and only some scenes of All, so that a comparison also shows whether scenes are mixed up."""
EPISODES = 10
LEARNT = 0.5
"""A cloned policy scores more. Doing nothing scores 0."""


def demonstrations() -> dict[str, NDArray[Any]]:
    """The task's training demonstrations, without the steps with the no-op: policies that clone these stop moving."""
    env, training, _ = make_env_and_datasets(f"magical_mj/{TASK}-Demo-State-v0")
    env.close()
    moving = (training["actions"] != NOOP) | training["truncations"]
    return {name: values[moving] for name, values in training.items()}


class Numbered(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Resets to the scenes of seeds 0, 1, 2..., those of evaluations, for libraries that choose no seeds."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        self._next = 0

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        del seed
        self._next += 1
        return super().reset(seed=self._next - 1, options=options)


def returns(env: gymnasium.Env[Any, Any], policy: Callable[[Any], Any]) -> float:
    """The return of an episode in a plain loop."""
    (observation, _), total, over = env.reset(), 0.0, False
    while not over:
        observation, reward, terminated, truncated, _ = env.step(policy(observation))
        total, over = total + float(reward), terminated or truncated
    return total


def compare(
    record: Callable[[str, object], None],
    what: str,
    theirs: Callable[[gymnasium.Env[Any, Any]], Any],
    policy: Callable[[Any], Any],
    least: float = LEARNT,
) -> None:
    """Checks that a policy has the same score in each scene by a library's own way and by `magical_mj.evaluate`.

    Args:
        record: pytest's `record_property`, which keeps the result for the table in docs/integrations.md.
        what: what was trained and compared.
        theirs: a function from an environment to the returns of `EPISODES` episodes, which are the scores.
        policy: the policy, from states to actions.
        least: the least mean score in Jitter.
    """
    means: dict[str, float] = {}
    for variant in VARIANTS:
        env = Numbered(gymnasium.make(f"magical_mj/{TASK}-Test{variant}-State-v0", reward="score"))
        where = {"tasks": TASK, "variants": variant, "preset": "State", "episodes": EPISODES, "jobs": 1}
        ours = magical_mj.evaluate(policy, **where)["score"]
        np.testing.assert_allclose(np.asarray(theirs(env), float), ours, atol=1e-6)
        means[variant] = float(ours.mean())
        env.close()
    assert means["Jitter"] >= least
    record("compared", what)
    record("result", ", ".join(f"{variant} {mean:.2f}" for variant, mean in means.items()) + " by both")
