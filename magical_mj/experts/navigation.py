"""Path search: the poses that the robot can reach between blocks at rest, with the fewest actions.

A breadth-first search runs over a grid of positions and headings. Each cell keeps the first exact pose that reached
it, so that the robot can drive the path through the pose's parents.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical_mj.actions import Drive, Turn
from magical_mj.scene import Pose
from magical_mj.scene import constants as c
from magical_mj.scene.bodies import Body

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Discs = tuple[tuple[float, float, float], ...]

HEADINGS: Final = 20  # the number of headings; one action turns by about one of them
CELL: Final = 0.05  # world units, cell size of the search
SIDE: Final = round(2 * c.ARENA_HALF_WIDTH / CELL)
FINE: Final = 0.02  # world units, cell size of the clearance map
FINE_REACH: Final = 1.4  # world units from the centre to the border of the clearance map
FINE_SIDE: Final = round(2 * FINE_REACH / FINE)

GRIP: Final = 0.32  # from the robot's centre to that of a block between its fingers
TURN_STEP: Final = c.SPEED_TURN / c.CONTROL_RATE
AFTERWARDS: Final = 4  # actions explored after the goal is first reached, to find a better path
SWITCH_COST: Final = 2  # actions lost when the robot reverses its direction

EMPTY: Final = ((0.0, 0.0, 0.2), (0.0, 0.18, 0.13), (0.0, 0.27, 0.1))
"""The robot with closed fingers as discs in its frame: x, y, radius."""
LOADED: Final = ((0.0, 0.0, 0.2), (0.1, 0.25, 0.1), (-0.1, 0.25, 0.1), (0.0, GRIP, 0.14))
"""The robot with a block between its fingers."""
WALL_MARGIN: Final = -0.01
PUSH_COSTS: Final = ((0.01, 1), (-0.04, 2), (-0.1, 3))
"""Pairs (clearance to blocks, cost in actions). Cells with less clearance cost more: blocks must be pushed aside."""
PUSH_LIMIT: Final = -0.2

MOTIONS: Final = tuple(
    (turn, drive) for drive in (Drive.FORWARD, Drive.BACK, Drive.NONE) for turn in Turn if turn or drive
)
_ADVANCE: Final = {Drive.NONE: 0.0, Drive.FORWARD: c.SPEED_FORWARD, Drive.BACK: -c.SPEED_BACKWARD}
_SPIN: Final = {Turn.NONE: 0.0, Turn.LEFT: TURN_STEP, Turn.RIGHT: -TURN_STEP}
_STEP: Final = np.array([_ADVANCE[drive] / c.CONTROL_RATE for _, drive in MOTIONS])
_TURN: Final = np.array([_SPIN[turn] for turn, _ in MOTIONS])
_SPINS, _SPUN = np.unique(_TURN, return_inverse=True)  # the different turns, and the index of each motion's turn
_GEAR: Final = np.select([_STEP > 0, _STEP < 0], [0, 1], -1)  # 0 forwards, 1 backwards, -1 turning on the spot


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


def cells(poses: Floats) -> Ints:
    """The cell of each pose, -1 outside the arena. Shape (n,)."""
    column, row = (np.floor((axis + c.ARENA_HALF_WIDTH) / CELL).astype(np.int64) for axis in poses.T[:2])
    heading = np.round(poses[:, 2] * (HEADINGS / (2 * math.pi))).astype(np.int64) % HEADINGS
    inside = (column >= 0) & (column < SIDE) & (row >= 0) & (row < SIDE)
    return np.where(inside, (heading * SIDE + column) * SIDE + row, -1)


def explore(start: Pose, costs: Ints, limit: int, goal: Goal | None = None) -> SearchTree:
    """The shortest paths from `start` to all cells within `limit` actions, including the cells' costs.

    After a goal is reached, only a few more actions are explored.
    """
    visited = np.zeros(2 * len(costs), bool)  # two slots per cell: reached forwards and reached backwards
    owner = np.empty(2 * len(costs), np.int64)
    waiting: list[list[tuple[Floats, Ints, Ints]]] = [[] for _ in range(limit + 1)]
    waiting[0] = [(np.array([start]), np.array([-1]), cells(np.array([start])))]
    poses, parents, steps, count = [], [], [], 0
    for level in range(limit + 1):
        if level > limit:
            break
        if not waiting[level]:
            continue
        here, above, slots = (np.concatenate(part) for part in zip(*waiting[level], strict=True))
        new = np.flatnonzero(~visited[slots])
        owner[slots[new]] = new
        new = new[owner[slots[new]] == new]  # one pose for each cell
        here, above, slots = here[new], above[new], slots[new]
        visited[slots] = True
        if goal is not None and goal.reached(here).any():
            limit, goal = min(limit, level + AFTERWARDS), None
        poses.append(here)
        parents.append(above)
        steps.append(np.full(len(new), level))
        after = _moved(here)
        entered = cells(after.reshape(-1, 3))
        inside = np.flatnonzero(entered >= 0)
        inside = inside[costs[entered[inside]] >= 0]
        origin, motion = np.divmod(inside, len(MOTIONS))
        before = slots[origin] >= len(costs)
        gears = np.where(_GEAR[motion] < 0, before, _GEAR[motion])
        arrival = level + 1 + costs[entered[inside]] + SWITCH_COST * (gears != before)
        then = gears * len(costs) + entered[inside]
        allowed = (arrival <= limit) & ~visited[then]
        for time in range(level + 1, min(limit, int(arrival.max(initial=0))) + 1):
            at = np.flatnonzero(allowed & (arrival == time))
            if len(at):
                waiting[time].append((after.reshape(-1, 3)[inside[at]], count + origin[at], then[at]))
        count += len(new)
    return SearchTree(np.concatenate(poses), np.concatenate(parents), np.concatenate(steps))


def _moved(poses: Floats) -> Floats:
    """The poses after each of the motions. Shape (n, motions, 3)."""
    middles = poses[:, 2, None] + _SPINS / 2
    after = np.empty((len(poses), len(MOTIONS), 3))
    after[:, :, 0] = poses[:, 0, None] + (-np.sin(middles))[:, _SPUN] * _STEP
    after[:, :, 1] = poses[:, 1, None] + np.cos(middles)[:, _SPUN] * _STEP
    after[:, :, 2] = poses[:, 2, None] + _TURN
    return after
