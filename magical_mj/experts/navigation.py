"""Path search: the poses that the robot can reach between blocks at rest, with the fewest actions.

A breadth-first search runs over a grid of positions and headings. Each cell keeps the first exact pose that reached
it, so that the robot can drive the path through the pose's parents.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical_mj.experts.grid import CELL, HEADINGS, MOTIONS, SIDE, SPINS, cells
from magical_mj.scene import Pose
from magical_mj.scene import constants as c
from magical_mj.scene.bodies import Body

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Discs = tuple[tuple[float, float, float], ...]

FINE: Final = 0.02  # world units, cell size of the clearance map
FINE_REACH: Final = 1.4  # world units from the centre to the border of the clearance map
FINE_SIDE: Final = round(2 * FINE_REACH / FINE)

GRIP: Final = 0.32  # from the robot's centre to that of a block between its fingers
AFTERWARDS: Final = 4  # actions explored after the goal is first reached, to find a better path

EMPTY: Final = ((0.0, 0.0, 0.2), (0.0, 0.18, 0.13), (0.0, 0.27, 0.1))
"""The robot with closed fingers as discs in its frame: x, y, radius."""
LOADED: Final = ((0.0, 0.0, 0.2), (0.1, 0.25, 0.1), (-0.1, 0.25, 0.1), (0.0, GRIP, 0.14))
"""The robot with a block between its fingers."""
WALL_MARGIN: Final = -0.01
PUSH_COSTS: Final = ((0.01, 1), (-0.04, 2), (-0.1, 3))
"""Pairs (clearance to blocks, cost in actions). Cells with less clearance cost more: blocks must be pushed aside."""
PUSH_LIMIT: Final = -0.2


class Goal(NamedTuple):
    """The goal of a search: the point `ahead` of the robot is within a tolerance of a target point."""

    ahead: float
    x: float
    y: float
    within: float

    def reached(self, poses: Floats) -> NDArray[np.bool_]:
        """Whether each pose reaches the goal. Shape (n,)."""
        return np.hypot(*(points_ahead(poses, self.ahead) - (self.x, self.y)).T) <= self.within


@dataclass(frozen=True)
class SearchTree:
    """The poses that the robot can reach from a start, as a tree. Each is one action after its parent."""

    poses: Floats
    """Shape (n, 3). The first is the start."""
    parents: Ints
    steps: Ints
    """The number of actions to each pose. Shape (n,)."""

    def path_to(self, node: int) -> list[Pose]:
        """The poses on the path from the start to a node, both included."""
        path = []
        while node >= 0:
            path.append(tuple(self.poses[node].tolist()))
            node = int(self.parents[node])
        return path[::-1]


def points_ahead(poses: Floats, ahead: float) -> Floats:
    """The points `ahead` of the robot's centre in each pose. Shape (n, 2)."""
    angles = poses[:, 2]
    return poses[:, :2] + ahead * np.stack([-np.sin(angles), np.cos(angles)], axis=1)


def footprint(body: Body) -> Discs:
    """A body without fingers as discs in its frame. They are in a row along the longer side of its bounding box."""
    if not body.outline:
        return ((0.0, 0.0, body.radius),)
    (left, back), (right, front) = body.corners.min(axis=0).tolist(), body.corners.max(axis=0).tolist()
    radius = min(right - left, front - back) / 2
    count = math.ceil(max(right - left, front - back) / (2 * radius)) + 1
    row = np.linspace((left + radius, back + radius), (right - radius, front - radius), count)
    return tuple((x, y, radius) for x, y in row.tolist())


