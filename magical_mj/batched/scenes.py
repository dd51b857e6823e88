"""Scenes as arrays, a row for each world: what the physics, the pictures and the scores of a batch are made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.region import DASHES, dash_quads
from magical_mj.scene import Scene
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.scene.state_vector import MAX_BLOCKS, MAX_REGIONS
from magical_mj.tasks.registry import Pair, sample_scene, task_spec
from magical_mj.utils.errors import InvalidSceneError
from magical_mj.variants import varied_axes

ABSENT: Final = -1
"""The shape of a block, and the colour of a region, that a world does not have."""


@dataclass(frozen=True)
class Capacity:
    """How much the worlds of a batch can hold; at least one of each, for empty arrays have no place in memory.

    Attributes:
        blocks: slots for blocks.
        regions: slots for goal regions.
    """

    blocks: int
    regions: int

    @classmethod
    def of(cls, scenes: Sequence[Scene]) -> Capacity:
        """What these scenes need."""
        return cls(
            blocks=max(1, *(len(scene.blocks) for scene in scenes)),
            regions=max(1, *(len(scene.regions) for scene in scenes)),
        )

    @classmethod
    def of_environments(cls, pairs: Sequence[Pair]) -> Capacity:
        """What all scenes of these environments need."""
        if any("count" in varied_axes(task_spec(task), variant) for task, variant in pairs):
            return cls(MAX_BLOCKS, MAX_REGIONS)
        return cls.of([sample_scene(task, "Demo", 0) for task in dict.fromkeys(task for task, _ in pairs)])


@dataclass(frozen=True)
class SceneArrays:
    """One row for each world; slots beyond a scene's blocks and regions are `ABSENT` and hold zeros.

    Attributes:
        poses: x, y, angle of the robot and then of each block. Shape (worlds, 1 + blocks, 3).
        fingers: angles of the left and the right finger. Shape (worlds, 2).
        shapes: indices into `SHAPES`. Shape (worlds, blocks).
        colours: indices into `COLOURS`. Shape (worlds, blocks).
        regions: x_min, y_min, x_max, y_max. Shape (worlds, regions, 4).
        region_colours: indices into `COLOURS`. Shape (worlds, regions).
        dashes: the rectangles of each region's border, likewise. Shape (worlds, regions, DASHES, 4).
        dynamics: the five force caps, in the order of `Dynamics`. Shape (worlds, 5).
    """

    poses: NDArray[np.float64]
    fingers: NDArray[np.float64]
    shapes: NDArray[np.int32]
    colours: NDArray[np.int32]
    regions: NDArray[np.float64]
    region_colours: NDArray[np.int32]
    dashes: NDArray[np.float32]
    dynamics: NDArray[np.float64]

    @classmethod
    def of(cls, scenes: Sequence[Scene], capacity: Capacity) -> SceneArrays:
        """The arrays of these scenes.

        Raises:
            InvalidSceneError: if a scene holds more than the capacity.
        """
        count, (blocks, regions) = len(scenes), astuple(capacity)
        made = cls(
            poses=np.zeros((count, 1 + blocks, 3)),
            fingers=np.array([scene.robot.fingers for scene in scenes]),
            shapes=np.full((count, blocks), ABSENT, np.int32),
            colours=np.zeros((count, blocks), np.int32),
            regions=np.zeros((count, regions, 4)),
            region_colours=np.full((count, regions), ABSENT, np.int32),
            dashes=np.zeros((count, regions, DASHES, 4), np.float32),
            dynamics=np.array([astuple(scene.dynamics) for scene in scenes]),
        )
        for world, scene in enumerate(scenes):
            need = Capacity.of([scene])
            if need.blocks > blocks or need.regions > regions:
                raise InvalidSceneError(f"a scene with {need} does not fit in worlds of {capacity}")
            made._fill(world, scene)
        return made

    def _fill(self, world: int, scene: Scene) -> None:
        self.poses[world, 0] = scene.robot.pose
        for slot, block in enumerate(scene.blocks):
            self.poses[world, 1 + slot] = block.pose
            self.shapes[world, slot] = SHAPES.index(block.shape)
            self.colours[world, slot] = COLOURS.index(block.colour)
        for slot, region in enumerate(scene.regions):
            self.regions[world, slot] = region.x_min, region.y_min, region.x_max, region.y_max
            self.region_colours[world, slot] = COLOURS.index(region.colour)
            quads = dash_quads(region)  # rectangles along the axes
            self.dashes[world, slot, : len(quads)] = np.concatenate([quads.min(axis=1), quads.max(axis=1)], axis=1)

    def rows(self, worlds: NDArray[np.int64]) -> SceneArrays:
        """The scenes of these worlds."""
        return SceneArrays(*(getattr(self, entry.name)[worlds] for entry in fields(self)))

    def write(self, other: SceneArrays, worlds: NDArray[np.int64]) -> None:
        """Put other scenes into these worlds."""
        for entry in fields(self):
            getattr(self, entry.name)[worlds] = getattr(other, entry.name)
