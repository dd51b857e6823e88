"""The interface of relations, the possible goals."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

from magical_mj.learners.goals.layouts import Floats, Layouts
from magical_mj.scene import Scene
from magical_mj.tasks.planning import Noise, Subgoal

LIMIT_BITS: Final = 4.0
"""The description length of a learnt limit: one of sixteen values."""


@dataclass(frozen=True)
class Situation:
    """What subgoals are computed from.

    Attributes:
        initial: the first scene of the episode.
        now: the present scene.
        limits: the largest deviations at which the relation holds, one for each measure.
        noise: selects one of several good sets of subgoals.
        stuck: blocks that lines and groups should not move.
    """

    initial: Scene
    now: Scene
    limits: Sequence[float]
    noise: Noise
    stuck: Collection[int] = ()


@dataclass(frozen=True)
class Relation(ABC):
    """A relation that each block, or the robot, can fulfil. Its fields are saved in goals.json.

    It is measured by deviations, which are 0 if it is fulfilled exactly. It holds if all deviations are within limits,
    which are learnt: see `infer`.

    Attributes:
        measures: the number of deviations of each block or of the robot.
    """

    measures: ClassVar[int] = 1

    @property
    @abstractmethod
    def bits(self) -> float:
        """The description length, learnt limits included."""

    @abstractmethod
    def deviations(self, layouts: Layouts) -> Floats:
        """The deviations of each block or of the robot. Shape (n, blocks or 1, measures)."""

    @abstractmethod
    def subgoals(self, at: Situation) -> list[Subgoal]:
        """What to move where so that the relation holds; in lines and groups, stuck blocks stay, if possible."""

    @property
    @abstractmethod
    def text(self) -> str:
        """The relation in English, a format string for the limits."""


def choice_bits(options: int) -> float:
    """The description length of one of several options."""
    return math.log2(options)
