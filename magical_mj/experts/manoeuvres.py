"""Manoeuvres, executed in the lookahead: drive to a block, grip it, carry it, release it and drive back, or push it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.actions import Drive, Gripper, Turn
from magical_mj.experts.driving import AIM, FACE, VIA, Lookahead, Patience, Point, drive, steer
from magical_mj.experts.navigation import (
    GRIP,
    LOADED,
    Goal,
    Ints,
    SearchTree,
    cell_costs,
    cells,
    explore,
    farthest,
    points_ahead,
)
from magical_mj.scene import Pose, Scene
from magical_mj.scene.bodies import Body
from magical_mj.tasks.planning import CARRYING, Noise, Subgoal

BLOCK_RADIUS: Final = {"square": 0.125, "pentagon": 0.13, "star": 0.14, "circle": 0.12}
"""The radius (world units) of each shape's disc in the search, between those of its inner and outer circles."""

# Choosing a manoeuvre
BEFORE: Final = (0.46, 0.68)  # world units ahead of the robot where a block may be before it is gripped
ASIDE: Final = 0.1  # the largest distance to the side
BEHIND: Final = (0.2, 0.6)  # world units ahead of the robot where a block may be before it is pushed
OFF_CENTRE: Final = 0.08  # the largest distance to the side; a wider body may push up to 0.1 from its side's end
OFF_CENTRE_COST: Final = 40.0  # actions for each unit to the side
FREE_OF_WALLS: Final = 0.7  # bound of |x| and |y| for the end of a push to a corner: at a wall, the next push fails
ASKEW: Final = 0.35  # rad: a push whose direction differs less from the target's direction ends at the target
SIDES: Final = 16  # the number of directions for gripping or pushing a block
STOPS: Final = (GRIP, GRIP + 0.07, GRIP + 0.14)  # distances from the block that need free space for the fingers
TIGHT: Final = 1.5  # actions for each unit of the cells' costs along them
WALLED: Final = 12  # the cost of cells where a finger would touch a wall by the estimate; gripping sometimes succeeds
DETOUR: Final = 3.0  # actions: the largest change of a path's cost by noise
CORNER_COST: Final = 4.0  # actions for each point of a route except the last

# Executing a manoeuvre
REACHED: Final = (0.36, 0.1)  # ahead, to the side: within these distances, the block is between the fingers
LOST: Final = (0.46, 0.14)  # beyond these distances, the block is no longer held
REACH: Final = 80  # actions: the longest path with a block
CORRECTIONS: Final = 2  # number of routes: the second is used if the first missed the target
MISSED: Final = 60.0  # the cost (actions) of each unit of distance from the target, within the tolerance
MISSED_BY_FAR: Final = 1000.0  # the same beyond the tolerance
FREE: Final = 0.5  # the robot can turn if the block is this far ahead
FAR: Final = 0.75  # the robot tries again from this distance ahead
BACKING: Final = 8  # actions
SLIPPED: Final = 0.02  # world units: a block that moves this far away from the target during a push has slipped
CENTRING: Final = 0.5
BACKED: Final = 3  # actions


@dataclass(frozen=True)
class Manoeuvre:
    """A subgoal, and a plan to reach it."""

    subgoal: Subgoal
    route: list[Point]
    """The points of the route to the block, or to the target if the subgoal has no block."""
    reverse: bool
    """With fingers: whether to drive back while turning with a block. Without: whether to push with the back."""
    estimate: float
    """The approximate number of actions."""


def obstacles(scene: Scene, without: int | None = None) -> NDArray[np.float64]:
    """x, y, radius of each block except the block `without`. Shape (n, 3)."""
    discs = [(b.x, b.y, BLOCK_RADIUS[b.shape]) for number, b in enumerate(scene.blocks) if number != without]
    return np.array(discs).reshape(-1, 3)


