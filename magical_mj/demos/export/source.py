"""The Gymnasium environment that a data set names: that of its demonstrations, with the same observations."""

from __future__ import annotations

from typing import Any, NamedTuple

import gymnasium

from magical_mj.demos.demonstration import Demonstration
from magical_mj.envs.registration import env_id, suite_id
from magical_mj.scene.bodies import GRIPPER
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import DemonstrationError


class Source(NamedTuple):
    """An environment ``gymnasium.make(id, **kwargs)``. Its ``reset(seed=...)`` accepts the seeds of the scenes."""

    id: str
    kwargs: dict[str, Any]

    def make(self) -> gymnasium.Env[Any, Any]:
        """Creates the environment."""
        return gymnasium.make(self.id, **self.kwargs)

    def __str__(self) -> str:
        return ", ".join([f'"{self.id}"', *(f"{name}={value!r}" for name, value in self.kwargs.items())])


def source_of(demo: Demonstration, preset: str, **settings: Any) -> Source:
    """The environment of a demonstration, with its body and its shifts.

    Args:
        demo: the demonstration.
        preset: the preset of the data set's observations.
        settings: further arguments of `gymnasium.make`.

    Raises:
        DemonstrationError: if the task is SweepToTop and the preset is not State.
    """
    body = demo.scene.robot.body
    if not task_spec(demo.task).speeds:
        facts = {"body": body if body != GRIPPER else "", "shifts": demo.shifts}
        kwargs = {name: value for name, value in facts.items() if value}
        return Source(env_id(demo.task, demo.variant, preset), {**kwargs, **settings})
    if preset != "State":
        raise DemonstrationError(f"data sets of {demo.task} must have the preset State, not {preset or 'views'}")
    return Source(suite_id(body, demo.variant), {})
