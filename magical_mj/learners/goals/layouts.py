"""Arrays of robot and block positions: of demonstrations, and random ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene import Scene
from magical_mj.tasks.planning.subgoals import REACHABLE

Floats = NDArray[np.float64]

SAMPLES: Final = 20_000


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
