"""What a task is, as data: the type that every task module fills in and that variants read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np

from magical_mj.scene import Scene

Rules = Literal["paper", "released"]
"""Whose scores: those of the paper's appendix, or those of the original's released code where it differs."""
RULES: Final[tuple[Rules, ...]] = get_args(Rules)

ScoreFunction = Callable[[Scene, Scene, Rules], float]
"""Initial scene, final scene, rules -> score in [0, 1]. Both must be scenes of the task with the same things in."""

AxisRule = Callable[[np.random.Generator, Scene], Scene]
"""Draws one attribute of a scene anew: its colours, its shapes or its counts.

A rule keeps the task's rules (`TaskSpec.check`) and leaves poses alone; blocks that a count rule adds may lie
anywhere, for they are placed afterwards. Only a block that belongs in a goal region must be in it.
"""


@dataclass(frozen=True, kw_only=True)
class TaskSpec:
    """One task: its demo scene, its score, and what its variants may change.

    A task supports the variation axes colour, shape and count exactly if it gives the rule for it.
    """

    name: str
    """As in the ids, such as ``"FindDupe"``."""
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

    colour: AxisRule | None = None
    shape: AxisRule | None = None
    count: AxisRule | None = None
    layout: bool = True
    """Whether poses may be drawn from the whole workspace."""
    region_size: tuple[float, float] = (0.0, 0.0)
    """Least and greatest height and width of the goal regions, in world units."""
    inner_margin: float = 0.0
    """How far, in world units, a layout keeps the centre of a block that belongs in a region from the sides
    of the largest square around the region's centre."""

    def horizon(self, rules: Rules = "paper") -> int:
        """The number of control steps of an episode."""
        if rules == "released" and self.released_steps is not None:
            return self.released_steps
        return self.steps