def manoeuvres(
    tree: SearchTree, costs: Ints, scene: Scene, subgoal: Subgoal, noise: Noise, body: Body
) -> list[Manoeuvre]:
    """Candidate manoeuvres for a subgoal: for each side of the block, one of the fastest. Without fingers: pushes.

    The tree contains the poses that the robot can reach. `costs` is the additional cost of each cell for the robot
    without a block.
    """
    if subgoal.block is None:
        gaps = np.hypot(*(tree.poses[:, :2] - subgoal.target).T)
        # if no pose is within the tolerance, the nearest ones
        nodes = np.flatnonzero(gaps <= max(subgoal.tolerance, gaps.min()))
        node = int(nodes[tree.steps[nodes].argmin()])
        route = simplified([*tree.path_to(node), (*subgoal.target, 0.0)], costs)
        return [Manoeuvre(subgoal, route, False, float(tree.steps[node]))]
    block = scene.blocks[subgoal.block]
    if not body.fingers:
        half = float(body.corners[:, 0].max()) if body.outline else 0.0
        return _pushes(tree, costs, block.pose, subgoal, max(OFF_CENTRE, half - 0.1))
    loaded = cell_costs(obstacles(scene, subgoal.block), LOADED)
    right, ahead = _relative(tree.poses, block.pose)
    angle = tree.poses[:, 2]
    near = np.flatnonzero((np.abs(right) < ASIDE) & (BEFORE[0] < ahead) & (ahead < BEFORE[1]))
    sides = np.round(angle[near] * SIDES / (2 * math.pi)).astype(int) % SIDES
    candidates = []
    for side in np.unique(sides).tolist():
        nodes = near[sides == side]
        node = int(nodes[(tree.steps[nodes] + noise(DETOUR, nodes.shape)).argmin()])
        heading = side * 2 * math.pi / SIDES
        stops = [_behind(block.x, block.y, heading, ahead) for ahead in STOPS]
        tight = loaded[cells(np.array(stops))]
        tight[tight < 0] = WALLED
        route = simplified(tree.path_to(node), costs)
        estimate = tree.steps[node] + TIGHT * tight.sum() + _carrying(block.x, block.y, heading, subgoal)
        estimate += CORNER_COST * len(route)
        candidates += [Manoeuvre(subgoal, route, reverse, float(estimate)) for reverse in (True, False)]
    return candidates


def _pushes(tree: SearchTree, costs: Ints, block: Pose, subgoal: Subgoal, aside: float) -> list[Manoeuvre]:
    """Candidate pushes: straight to the target, or in another direction until the target is at right angles.

    If a block cannot be pushed straight to the target, two such pushes bring it there. `aside` is the largest distance
    of the block to the side of the robot's centre.
    """
    dx, dy = subgoal.target[0] - block[0], subgoal.target[1] - block[1]
    right, ahead = _relative(tree.poses, block)
    near = np.flatnonzero((np.abs(right) < aside) & (BEHIND[0] < abs(ahead)) & (abs(ahead) < BEHIND[1]))
    headings = tree.poses[near, 2] + math.pi * (ahead[near] < 0)  # the robot can also push with its back
    sides = np.round(headings * SIDES / (2 * math.pi)).astype(int) % SIDES
    candidates = []
    for side in np.unique(sides).tolist():
        heading = side * 2 * math.pi / SIDES
        along = -math.sin(heading) * dx + math.cos(heading) * dy
        across = abs(math.cos(heading) * dx + math.sin(heading) * dy)
        if along <= subgoal.tolerance:
            continue
        target = subgoal.target
        if math.atan2(across, along) > ASKEW:
            target = block[0] - along * math.sin(heading), block[1] + along * math.cos(heading)
            if max(abs(target[0]), abs(target[1])) > FREE_OF_WALLS:
                continue
        for reverse in (False, True):
            nodes = near[(sides == side) & ((ahead[near] < 0) == reverse)]
            if len(nodes):
                node = int(nodes[(tree.steps[nodes] + OFF_CENTRE_COST * np.abs(right[nodes])).argmin()])
                route = simplified(tree.path_to(node), costs)
                estimate = float(tree.steps[node]) + CARRYING * (along + across) + CORNER_COST * len(route)
                push = Subgoal(subgoal.block, target, subgoal.tolerance)
                candidates.append(Manoeuvre(push, route, reverse, estimate))
    return candidates


