"""Batch policies, and checks whether a policy fits the environments in which it shall be evaluated."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Protocol, runtime_checkable

from magical_mj.envs.presets import PRESETS
from magical_mj.policies.interface import Episode, uses_simulation
from magical_mj.tasks.registry import Pair, task_spec
from magical_mj.utils.errors import SettingsError

Shape = tuple[int | None, ...]
"""The shape of an observation; None stands for any size."""


@runtime_checkable
class BatchPolicy(Protocol):
    """An agent that acts in several episodes at once; used with vector environments."""

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Called before the episodes, which start together."""

    def act_batch(self, observations: Any) -> Sequence[Any]:
        """An action for each environment, given the stacked observations of the vector environment."""
        ...


def check_fit(policy: object, pairs: Sequence[Pair], preset: str) -> None:
    """Raises a `SettingsError` if the policy's attributes say that it was trained for something else.

    A `TaskError` is raised if it needs a plan, and a task has none.

    Args:
        policy: the policy; its attributes `preset`, `tasks`, `observation_shapes` and `needs_plan` are checked if they
            exist.
        pairs: pairs of task and variant.
        preset: the preset of the observations.
    """
    if getattr(policy, "needs_plan", False):
        for task, _ in pairs:
            task_spec(task).check_plan()
    made_for = getattr(policy, "preset", preset)
    if made_for != preset:
        raise SettingsError(f"the policy was trained on the preset {made_for}, not {preset}: give --preset {made_for}")
    tasks = getattr(policy, "tasks", None)
    tasks = (tasks,) if isinstance(tasks, str) else tasks
    others = sorted({task for task, _ in pairs} - set(tasks)) if tasks is not None else []
    if others:
        raise SettingsError(f"the policy cannot act in {', '.join(others)}: give --tasks {','.join(tasks or ())}")
    shapes: Iterable[Shape] | None = getattr(policy, "observation_shapes", None)
    if shapes is not None and not uses_simulation(policy):
        _check_shape(list(shapes), pairs[0][0], preset)


def _check_shape(wanted: Sequence[Shape], task: str, preset: str) -> None:
    """Raises a `SettingsError` unless observations of the preset have one of these shapes."""
    if _fits(wanted, _shape(task, preset)):
        return
    others = [name for name in PRESETS if _fits(wanted, _shape(task, name))]
    remedy = f"give --preset {' or '.join(others)}" if others else "no preset has such observations"
    given = _shape(task, preset) or "a dict"
    raise SettingsError(f"the policy takes observations of shape {wanted[0]}, and {preset} gives {given}: {remedy}")


def _shape(task: str, preset: str) -> tuple[int, ...] | None:
    """The shape of the preset's observations; None if they are dicts."""
    from magical_mj.envs.gymnasium_env import MagicalEnv  # imported late: it loads the simulator

    env = MagicalEnv(task, preset=preset)
    env.close()
    return env.observation_space.shape


def _fits(wanted: Sequence[Shape], given: tuple[int, ...] | None) -> bool:
    return given is not None and any(
        len(shape) == len(given) and all(size in (None, real) for size, real in zip(shape, given, strict=True))
        for shape in wanted
    )
