"""Additional suites: tasks with their own environments, experts and states.

An installed package announces a suite by an entry point, ``xmagical = "magical_mj.xmagical.suite:SUITE"``. A task of a
suite needs no checks, and has its name alone. Other packages announce single tasks: see `magical_mj.tasks.registry`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene import Scene
from magical_mj.tasks.spec import TaskSpec
from magical_mj.utils.errors import TaskError
from magical_mj.utils.imports import announced, imported

SUITE_GROUP: Final = "magical_mj.suites"
"""The entry-point group of suites."""


class Suite(Protocol):
    """What an entry point of `SUITE_GROUP` refers to."""

    @property
    def tasks(self) -> Mapping[str, TaskSpec]:
        """The tasks by name."""
        ...

    def register(self) -> None:
        """Registers the suite's Gymnasium ids."""
        ...

    def ids(self, task: str, variant: str) -> list[str]:
        """The ids of a task in a variant."""
        ...

    def state_id(self, task: str, variant: str, body: str) -> str:
        """The id of the environment whose observations are `state`."""
        ...

    def state(self, scene: Scene) -> NDArray[np.float32]:
        """The state vector of a scene."""
        ...

    def expert(self, engine: Any, seed: int) -> Callable[[], Any]:
        """The expert for an engine of one of the tasks: each call returns the action for the present state."""
        ...


@cache
def suites() -> Mapping[str, Suite]:
    """The announced suites by name."""
    points = announced("suite", SUITE_GROUP, ("magical",), str.isalnum, 'xmagical = "magical_mj.xmagical.suite:SUITE"')
    return {name: imported("suite", name, point, TaskError) for name, point in points.items()}


def suite_of(task: str) -> Suite | None:
    """The suite with this task. None for all other tasks."""
    return next((suite for suite in suites().values() if task in suite.tasks), None)
