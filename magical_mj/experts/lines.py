"""Where blocks go to make a line, with little carrying: the pure planning of MakeLine."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.experts.whim import Whim
from magical_mj.scene import Block
from magical_mj.tasks.make_line import longest_line

Point = tuple[float, float]

SPACINGS: Final = (0.29, 0.34, 0.39)  # between neighbours; blocks are up to 0.31 wide, and 0.42 is too far
ANGLES: Final = 24
STAYS: Final = 0.09  # a block this near to its place is left alone
MOVE_COST: Final = 14.0  # actions, and then as many for each unit:
CARRY_COST: Final = 11.0
SPREAD: Final = 12.0  # actions by which a whim makes a line better or worse
CHECKED: Final = 500  # of the cheapest plans: blocks that stay near their places may leave too large a gap
SPARE: Final = 1.05  # the rule holds for places that are farther apart by this factor
LIMIT: Final = 0.84  # lines end within this square


def straightened(points: Sequence[Point], whim: Whim) -> list[Point | None]:
    """A target for each block, or None for those that stay where they are.

    Lines go through one of the blocks, which stays. All their directions, spacings and places for that block are
    tried with all orders of the others.
    """
    here = np.array(points)
    count = len(here)
    angles = (np.arange(ANGLES) + whim.rng.random()) * math.pi / ANGLES
    pairs = here[None] - here[:, None]
    angles = np.concatenate([angles, np.arctan2(pairs[..., 1], pairs[..., 0])[~np.eye(count, dtype=bool)]])
    along = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    places = (np.arange(count) - np.arange(count)[:, None])[None, :, None, :, None]  # (1, anchor's place, 1, slot, 1)
    lines = places * np.array(SPACINGS)[:, None, None, None, None] * along[None, None, :, None, :]
    slots = (here[:, None, None, None, None, :] + lines[None]).reshape(-1, count, 2)
    slots = slots[(np.abs(slots) <= LIMIT).all(axis=(1, 2))]
    ways = np.linalg.norm(slots[:, :, None] - here[None, None], axis=-1)  # (line, slot, block)
    costs = np.where(ways <= STAYS, 0.0, MOVE_COST + CARRY_COST * ways)
    orders = np.array(list(itertools.permutations(range(count))))
    totals = costs[:, np.arange(count), orders[:, None]].reshape(len(slots), len(orders), count).sum(axis=-1)
    ends = here
    totals += whim(SPREAD, totals.shape)
    for best in totals.ravel().argsort()[:CHECKED].tolist():
        line, order = divmod(best, len(orders))
        ends = here.copy()
        moved = ways[line, np.arange(count), orders[order]] > STAYS
        ends[orders[order][moved]] = slots[line][moved]
        if _is_line(ends):
            break
    return [
        None if (end == start).all() else (float(end[0]), float(end[1])) for end, start in zip(ends, here, strict=True)
    ]


def _is_line(points: NDArray[np.float64]) -> bool:
    """Whether blocks in these places make a line by the task's rule, with something to spare."""
    blocks = [Block("circle", "red", SPARE * float(x), SPARE * float(y), 0.0) for x, y in points]
    return longest_line(tuple(blocks)) == len(blocks)
