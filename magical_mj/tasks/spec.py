"""The definition of a task as data: `TaskSpec`, which every task module makes and which variants read."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, get_args

import numpy as np

from magical_mj.scene import Scene
from magical_mj.scene.constants import ARENA_HALF_WIDTH
from magical_mj.tasks.planning import Noise, Subgoal
from magical_mj.utils.errors import TaskError, shown
from magical_mj.utils.imports import errors_of_task

Rules = Literal["paper", "released"]
"""Which scores and horizons: those of the paper's appendix, or of the original's released code where it differs."""
RULES: Final[tuple[Rules, ...]] = get_args(Rules)

Reward = Literal["none", "score"]
"""The reward of the last step: 0 as at all other steps, since the benchmark has no reward, or the score."""
REWARDS: Final[tuple[Reward, ...]] = get_args(Reward)

_ROUNDING: Final = 1e-9

Plan = Callable[[Scene, Scene, Noise], Iterable[Subgoal]]
"""(initial scene, present scene, noise) -> the remaining subgoals; called only if the task is not solved. An expert
calls it again whenever a block is not where it was expected. The noise selects one of several good plans."""

ScoreFunction = Callable[[Scene, Scene, Rules], float]
"""(initial scene, final scene, rules) -> score in [0, 1]. Both scenes have the same blocks and regions."""

AxisRule = Callable[[np.random.Generator, Scene], Scene]
"""Draws one attribute of a scene: its colours, its shapes or its counts.

