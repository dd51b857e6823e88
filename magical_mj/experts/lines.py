"""Where blocks go to make a line, with little carrying: the pure planning of MakeLine."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from magical_mj.experts.whim import Whim

Point = tuple[float, float]

SPACINGS: Final = (0.29, 0.34, 0.39)  # between neighbours; blocks are up to 0.31 wide, and 0.42 is too far
ANGLES: Final = 24
STAYS: Final = 0.09  # a block this near to its place is left alone
MOVE_COST: Final = 14.0  # actions, and then as many for each unit:
CARRY_COST: Final = 11.0
SPREAD: Final = 12.0  # actions by which a whim makes a line better or worse
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
    totals += whim(SPREAD, totals.shape)
    line, order = np.unravel_index(int(totals.argmin()), totals.shape)
    targets: list[Point | None] = [None] * count
    for slot, block in enumerate(orders[order].tolist()):
        if ways[line, slot, block] > STAYS:
            x, y = slots[line, slot].tolist()
            targets[block] = (x, y)
    return targets
