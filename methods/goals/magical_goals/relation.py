"""The interface of relations, the possible goals; and the positions of robot and blocks that they measure."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene import Scene
from magical_mj.tasks.planning import REACHABLE, Noise, Subgoal

Floats = NDArray[np.float64]

SAMPLES: Final = 20_000
"""The number of random layouts for estimating the probability that a relation holds."""
LIMIT_BITS: Final = 4.0
"""The description length of a learnt limit, one of sixteen values."""


@dataclass(frozen=True)
class Layouts:
    """Positions of the robot and the blocks of a scene, n times.

    Attributes:
        initial: the initial scene of the episode.
        robot: shape (n, 2).
        blocks: shape (n, blocks, 2).
    """

    initial: Scene
    robot: Floats
    blocks: Floats


def layouts_of(initial: Scene, scenes: Sequence[Scene]) -> Layouts:
    """The positions in several scenes of one episode."""
    blocks = [[(block.x, block.y) for block in scene.blocks] for scene in scenes]
    return Layouts(
        initial,
        np.array([(scene.robot.x, scene.robot.y) for scene in scenes]),
        np.array(blocks, dtype=float).reshape(len(scenes), len(initial.blocks), 2),
    )


def random_layouts(initial: Scene, rng: np.random.Generator) -> Layouts:
    """Independent uniform positions of the robot and of all blocks."""
    robot = rng.uniform(-REACHABLE, REACHABLE, (SAMPLES, 2))
    return Layouts(initial, robot, rng.uniform(-REACHABLE, REACHABLE, (SAMPLES, len(initial.blocks), 2)))


@dataclass(frozen=True)
class Situation:
    """The arguments of subgoals.

    Attributes:
        initial: the first scene of the episode.
        now: the current scene.
        limits: the largest deviations that fulfil the relation, one for each measure.
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

    It is measured by deviations. They are 0 if it is fulfilled exactly. It holds if all deviations are within limits,
    which are learnt: see `infer`.

    Attributes:
        measures: the number of deviations of each block or of the robot.
    """

    measures: ClassVar[int] = 1

    @property
    @abstractmethod
    def bits(self) -> float:
        """The description length, including learnt limits."""

    @abstractmethod
    def deviations(self, layouts: Layouts) -> Floats:
        """The deviations of each block or of the robot. Shape (n, blocks or 1, measures)."""

    @abstractmethod
    def subgoals(self, at: Situation) -> list[Subgoal]:
        """The subgoals that make the relation hold. In lines and groups, stuck blocks stay, if possible."""

    @property
    @abstractmethod
    def text(self) -> str:
        """The relation in English, as a format string for the limits."""


def choice_bits(options: int) -> float:
    """The description length of one of several options."""
    return math.log2(options)