The result must be a scene of the task (`TaskSpec.check`). Poses usually stay as they are. Blocks that a count rule adds
may have any pose, since they are placed afterwards; but a block that belongs in a goal region must be in it.
"""


@dataclass(frozen=True, kw_only=True)
class TaskSpec:
    """One task: its demo scene, its score, and what its variants may change.

    A task supports each of the axes colour, shape and count if it has a rule for it.
    """

    name: str
    """As in ids and file names, such as ``"FindDupe"``: letters and digits."""
    summary: str
    """The goal in one line, for tables."""
    demo: Scene
    """The one scene in which demonstrations start; blocks and regions in the original's order."""
    steps: int
    """The horizon under the paper's rules, in control steps."""
    released_steps: int | None = None
    """The horizon under the released code's rules, where it differs."""
    score: ScoreFunction
    """How well the final scene solves the task, in [0, 1]."""
    check: Callable[[Scene], None]
    """Raises `InvalidSceneError` unless the scene is one in which this task can start."""

    plan: Plan | None = None
    """The plan of the scripted expert. Without one, everything except the expert works."""
    demonstrations: Path | str | None = None
    """The folder of the demonstrations that another package ships for its task; learners are trained on them."""

    colour: AxisRule | None = None
    shape: AxisRule | None = None
    count: AxisRule | None = None
    layout: bool = True
    """Whether poses may be drawn from the whole workspace."""
    region_size: tuple[float, float] = (0.0, 0.0)
    """Least and greatest height and width of the goal regions, in world units."""
    inner_margin: float = 0.0
    """For what belongs in a region: the least distance (world units) that a layout keeps between its
    centre and the sides of the largest square around the region's centre."""

    def __post_init__(self) -> None:
        """Checks the types and ranges of all fields; raises `TaskError`."""
        if not is_task_name(self.name):
            raise TaskError(f"the name of a task must be made of letters and digits, not {shown(self.name)}")
        kinds = {"demo": Scene, "summary": str, "demonstrations": Path | str | None, "layout": bool}
        for part, kind in kinds.items():
            if not isinstance(getattr(self, part), kind):
                wanted = getattr(kind, "__name__", kind)
                raise TaskError(f"{self.name}.{part} must be a {wanted}, not {shown(getattr(self, part))}")
        for steps in (self.steps, self.steps if self.released_steps is None else self.released_steps):
            if type(steps) is not int or steps < 1:
                raise TaskError(f"the steps of {self.name} must be an integer above 0, not {shown(steps)}")
        low, high = self.region_size if _are_numbers(self.region_size, 2) else (1.0, 0.0)
        if not 0 <= low <= high <= 2 * ARENA_HALF_WIDTH or (self.demo.regions and not low):
            raise TaskError(
                f"{self.name}.region_size must be the least and greatest side of its goal regions, above 0, not "
                f"{shown(self.region_size)}"
            )
        sides = [side for region in self.demo.regions for side in (region.height, region.width)]
        if not all(low - _ROUNDING <= side <= high + _ROUNDING for side in sides):
            found = ", ".join(f"{side:g}" for side in sides)
            raise TaskError(f"{self.name}.region_size is {(low, high)}; the sides in its demo must be within: {found}")
        if self.count is not None and not self.layout:
            raise TaskError(f"{self.name}.count needs layouts, which place the blocks that it adds: omit layout=False")
        if not _are_numbers((self.inner_margin,), 1) or not (self.inner_margin == 0 or 0 < self.inner_margin < low / 2):
            raise TaskError(f"{self.name}.inner_margin must be 0, or less than half of the least side of its regions")
        for part in ("score", "check"):
            if not callable(getattr(self, part)):
                raise TaskError(f"{self.name}.{part} must be a function")
        for part in ("plan", "colour", "shape", "count"):
            if not (getattr(self, part) is None or callable(getattr(self, part))):
                raise TaskError(f"{self.name}.{part} must be a function, or None")

    def horizon(self, rules: Rules = "paper") -> int:
        """The number of control steps of an episode."""
        if rules == "released" and self.released_steps is not None:
            return self.released_steps
        return self.steps

    def checked_score(self, initial: Scene, final: Scene, rules: Rules) -> float:
        """What `score` returns, which must be a number in [0, 1] up to rounding; what rounding adds is cut off.

        Raises:
            TaskError: if it is anything else, or `score` raises an error that is not one of this package's.
        """
        with errors_of_task(f"{self.name}.score failed"):
            score: Any = self.score(initial, final, rules)
        if not isinstance(score, int | float | np.number) or not -_ROUNDING <= score <= 1.0 + _ROUNDING:
            raise TaskError(f"{self.name}.score must return a number in [0, 1], and returned {shown(score)}")
        return min(max(float(score), 0.0), 1.0)

    def subgoals(self, initial: Scene, now: Scene, noise: Noise, rules: Rules = "paper") -> tuple[Subgoal, ...]:
        """The remaining subgoals; none if the task is solved by these rules.

        Raises:
            TaskError: if the task has no plan, or it returns anything else, or raises an error that is not one of this
                package's.
        """
        plan = self.check_plan()
        if self.checked_score(initial, now, rules) == 1.0:
            return ()
        with errors_of_task(f"{self.name}.plan failed"):
            returned: Any = plan(initial, now, noise)
            todo = tuple(returned) if isinstance(returned, Iterable) else (returned,)  # a generator runs here
        for subgoal in todo:
            if not isinstance(subgoal, Subgoal) or subgoal.block not in (None, *range(len(now.blocks))):
                raise TaskError(
                    f"{self.name}.plan must return Subgoals of the robot (None) or of blocks 0 to "
                    f"{len(now.blocks) - 1}, and returned {shown(subgoal)}"
                )
            if not _is_point(subgoal.target):
                raise TaskError(f"targets are points (x, y), and {self.name}.plan returned {shown(subgoal)}")
        return todo

    def check_plan(self) -> Plan:
        """The plan; raises `TaskError` if there is none."""
        if self.plan is None:
            raise TaskError(f"{self.name} has no plan, so no expert can play it; give its TaskSpec one")
        return self.plan


def is_task_name(name: Any) -> bool:
    """Whether tasks may be called so: letters and digits, as ids and names of files need."""
    return isinstance(name, str) and name.isascii() and name.isalnum()


def _are_numbers(values: Any, count: int) -> bool:
    return isinstance(values, tuple | list) and len(values) == count and all(isinstance(x, int | float) for x in values)


def _is_point(target: Any) -> bool:
    try:
        found = np.asarray(target, float)
    except (TypeError, ValueError):
        return False
    return found.shape == (2,) and bool(np.isfinite(found).all())