def simplified(path: Sequence[Pose], costs: Ints) -> list[Point]:
    """The shortest list of a path's points that the robot can connect by straight lines, without the first point."""
    route, at = [], 0
    while at < len(path) - 1:
        at = max(farthest(path, at, costs), at + 1)
        route.append(path[at][:2])
    return route


def _relative(poses: NDArray[np.float64], block: Pose) -> NDArray[np.float64]:
    """A block's distances to the right and ahead, for each of the robot's poses. Shape (2, n)."""
    x, y, angle = poses.T
    right = np.cos(angle) * (block[0] - x) + np.sin(angle) * (block[1] - y)
    return np.array([right, np.cos(angle) * (block[1] - y) - np.sin(angle) * (block[0] - x)])


def _behind(x: float, y: float, heading: float, ahead: float) -> Pose:
    """The pose with this heading and the point (x, y) straight `ahead`."""
    return x + ahead * math.sin(heading), y - ahead * math.cos(heading), heading


def _carrying(x: float, y: float, heading: float, subgoal: Subgoal) -> float:
    """The approximate number of actions that carry a block from (x, y) to its target, if gripped with this heading."""
    robot = _behind(x, y, heading, GRIP)
    dx, dy = subgoal.target[0] - robot[0], subgoal.target[1] - robot[1]
    turn = abs((math.atan2(-dx, dy) - heading + math.pi) % (2 * math.pi) - math.pi)
    distance = math.hypot(dx, dy) - GRIP
    return 8 + turn * 3.5 + CARRYING * (distance if distance > 0 else -1.6 * distance + 0.1)


def perform(lookahead: Lookahead, manoeuvre: Manoeuvre, limit: int) -> bool:
    """Executes the manoeuvre. Returns whether it succeeded."""
    subgoal, block = manoeuvre.subgoal, manoeuvre.subgoal.block
    if block is None:
        return drive(lookahead, manoeuvre.route, Gripper.OPEN, limit, within=subgoal.tolerance)
    drive(lookahead, manoeuvre.route, Gripper.OPEN, limit, within=VIA)
    if not lookahead.body.fingers:
        return _push(lookahead, block, manoeuvre, limit)
    taken = _take(lookahead, block, limit)
    carried = taken and _carry(lookahead, block, manoeuvre, limit)
    _let_go(lookahead, block, limit, FREE if taken else FAR)
    return carried


def _push(lookahead: Lookahead, block: int, manoeuvre: Manoeuvre, limit: int) -> bool:
    """Pushes the block to its target, until it does not come closer. Returns whether it is there.

    Afterwards the robot drives away, so that it can turn.
    """
    subgoal, side = manoeuvre.subgoal, -1 if manoeuvre.reverse else 1
    on, off = (Drive.FORWARD, Drive.BACK)[::side]
    start = least = math.dist(lookahead.block(block), subgoal.target)
    patience = Patience()
    while len(lookahead.trace) < limit:
        left = math.dist(lookahead.block(block), subgoal.target)
        touched = left < start - SLIPPED
        least = min(least, left)
        if left <= 0.6 * subgoal.tolerance or left > least + SLIPPED or patience.ends(left if touched else 9 + left):
            break
        # with the block ahead, aim slightly past the target, so that the block does not slide off
        right, ahead = lookahead.relative(subgoal.target)
        aside = lookahead.relative_block(block)[0]
        bearing = math.atan2(-side * (right - CENTRING * aside), side * ahead)
        turn = Turn.LEFT if bearing > 0 else Turn.RIGHT
        if abs(bearing) <= AIM:
            turn = Turn.NONE
        lookahead.act(Gripper.OPEN, turn, Drive.NONE if abs(bearing) > FACE else on)
    for _ in range(min(BACKED, limit - len(lookahead.trace))):
        lookahead.act(Gripper.OPEN, Turn.NONE, off)
    return math.dist(lookahead.block(block), subgoal.target) <= subgoal.tolerance


