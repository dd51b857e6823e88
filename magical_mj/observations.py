"""Observations: the names of the views, and the state vector.

The state vector has the same length in every environment. Entries of missing blocks and regions are 0. On request, the
poses at the start of the episode follow.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene import Scene
from magical_mj.scene.bodies import body_named
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.utils.errors import InvalidSceneError

__all__ = [
    "CAMERAS",
    "MAX_BLOCKS",
    "MAX_REGIONS",
    "OBSERVATIONS",
    "SEGMENTATIONS",
    "SOLID_VIEW",
    "START_NAMES",
    "STATE_NAMES",
    "VIEWS",
    "StateEncoder",
]

Rows = NDArray[np.float64]

VIEWS: Final = ("ego", "allo")
"""The two views of the benchmark, both from above. "ego" moves and turns with the robot, "allo" shows the workspace."""

SOLID_VIEW: Final = "scene"
"""The name of the view for people: the scene in 3-D with lights and shadows, seen from above a corner."""

SEGMENTATIONS: Final = tuple(f"{view}-segmentation" for view in VIEWS)
"""The class of each pixel in the two views, as one number (`magical_mj.rendering.software`)."""

CAMERAS: Final = (*VIEWS, SOLID_VIEW)
"""The colour views of `render`."""

OBSERVATIONS: Final = (*VIEWS, "ego_stack", "allo_stack", "state")
"""The names that `magical_mj.load(observations=...)` accepts."""

MAX_BLOCKS: Final = 10
MAX_REGIONS: Final = 3

_POSE = ("x", "y", "angle")
_ROBOT = (*_POSE, *(f"{name}_velocity" for name in _POSE), "left_finger", "right_finger")
_BLOCK = ("present", *_POSE, *(f"{name}_velocity" for name in _POSE), *SHAPES, *COLOURS)
_REGION = ("present", "x_min", "y_min", "x_max", "y_max", *COLOURS)

STATE_NAMES: Final[tuple[str, ...]] = (
    *(f"robot.{name}" for name in _ROBOT),
    *(f"block{index}.{name}" for index in range(MAX_BLOCKS) for name in _BLOCK),
    *(f"region{index}.{name}" for index in range(MAX_REGIONS) for name in _REGION),
)
"""The name of each entry of the state vector, such as ``"block3.x_velocity"`` or ``"region0.red"``.

World units, rad, units/s and rad/s; colours and shapes are one-hot; angles are not wrapped.
"""

START_NAMES: Final[tuple[str, ...]] = tuple(
    f"start.{part}.{name}" for part in ("robot", *(f"block{index}" for index in range(MAX_BLOCKS))) for name in _POSE
)
"""The names of the entries after those of `STATE_NAMES` in the preset StateStart: the poses in the initial scene."""

FINGERS: Final = slice(STATE_NAMES.index("robot.left_finger"), STATE_NAMES.index("robot.right_finger") + 1)
"""The indices of the two fingers' angles in the state vector."""


_BLOCKS: Final = slice(len(_ROBOT), len(_ROBOT) + MAX_BLOCKS * len(_BLOCK))


class StateEncoder:
    """Computes the state vectors of one episode. With `start`, the poses of the initial scene follow in the vector.

    Raises an `InvalidSceneError` if the scene has more blocks or regions than the vector.

    Attributes:
        fixed: the constant entries; the others are 0. Shape (len(STATE_NAMES),), or with a start (len(STATE_NAMES) +
            len(START_NAMES),).
    """

    def __init__(self, scene: Scene, *, start: bool = False) -> None:
        if len(scene.blocks) > MAX_BLOCKS or len(scene.regions) > MAX_REGIONS:
            raise InvalidSceneError(
                f"the state vector has entries for {MAX_BLOCKS} blocks and {MAX_REGIONS} regions, but this scene has "
                f"{len(scene.blocks)} and {len(scene.regions)}; use pictures as observations, or a smaller scene"
            )
        self._count = len(scene.blocks)
        self.fixed = np.zeros(len(STATE_NAMES) + start * len(START_NAMES), dtype=np.float32)
        if not body_named(scene.robot.body).fingers:
            self.fixed[FINGERS] = scene.robot.fingers
        if start:
            poses = self.fixed[len(STATE_NAMES) :].reshape(-1, len(_POSE))
            poses[: 1 + len(scene.blocks)] = [scene.robot.pose, *(block.pose for block in scene.blocks)]
        blocks = self.fixed[_BLOCKS].reshape(MAX_BLOCKS, -1)
        regions = self.fixed[len(_ROBOT) + blocks.size : len(STATE_NAMES)].reshape(MAX_REGIONS, len(_REGION))
        for row, block in zip(blocks, scene.blocks, strict=False):
            row[[0, _BLOCK.index(block.shape), _BLOCK.index(block.colour)]] = 1.0
        for row, region in zip(regions, scene.regions, strict=False):
            row[:5] = (1.0, *region.box)
            row[_REGION.index(region.colour)] = 1.0

    @np.errstate(all="ignore")  # numbers that are too small for float32 become 0
    def __call__(self, poses: Rows, velocities: Rows, fingers: Rows) -> NDArray[np.float32]:
        """The state as a new vector, of the shape of `fixed`.

        Args:
            poses: x, y, angle of the robot and then of each block, shape (1 + blocks, 3).
            velocities: the velocities of `poses`, in units/s and rad/s, shape (1 + blocks, 3).
            fingers: angles of the left and the right finger, shape (2,); without fingers (0,).
        """
        state = self.fixed.copy()
        state[:3], state[3:6], state[6 : 6 + len(fingers)] = poses[0], velocities[0], fingers
        blocks = state[_BLOCKS].reshape(MAX_BLOCKS, -1)[: self._count]
        blocks[:, 1:4], blocks[:, 4:7] = poses[1:], velocities[1:]
        return state