def cell_costs(obstacles: Floats, discs: Discs) -> Ints:
    """The additional number of actions to enter each cell. Negative for cells that the robot cannot occupy.

    Args:
        obstacles: x, y and radius of each block, shape (n, 3).
        discs: the robot, including a block that it carries.
    """
    axis = (np.arange(FINE_SIDE) + 0.5) * FINE - FINE_REACH
    x, y = axis[:, None], axis[None, :]
    room = np.full((FINE_SIDE, FINE_SIDE), np.inf)
    for ox, oy, radius in obstacles:
        np.minimum(room, np.sqrt((x - ox) ** 2 + (y - oy) ** 2) - radius, out=room)
    space = _least(room, discs)
    costs = np.zeros(len(space), np.int64)
    for clearance, cost in PUSH_COSTS:
        costs += (space < clearance) * cost
    costs[(space < PUSH_LIMIT) | _walled(discs)] = -1
    return costs


def _least(room: Floats, discs: Discs) -> Floats:
    """The least clearance of all discs in each cell, from the clearance map. Shape (HEADINGS * SIDE**2,)."""
    return np.min([room.ravel()[_samples(dx, dy)] - radius for dx, dy, radius in discs], axis=0)


@lru_cache
def _walled(discs: Discs) -> NDArray[np.bool_]:
    """The cells that would put the robot into a wall."""
    axis = (np.arange(FINE_SIDE) + 0.5) * FINE - FINE_REACH
    room = c.ARENA_HALF_WIDTH - np.maximum(np.abs(axis[:, None]), np.abs(axis[None, :]))
    return _least(room, discs) < WALL_MARGIN


@lru_cache
def _samples(dx: float, dy: float) -> Ints:
    """For each cell, the index into the clearance map of a point in the robot's frame."""
    angles = (np.arange(HEADINGS) * 2 * math.pi / HEADINGS)[:, None, None]
    centres = (np.arange(SIDE) + 0.5) * CELL - c.ARENA_HALF_WIDTH
    x = centres[:, None] + dx * np.cos(angles) - dy * np.sin(angles)
    y = centres[None, :] + dx * np.sin(angles) + dy * np.cos(angles)
    column, row = (np.floor((axis + FINE_REACH) / FINE).astype(np.int64).clip(0, FINE_SIDE - 1) for axis in (x, y))
    return (column * FINE_SIDE + row).ravel()


def explore(start: Pose, costs: Ints, limit: int, goal: Goal | None = None) -> SearchTree:
    """The shortest paths from `start` to all cells within `limit` actions, including the cells' costs.

    After a goal is reached, only a few more actions are explored.
    """
    from magical_mj.experts.search import PARENT, POSES, expand, settle  # imported late: numba takes 0.3 s

    slots = 2 * len(costs)  # two per cell: reached forwards and reached backwards
    visited, owner = np.zeros(slots, bool), np.empty(slots, np.int64)
    poses, tree = np.empty((slots, 3)), np.empty((2, slots), np.int64)
    after, arrivals = np.empty((1 + slots * len(MOTIONS), 3)), np.empty((3, 1 + slots * len(MOTIONS)), np.int64)
    levels = np.full((2, limit + 1), -1)
    after[0], arrivals[:, 0], levels[:, 0] = start, (-1, *cells(np.array([start])), -1), 0
    counts = np.array([0, 1])
    first, steps = 0, []
    for level in range(limit + 1):
        if level > limit:
            break
        settle(level, after, arrivals, levels, owner, visited, poses, tree, counts)
        here = poses[first : counts[POSES]]
        steps.append(np.full(len(here), level))
        if goal is not None and goal.reached(here).any():
            limit, goal = min(limit, level + AFTERWARDS), None
        middles = here[:, 2, None] + SPINS / 2
        sines, cosines = np.sin(middles), np.cos(middles)
        expand(level, limit, first, sines, cosines, poses, tree, costs, visited, after, arrivals, levels, counts)
        first += len(here)
    return SearchTree(poses[:first].copy(), tree[PARENT, :first].copy(), np.concatenate(steps))


def farthest(path: Sequence[Pose], at: int, costs: Ints) -> int:
    """The last pose of a path that the robot reaches from the pose `at` in a straight line, by its number, or `at`."""
    from magical_mj.experts.search import look  # imported late: numba takes 0.3 s

    found = np.zeros(1, np.int64)
    look(np.array(path), at, costs, found)
    return int(found[0])