def _take(lookahead: Lookahead, block: int, limit: int) -> bool:
    """Drives until the block is between the fingers, and closes them. Returns whether the block is held."""
    patience = Patience()
    while len(lookahead.trace) < limit and not _within(lookahead, block, REACHED):
        right, ahead = lookahead.relative_block(block)
        if patience.ends(ahead + 0.3 * abs(math.atan2(-right, ahead))):
            return False
        lookahead.act(*steer(lookahead, lookahead.block(block), GRIP, Gripper.OPEN, reverse=False))
    if len(lookahead.trace) < limit:
        lookahead.act(Gripper.CLOSE)
    return _within(lookahead, block, LOST)


def _within(lookahead: Lookahead, block: int, box: Point) -> bool:
    """Whether a block is at most box[0] ahead of the robot and at most box[1] to the side."""
    right, ahead = lookahead.relative_block(block)
    return 0 < ahead < box[0] and abs(right) < box[1]


def _carry(lookahead: Lookahead, block: int, manoeuvre: Manoeuvre, limit: int) -> bool:
    """Drives until the block is at its target. Returns whether it is."""
    subgoal = manoeuvre.subgoal
    for _ in range(CORRECTIONS):
        left = limit - len(lookahead.trace)
        if left <= 0 or not _within(lookahead, block, LOST):
            return False
        ahead = lookahead.relative_block(block)[1]
        goal = Goal(ahead, *subgoal.target, subgoal.tolerance / 2)
        route = _route(lookahead.scene(), block, goal, min(left, REACH))
        drive(
            lookahead,
            route,
            Gripper.CLOSE,
            limit,
            ahead=ahead,
            within=0.7 * subgoal.tolerance,
            reverse=manoeuvre.reverse,
        )
        if math.dist(lookahead.block(block), subgoal.target) <= subgoal.tolerance:
            return True
    return False


@lru_cache(maxsize=16)  # manoeuvres with the same grip use the same route
def _route(scene: Scene, block: int, goal: Goal, limit: int) -> list[Point]:
    """The points of a route that carries the held block to its goal."""
    x, y, _ = scene.robot.pose
    costs = cell_costs(obstacles(scene, block), LOADED)
    dx, dy = goal.x - x, goal.y - y
    distance = math.hypot(dx, dy)
    share = 1 - goal.ahead / distance if distance else 0.0
    end = (x + share * dx, y + share * dy, 0.0)
    if share <= 0 or farthest([(x, y, 0.0), end], 0, costs):
        return [(goal.x, goal.y)]
    tree = explore(scene.robot.pose, costs, limit, goal)
    gaps = np.hypot(*(points_ahead(tree.poses, goal.ahead) - (goal.x, goal.y)).T)
    totals = tree.steps + MISSED * gaps + MISSED_BY_FAR * np.clip(gaps - goal.within, 0, None)
    path = tree.path_to(int(totals.argmin()))
    return [*simplified(path, costs)[:-1], (goal.x, goal.y)]


def _let_go(lookahead: Lookahead, block: int, limit: int, distance: float) -> None:
    """Opens the fingers, waits for them, and drives back until the block is at least `distance` ahead."""
    for number in range(min(BACKING, limit - len(lookahead.trace))):
        if lookahead.relative_block(block)[1] > distance:
            return
        lookahead.act(Gripper.OPEN, Turn.NONE, Drive.NONE if number == 1 else Drive.BACK)
