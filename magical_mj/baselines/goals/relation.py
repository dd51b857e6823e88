"""What a relation is: something that the blocks, or the robot, may be more or less true to."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

from magical_mj.baselines.goals.layouts import Floats, Layouts
from magical_mj.planning import Noise, Subgoal
from magical_mj.scene import Scene

LIMIT_BITS: Final = 4.0
"""That it takes to say how far off still counts as true: to about one part in sixteen."""


@dataclass(frozen=True)
class Situation:
    """Where an episode is, on the way to a relation.

    Attributes:
        initial: the first scene.
        now: the present scene.
        limits: how far off still counts as true, one for each of the relation's measures.
        noise: which of several good ways it is.
        stuck: blocks that cannot be moved.
    """

    initial: Scene
    now: Scene
    limits: Sequence[float]
    noise: Noise
    stuck: Collection[int] = ()


@dataclass(frozen=True)
class Relation(ABC):
    """A relation between the things of a scene. Its fields are what it is saved as.

    How far a thing is off is 0 where the relation is perfect. How far off still counts as true is learnt: see `infer`.

    Attributes:
        measures: by how many measures things can be off, each of which has a limit.
    """

    measures: ClassVar[int] = 1

    @property
    @abstractmethod
    def bits(self) -> float:
        """The length of its description, learnt limits included."""

    @abstractmethod
    def off(self, layouts: Layouts) -> Floats:
        """How far each block, or the robot, is off, by each measure. Shape (n, things, measures)."""

    @abstractmethod
    def subgoals(self, at: Situation) -> list[Subgoal]:
        """What to move where so that nothing is too far off. What is stuck stays, if there is another way."""

    @property
    @abstractmethod
    def text(self) -> str:
        """The relation in English, with {0}, {1} for the limits of its measures."""


def choice(options: int) -> float:
    """The bits that it takes to name one of so many options."""
    return math.log2(options)
