"""Where blocks go to make clusters, with little carrying: the pure planning of both cluster tasks.

A layout is improved move by move: of all blocks and all places, the one move that helps most, until none does. A
block may also return to where it is now, which costs nothing, so only those blocks move that must.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.experts.whim import Whim

Point = tuple[float, float]
Floats = NDArray[np.float64]

MOVE_COST: Final = 16.0  # actions, and then as many for each unit:
CARRY_COST: Final = 13.0
WRONG_COST: Final = 60.0  # actions that a block among the wrong kind counts as
SAFE: Final = 0.6  # a block is safe if its squared distance to its kind is below this share of what is allowed
DOUBTFUL, HOPELESS = 0.7, 2.2  # shares of that, between which a block counts as more and more wrong
APART: Final = 0.28  # between the centres of blocks
CROWDED_COST: Final = 1000.0  # actions for each unit by which two are nearer
PITCH: Final = 0.14  # of the places
LIMIT: Final = 0.78  # places are within this square
STARTS: Final = 3
SPREAD: Final = 30.0  # actions by which a whim makes a layout better or worse
ROUNDS: Final = 24


def rearranged(points: Sequence[Point], kinds: Sequence[str], whim: Whim) -> list[Point | None]:
    """A target for each block, or None for those that stay where they are."""
    here = np.array(points)
    values = sorted(set(kinds))
    members = np.array([[kind == value for kind in kinds] for value in values], float)
    best, best_cost = here, np.inf
    for number in range(STARTS):
        start = here if number == 0 else _gathered(here, members, whim)
        layout, cost = _improved(here, start, members, whim)
        cost += whim(SPREAD)
        if cost < best_cost:
            best, best_cost = layout, cost
    return [None if (new == old).all() else (float(new[0]), float(new[1])) for new, old in zip(best, here, strict=True)]


def _gathered(here: Floats, members: Floats, whim: Whim) -> Floats:
    """A start in which every kind is in one place: near its blocks, or at one of the other kinds' places."""
    middles = members @ here / members.sum(axis=1, keepdims=True)
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    centres = 0.5 * middles + 0.5 * corners[whim.rng.permutation(4)][: len(middles)]
    return members.T @ centres + whim.rng.normal(0, 0.1, here.shape)


def _improved(here: Floats, start: Floats, members: Floats, whim: Whim) -> tuple[Floats, float]:
    axis = np.arange(-LIMIT, LIMIT + 1e-9, PITCH)
    places = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    places = np.clip(places + whim.rng.uniform(-PITCH / 2, PITCH / 2, places.shape), -LIMIT, LIMIT)
    layout, cost = start, np.inf
    for _ in range(ROUNDS):
        options = [
            _layouts(layout, block, np.concatenate([places, here[block : block + 1]])) for block in range(len(here))
        ]
        layouts = np.concatenate(options)
        costs = _costs(layouts, here, members)
        best = int(costs.argmin())
        if costs[best] >= cost - 1e-9:
            break
        layout, cost = layouts[best], float(costs[best])
    return layout, cost


def _layouts(layout: Floats, block: int, places: Floats) -> Floats:
    """The layouts with one block in each of the places. Shape (places, blocks, 2)."""
    layouts = np.repeat(layout[None], len(places), axis=0)
    layouts[:, block] = places
    return layouts


def _costs(layouts: Floats, here: Floats, members: Floats) -> Floats:
    """What it costs to make each layout, and what is wrong with it. Shape (layouts,)."""
    ways = np.linalg.norm(layouts - here, axis=-1)
    moved = ways > 0
    cost = (moved * MOVE_COST + CARRY_COST * ways).sum(axis=-1)
    centres = members @ layouts / members.sum(axis=1, keepdims=True)
    squares = ((layouts[:, :, None] - centres[:, None]) ** 2).sum(axis=-1)  # (layout, block, kind)
    own = (squares * members.T).sum(axis=-1)
    nearest = np.where(members.T > 0, np.inf, squares).min(axis=-1)
    share = 3 * own / np.maximum(nearest, 1e-9)
    doubt = np.clip(share / SAFE, DOUBTFUL, HOPELESS) - DOUBTFUL  # shows the way to layouts in which fewer are wrong
    cost += WRONG_COST * (doubt + (share > SAFE)).sum(axis=-1)
    gaps = np.linalg.norm(layouts[:, :, None] - layouts[:, None], axis=-1)
    crowded = np.clip(APART - gaps, 0, None) * (moved[:, :, None] | moved[:, None, :])
    first = np.triu(np.ones(gaps.shape[1:]), 1)
    return cost + CROWDED_COST * (crowded * first).sum(axis=(1, 2))
