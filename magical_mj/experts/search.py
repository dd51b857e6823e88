"""The inner loops of the path search, compiled by numba. Poses and cells are exactly those of numpy's operations.

An arrival is a pose after an action, with the tree's pose before it. The arrivals of each level (number of actions) are
a linked list, in the order of insertion.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from magical_mj.experts.grid import CELL, GEAR, HEADINGS, MOTIONS, SIDE, SPUN, STEP, SWITCH_COST, TURN
from magical_mj.rendering.scanlines import compiled, inlined
from magical_mj.scene import constants as c

SAMPLE: Final = 0.05
"""The distance between the points of a straight line that are checked (world units)."""
PARENT, SLOT, NEXT = range(3)
"""The rows of a table of arrivals: the number of the pose before, the slot, the level's next arrival or -1."""
FIRST, LAST = range(2)
"""The rows of a table of levels: the first and the last arrival of each, or -1."""
POSES, ARRIVALS = range(2)
"""The entries of an array of counts."""

_HALF: Final = c.ARENA_HALF_WIDTH
_PER_RADIAN: Final = HEADINGS / (2 * math.pi)
_MOTIONS: Final = len(MOTIONS)


@inlined
def _cell(x: float, y: float, angle: float) -> int:
    """The cell of a pose, -1 outside the arena."""
    column, row = math.floor((x + _HALF) / CELL), math.floor((y + _HALF) / CELL)
    if not (0 <= column < SIDE and 0 <= row < SIDE):
        return -1
    heading = int(np.rint(angle * _PER_RADIAN)) % HEADINGS
    return (heading * SIDE + column) * SIDE + row


@compiled("void(i8, f8[:,::1], i8[:,::1], i8[:,::1], i8[::1], b1[::1], f8[:,::1], i8[:,::1], i8[::1])")
def settle(
    level: int, after: Any, arrivals: Any, levels: Any, owner: Any, visited: Any, poses: Any, tree: Any, counts: Any
) -> None:
    """Adds the arrivals of a level to the tree, one for each slot that no earlier level has reached: the last one.

    Args:
        level: the level.
        after: the arrivals' poses, one a row.
        arrivals: the table of arrivals.
        levels: the table of levels.
        owner: for each slot, memory for an arrival.
        visited: whether each slot is in the tree. The new ones are marked.
        poses: the array to add poses to, one a row.
        tree: the array to add PARENT and SLOT of these poses to, one a column.
        counts: the numbers of poses and of arrivals.
    """
    at = levels[FIRST, level]
    while at >= 0:
        owner[arrivals[SLOT, at]] = at
        at = arrivals[NEXT, at]
    at = levels[FIRST, level]
    while at >= 0:
        slot = arrivals[SLOT, at]
        if owner[slot] == at and not visited[slot]:
            visited[slot] = True
            number = counts[POSES]
            poses[number] = after[at]
            tree[PARENT, number], tree[SLOT, number] = arrivals[PARENT, at], slot
            counts[POSES] += 1
        at = arrivals[NEXT, at]


@compiled(
    "void(i8, i8, i8, f8[:,::1], f8[:,::1], f8[:,::1], i8[:,::1], i8[::1], b1[::1], f8[:,::1], i8[:,::1], i8[:,::1], "
    "i8[::1])"
)
def expand(
    level: int,
    limit: int,
    first: int,
    sines: Any,
    cosines: Any,
    poses: Any,
    tree: Any,
    costs: Any,
    visited: Any,
    after: Any,
    arrivals: Any,
    levels: Any,
    counts: Any,
) -> None:
    """Adds the arrivals that follow from a level's poses by one motion each.

    Args:
        level: the level.
        limit: the last level.
        first: the number of the level's first pose in the tree.
        sines: of the angle in the middle of each spin, shape (n, spins).
        cosines: the same.
        poses: the poses of the tree.
        tree: PARENT and SLOT of these poses. The slot is the cell, plus `len(costs)` if it was reached backwards.
        costs: the additional number of actions to enter each cell; negative if the robot cannot.
        visited: whether each slot is in the tree.
        after: the array to add poses to, one a row.
        arrivals: the table of arrivals.
        levels: the table of levels.
        counts: the numbers of poses and of arrivals.
    """
    for origin in range(first, first + len(sines)):
        before = tree[SLOT, origin] >= len(costs)
        for motion in range(_MOTIONS):
            spin, step = SPUN[motion], STEP[motion]
            x = poses[origin, 0] + (-sines[origin - first, spin]) * step
            y = poses[origin, 1] + cosines[origin - first, spin] * step
            angle = poses[origin, 2] + TURN[motion]
            cell = _cell(x, y, angle)
            if cell < 0 or costs[cell] < 0:
                continue
            gear = before if GEAR[motion] < 0 else GEAR[motion]
            then = level + 1 + costs[cell] + SWITCH_COST * (gear != before)
            slot = gear * len(costs) + cell
            if then > limit or visited[slot]:
                continue
            number = counts[ARRIVALS]
            after[number, 0], after[number, 1], after[number, 2] = x, y, angle
            arrivals[PARENT, number], arrivals[SLOT, number], arrivals[NEXT, number] = origin, slot, -1
            if levels[FIRST, then] < 0:
                levels[FIRST, then] = number
            else:
                arrivals[NEXT, levels[LAST, then]] = number
            levels[LAST, then] = number
            counts[ARRIVALS] += 1


@compiled("void(f8[:,::1], i8, i8[::1], i8[::1])")
def look(path: Any, at: int, costs: Any, farthest: Any) -> None:
    """Writes the last pose of a path that the robot can reach from the pose `at` in a straight line, or `at`."""
    farthest[0] = at
    for then in range(len(path) - 1, at, -1):
        dx, dy = path[then, 0] - path[at, 0], path[then, 1] - path[at, 1]
        heading = math.atan2(-dx, dy)
        steps = max(1, math.ceil(math.hypot(dx, dy) / SAMPLE) - 1)
        free = True
        for step in range(steps + 1):
            x, y = path[at, 0] + step * (dx / steps), path[at, 1] + step * (dy / steps)
            if step == steps:
                x, y = path[then, 0], path[then, 1]  # as in numpy.linspace: rounding may lead into another cell
            free = free and costs[_cell(x, y, heading)] == 0
        if free:
            farthest[0] = then
            return
