"""States as scenes, and the positions in them."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_mj.learners.networks import COLOURS, SHAPES, blocks_of, regions_of
from magical_mj.observations import FINGERS, MAX_BLOCKS
from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.scene.constants import COLOURS as COLOUR_NAMES
from magical_mj.scene.constants import SHAPES as SHAPE_NAMES

ROBOT: Final = MAX_BLOCKS
"""The number of the robot among objects. Blocks have their own numbers."""


def positions_of(state: Tensor) -> Tensor:
    """The positions of blocks and, last, the robot in a state (names,), shape (ROBOT + 1, 2). Missing blocks: NaN."""
    blocks = blocks_of(state)
    return torch.cat([torch.where(blocks[:, :1] > 0, blocks[:, 1:3], math.nan), state[None, :2]])


def scene_of(state: NDArray[np.float32]) -> Scene:
    """The scene of a state (names,)."""
    row = torch.tensor(state)
    blocks, regions = (rows[rows[:, 0] > 0] for rows in (blocks_of(row), regions_of(row)))
    (x, y, angle), fingers = row[:3].tolist(), row[FINGERS].tolist()
    return Scene(
        Robot(x, y, angle, (fingers[0], fingers[1])),
        tuple(
            Block(SHAPE_NAMES[shape], COLOUR_NAMES[colour], *pose)
            for shape, colour, pose in zip(
                blocks[:, SHAPES].argmax(1).tolist(),
                blocks[:, COLOURS].argmax(1).tolist(),
                blocks[:, 1:4].tolist(),
                strict=True,
            )
        ),
        tuple(
            GoalRegion(COLOUR_NAMES[colour], *box)
            for colour, box in zip(regions[:, 5:].argmax(1).tolist(), regions[:, 1:5].tolist(), strict=True)
        ),
    )
