"""Many places of the same things at once: where they are in demonstrations, and where chance would put them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.planning.subgoals import REACHABLE
from magical_mj.scene import Scene

Floats = NDArray[np.float64]

SAMPLES: Final = 20_000


@dataclass(frozen=True)
class Layouts:
    """Where the robot and the blocks of one initial scene are in each of n situations.

    Attributes:
        initial: what there is, and where it was when the episode began.
        robot: shape (n, 2).
        blocks: shape (n, blocks, 2).
    """

    initial: Scene
    robot: Floats
    blocks: Floats


def layouts_of(initial: Scene, scenes: Sequence[Scene]) -> Layouts:
    """The places in scenes of an episode."""
    blocks = [[(block.x, block.y) for block in scene.blocks] for scene in scenes]
    return Layouts(
        initial,
        np.array([(scene.robot.x, scene.robot.y) for scene in scenes]),
        np.array(blocks, dtype=float).reshape(len(scenes), len(initial.blocks), 2),
    )


def by_chance(initial: Scene, rng: np.random.Generator) -> Layouts:
    """The robot and all blocks anywhere, each by itself: what a scene looks like of which nobody wanted anything."""
    robot = rng.uniform(-REACHABLE, REACHABLE, (SAMPLES, 2))
    return Layouts(initial, robot, rng.uniform(-REACHABLE, REACHABLE, (SAMPLES, len(initial.blocks), 2)))
