"""Scenes as arrays with any leading axes, of numpy or torch: what scores of one scene or of thousands are made from.

The formulas of scores use operators, methods and functions that numpy and torch share under the same names, with axes
by position, such as ``mask.any(-1)`` or ``namespace(x).where(mask, x, 0.0)``.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final, Self

import numpy as np

from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.scene.scene import Scene
from magical_mj.utils.errors import InvalidSceneError

Array = Any
"""An array of numpy or a tensor of torch."""

ABSENT: Final = -1
"""The shape of a block, and the colour of a region, that a scene does not have."""


@dataclass(frozen=True)
class SceneArrays:
    """One scene or many, each with as many slots for blocks and regions; unused slots are `ABSENT` and hold zeros.

    Attributes:
        poses: x, y, angle of the robot and then of each block. Shape (..., 1 + blocks, 3), float64.
        shapes: indices into `SHAPES`. Shape (..., blocks).
        colours: indices into `COLOURS`. Shape (..., blocks).
        regions: x_min, y_min, x_max, y_max. Shape (..., regions, 4), float64.
        region_colours: indices into `COLOURS`. Shape (..., regions).
    """

    poses: Array
    shapes: Array
    colours: Array
    regions: Array
    region_colours: Array

    @classmethod
    def empty(cls, scenes: int, blocks: int, regions: int) -> SceneArrays:
        """Numpy's arrays with one leading axis, whose slots are all unused."""
        return SceneArrays(
            poses=np.zeros((scenes, 1 + blocks, 3)),
            shapes=np.full((scenes, blocks), ABSENT, np.int32),
            colours=np.zeros((scenes, blocks), np.int32),
            regions=np.zeros((scenes, regions, 4)),
            region_colours=np.full((scenes, regions), ABSENT, np.int32),
        )

    @classmethod
    def of(cls, scenes: Sequence[Scene], blocks: int, regions: int) -> SceneArrays:
        """These scenes along one leading axis, in numpy's arrays with so many slots.

        Raises:
            InvalidSceneError: if a scene has more blocks or regions.
        """
        arrays = cls.empty(len(scenes), blocks, regions)
        for row, scene in enumerate(scenes):
            number, areas = len(scene.blocks), len(scene.regions)
            if number > blocks or areas > regions:
                raise InvalidSceneError(
                    f"a scene with {number} blocks and {areas} regions does not fit in {blocks} and {regions} slots"
                )
            single = cls.of_one(scene)
            arrays.poses[row, : 1 + number] = single.poses
            arrays.shapes[row, :number], arrays.colours[row, :number] = single.shapes, single.colours
            arrays.regions[row, :areas], arrays.region_colours[row, :areas] = single.regions, single.region_colours
        return arrays

    @classmethod
    def of_one(cls, scene: Scene) -> SceneArrays:
        """This scene in numpy's arrays without leading axes."""
        blocks, regions = scene.blocks, scene.regions
        boxes = [(region.x_min, region.y_min, region.x_max, region.y_max) for region in regions]
        return SceneArrays(
            poses=np.array([scene.robot.pose, *(block.pose for block in blocks)]),
            shapes=np.array([SHAPES.index(block.shape) for block in blocks], np.int32),
            colours=np.array([COLOURS.index(block.colour) for block in blocks], np.int32),
            regions=np.array(boxes, np.float64).reshape(-1, 4),
            region_colours=np.array([COLOURS.index(region.colour) for region in regions], np.int32),
        )

    def __getitem__(self, index: Any) -> Self:
        """The same part of all arrays, such as some rows of a batch."""
        return replace(self, **{entry.name: getattr(self, entry.name)[index] for entry in fields(self)})

    @property
    def robot(self) -> Array:
        """x, y of the robot. Shape (..., 2)."""
        return self.poses[..., 0, :2]

    @property
    def blocks(self) -> Array:
        """x, y of each block. Shape (..., blocks, 2)."""
        return self.poses[..., 1:, :2]

    @property
    def present(self) -> Array:
        """Which slots hold a block. Shape (..., blocks), bool."""
        return self.shapes != ABSENT

    @property
    def has_region(self) -> Array:
        """Which slots hold a region. Shape (..., regions), bool."""
        return self.region_colours != ABSENT

    @property
    def inside(self) -> Array:
        """Which regions the centres of which blocks are in, borders included. Shape (..., regions, blocks), bool."""
        within = _within(self.regions[..., None, :], self.blocks[..., None, :, :])
        return within & self.present[..., None, :] & self.has_region[..., None]

    @property
    def robot_inside(self) -> Array:
        """Which regions the robot's centre is in, borders included. Shape (..., regions), bool."""
        return _within(self.regions, self.robot[..., None, :]) & self.has_region


def _within(boxes: Array, points: Array) -> Array:
    """Whether points (..., 2) are in boxes (..., 4)."""
    x, y = points[..., 0], points[..., 1]
    return (boxes[..., 0] <= x) & (x <= boxes[..., 2]) & (boxes[..., 1] <= y) & (y <= boxes[..., 3])


def namespace(array: Array) -> Any:
    """The module with the functions for this array: numpy or torch."""
    return np if isinstance(array, np.ndarray | np.generic) else sys.modules["torch"]  # loaded, since there is a tensor


def number_of(mask: Array) -> Array:
    """How many are true along the last axis, as float64: torch divides integers in single precision."""
    return mask.sum(-1, dtype=namespace(mask).float64)


_hypot: Final = np.frompyfunc(math.hypot, 2, 1)


def length(x: Array, y: Array) -> Array:
    """The length of vectors. On numpy's arrays as `math.hypot` rounds it: recorded scores depend on the last digit."""
    if namespace(x) is np:
        return np.asarray(_hypot(x, y), np.float64)
    return namespace(x).hypot(x, y)
