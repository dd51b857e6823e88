"""Scripted experts that solve every environment from the privileged state.

An expert reads the true state of the simulation, tries manoeuvres on a copy of it, and acts with the same 18 actions as
every other agent; SweepToTop's expert uses its continuous ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from magical_mj.engine import Engine
from magical_mj.policies.expert.goals import GoalPicture
from magical_mj.policies.expert.planner import Expert
from magical_mj.policies.expert.sweeping import Sweeper
from magical_mj.tasks.registry import task_spec

__all__ = ["Expert", "GoalPicture", "Sweeper", "expert_of"]


def expert_of(env: Engine, task: str, seed: int) -> Callable[[], Any]:
    """The expert of a task: each call gives the action for the engine's present state.

    Raises:
        TaskError: if it has none.
    """
    return Sweeper(env, seed) if task_spec(task).speeds else Expert(env, task, seed)
