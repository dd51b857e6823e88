"""The grid of the path search: cells of positions and headings, and the robot's motions."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.actions import Drive, Turn
from magical_mj.scene import constants as c

HEADINGS: Final = 20  # the number of headings; one action turns by about one of them
CELL: Final = 0.05  # world units, cell size of the search
SIDE: Final = round(2 * c.ARENA_HALF_WIDTH / CELL)

TURN_STEP: Final = c.SPEED_TURN / c.CONTROL_RATE
SWITCH_COST: Final = 2  # actions lost when the robot reverses its direction

MOTIONS: Final = tuple(
    (turn, drive) for drive in (Drive.FORWARD, Drive.BACK, Drive.NONE) for turn in Turn if turn or drive
)
_ADVANCE: Final = {Drive.NONE: 0.0, Drive.FORWARD: c.SPEED_FORWARD, Drive.BACK: -c.SPEED_BACKWARD}
_SPIN: Final = {Turn.NONE: 0.0, Turn.LEFT: TURN_STEP, Turn.RIGHT: -TURN_STEP}
STEP: Final = np.array([_ADVANCE[drive] / c.CONTROL_RATE for _, drive in MOTIONS])
TURN: Final = np.array([_SPIN[turn] for turn, _ in MOTIONS])
SPINS, SPUN = np.unique(TURN, return_inverse=True)  # the different turns, and the index of each motion's turn
GEAR: Final = np.select([STEP > 0, STEP < 0], [0, 1], -1)  # 0 forwards, 1 backwards, -1 turning on the spot


def cells(poses: NDArray[np.float64]) -> NDArray[np.int64]:
    """The cell of each pose, -1 outside the arena. Shape (n,)."""
    column, row = (np.floor((axis + c.ARENA_HALF_WIDTH) / CELL).astype(np.int64) for axis in poses.T[:2])
    heading = np.round(poses[:, 2] * (HEADINGS / (2 * math.pi))).astype(np.int64) % HEADINGS
    inside = (column >= 0) & (column < SIDE) & (row >= 0) & (row < SIDE)
    return np.where(inside, (heading * SIDE + column) * SIDE + row, -1)
