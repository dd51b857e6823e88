"""The environment that a data set names: where its demonstrations were made, with observations as in the data set."""

from __future__ import annotations

from typing import Any, NamedTuple

import gymnasium

from magical_mj.demos.demonstration import Demonstration
from magical_mj.envs.registration import env_id, suite_id
from magical_mj.scene.bodies import GRIPPER
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import DemonstrationError


class Source(NamedTuple):
    """An environment by name: ``gymnasium.make(id, **kwargs)``, whose ``reset(seed=...)`` takes the scenes' seeds."""

    id: str
    kwargs: dict[str, Any]

    def make(self) -> gymnasium.Env[Any, Any]:
        """The environment."""
        return gymnasium.make(self.id, **self.kwargs)

    def __str__(self) -> str:
        return ", ".join([f'"{self.id}"', *(f"{name}={value!r}" for name, value in self.kwargs.items())])


def source_of(demo: Demonstration, preset: str, **settings: Any) -> Source:
    """The environment of a demonstration, with its body and its shifts.

    Args:
        demo: the demonstration.
        preset: the preset of the data set's observations.
        settings: what else `gymnasium.make` is to get.

    Raises:
        DemonstrationError: if the suite xmagical has no such observations.
    """
    body = demo.scene.robot.body
    if not task_spec(demo.task).speeds:
        facts = {"body": body if body != GRIPPER else "", "shifts": demo.shifts}
        kwargs = {name: value for name, value in facts.items() if value}
        return Source(env_id(demo.task, demo.variant, preset), {**kwargs, **settings})
    if preset != "State":
        raise DemonstrationError(f"data sets of {demo.task} have the preset State, not {preset or 'views'}")
    return Source(suite_id(body, demo.variant), {})
