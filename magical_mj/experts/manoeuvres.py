"""Manoeuvres, carried out by lookahead: go to a block, take it, carry it, let go and back off."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.actions import Drive, Gripper, Turn
from magical_mj.experts.driving import VIA, Patience, Point, drive, steer
from magical_mj.experts.lookahead import Lookahead
from magical_mj.experts.navigation import GRIP, Goal, Ints, Ways, cells, explore, places, toll
from magical_mj.planning.noise import Noise
from magical_mj.planning.subgoals import CARRYING, Subgoal
from magical_mj.scene import Pose, Scene

BLOCK_RADIUS: Final = {"square": 0.125, "pentagon": 0.13, "star": 0.14, "circle": 0.12}

# Choosing how to begin
BEFORE: Final = (0.46, 0.68)  # how far ahead of the robot a block is before it is taken
ASIDE: Final = 0.1  # and at most how far to the side
SIDES: Final = 16  # from which a block can be taken
STOPS: Final = (GRIP, GRIP + 0.07, GRIP + 0.14)  # on the way to the block, where there must be room for the fingers
TIGHT: Final = 1.5  # actions for each of toll on this way
WALLED: Final = 12  # toll where a finger is in a wall, by calculation: now and then it still works
DETOUR: Final = 3.0  # actions by which noise makes a way longer or shorter
CORNER_COST: Final = 4.0  # actions for each point of a route but the last
SAMPLE: Final = 0.05  # world units between points where the ground is looked at

# Doing it
REACHED: Final = (0.36, 0.1)  # ahead, aside: it is between the fingers
LOST: Final = (0.46, 0.14)  # it is not held any more
REACH: Final = 80  # actions, the longest way with a block
CORRECTIONS: Final = 2  # routes driven, the second if the first did not end where it should
MISSED: Final = 60.0  # actions that a unit of distance from the target counts as, within the tolerance
MISSED_BY_FAR: Final = 1000.0  # and beyond it
FREE: Final = 0.5  # ahead: so far off, the robot can turn
FAR: Final = 0.75  # and so far it goes to try again
BACKING: Final = 8  # actions


@dataclass(frozen=True)
class Manoeuvre:
    """A subgoal, and how to go about it."""

    subgoal: Subgoal
    route: list[Point]
    """The points through which to drive before the block is taken, or to the end if there is none."""
    reverse: bool
    """Whether to drive back while turning, with a block between the fingers."""
    estimate: float
    """About how many actions it takes."""


def obstacles(scene: Scene, without: int | None = None) -> NDArray[np.float64]:
    """x, y, radius of each block but one. Shape (n, 3)."""
    found = [(b.x, b.y, BLOCK_RADIUS[b.shape]) for number, b in enumerate(scene.blocks) if number != without]
    return np.array(found).reshape(-1, 3)


def manoeuvres(ways: Ways, tolls: Ints, scene: Scene, subgoal: Subgoal, noise: Noise) -> list[Manoeuvre]:
    """The ways to go about a subgoal: for each side of the block one of the quickest.

    Args:
        ways: where the robot can go.
        tolls: what the ground costs the robot with empty fingers.
        scene: what is where.
        subgoal: what is to be reached.
        noise: varies the choice.
    """
    if subgoal.block is None:
        gaps = np.hypot(*(ways.poses[:, :2] - subgoal.target).T)
        nodes = np.flatnonzero(gaps <= max(subgoal.tolerance, gaps.min()))  # the nearest, if none is near enough
        node = int(nodes[ways.steps[nodes].argmin()])
        route = simplified([*ways.to(node), (*subgoal.target, 0.0)], tolls)
        return [Manoeuvre(subgoal, route, False, float(ways.steps[node]))]
    block = scene.blocks[subgoal.block]
    loaded = toll(obstacles(scene, subgoal.block), loaded=True)
    x, y, angle = ways.poses.T
    right = np.cos(angle) * (block.x - x) + np.sin(angle) * (block.y - y)
    ahead = np.cos(angle) * (block.y - y) - np.sin(angle) * (block.x - x)
    near = np.flatnonzero((np.abs(right) < ASIDE) & (BEFORE[0] < ahead) & (ahead < BEFORE[1]))
    sides = np.round(angle[near] * SIDES / (2 * math.pi)).astype(int) % SIDES
    found = []
    for side in np.unique(sides).tolist():
        nodes = near[sides == side]
        node = int(nodes[(ways.steps[nodes] + noise(DETOUR, nodes.shape)).argmin()])
        heading = side * 2 * math.pi / SIDES
        stops = [_behind(block.x, block.y, heading, ahead) for ahead in STOPS]
        tight = loaded[cells(np.array(stops))]
        tight[tight < 0] = WALLED
        route = simplified(ways.to(node), tolls)
        estimate = ways.steps[node] + TIGHT * tight.sum() + _carrying(block.x, block.y, heading, subgoal)
        estimate += CORNER_COST * len(route)
        found += [Manoeuvre(subgoal, route, reverse, float(estimate)) for reverse in (True, False)]
    return found


def simplified(way: Sequence[Pose], tolls: Ints) -> list[Point]:
    """The fewest points of a way between which the robot can drive straight on; without the first."""
    route, at = [], 0
    while at < len(way) - 1:
        following = range(len(way) - 1, at + 1, -1)
        at = next((then for then in following if _clear(way[at], way[then], tolls)), at + 1)
        route.append(way[at][:2])
    return route


def _clear(start: Pose, end: Pose, tolls: Ints) -> bool:
    """Whether nothing is in the robot's way from one place straight to another."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    count = max(2, math.ceil(math.hypot(dx, dy) / SAMPLE))
    line = np.linspace((start[0], start[1]), (end[0], end[1]), count)
    heading = np.full((count, 1), math.atan2(-dx, dy))
    return bool((tolls[cells(np.concatenate([line, heading], axis=1))] == 0).all())


def _behind(x: float, y: float, heading: float, ahead: float) -> Pose:
    """Where the robot has the point (x, y) so far ahead."""
    return x + ahead * math.sin(heading), y - ahead * math.cos(heading), heading


def _carrying(x: float, y: float, heading: float, subgoal: Subgoal) -> float:
    """About how many actions it takes to bring a block from (x, y) to its target, taken with the given heading."""
    robot = _behind(x, y, heading, GRIP)
    dx, dy = subgoal.target[0] - robot[0], subgoal.target[1] - robot[1]
    turn = abs((math.atan2(-dx, dy) - heading + math.pi) % (2 * math.pi) - math.pi)
    way = math.hypot(dx, dy) - GRIP
    return 8 + turn * 3.5 + CARRYING * (way if way > 0 else -1.6 * way + 0.1)


def perform(world: Lookahead, manoeuvre: Manoeuvre, limit: int) -> bool:
    """Carry it out; whether it went as planned."""
    subgoal, block = manoeuvre.subgoal, manoeuvre.subgoal.block
    if block is None:
        return drive(world, manoeuvre.route, Gripper.OPEN, limit, within=subgoal.tolerance)
    drive(world, manoeuvre.route, Gripper.OPEN, limit, within=VIA)
    taken = _take(world, block, limit)
    carried = taken and _carry(world, block, manoeuvre, limit)
    _let_go(world, block, limit, FREE if taken else FAR)
    return carried


def _take(world: Lookahead, block: int, limit: int) -> bool:
    """Drive so that the block comes between the fingers, and close them; whether it is held."""
    patience = Patience()
    while len(world.trace) < limit and not _within(world, block, REACHED):
        right, ahead = world.seen(block)
        if patience.ends(ahead + 0.3 * abs(math.atan2(-right, ahead))):
            return False
        world.act(*steer(world, world.block(block), GRIP, Gripper.OPEN, reverse=False))
    if len(world.trace) < limit:
        world.act(Gripper.CLOSE)
    return _within(world, block, LOST)


def _within(world: Lookahead, block: int, box: Point) -> bool:
    """Whether a block is at most so far ahead of the robot, and at most so far aside."""
    right, ahead = world.seen(block)
    return 0 < ahead < box[0] and abs(right) < box[1]


def _carry(world: Lookahead, block: int, manoeuvre: Manoeuvre, limit: int) -> bool:
    """Drive until the block is at its target; whether it is."""
    subgoal = manoeuvre.subgoal
    for _ in range(CORRECTIONS):
        left = limit - len(world.trace)
        if left <= 0 or not _within(world, block, LOST):
            return False
        tolls, ahead = toll(obstacles(world.scene(), block), loaded=True), world.seen(block)[1]
        goal = Goal(ahead, *subgoal.target, subgoal.tolerance / 2)
        route = _route(world, goal, tolls, min(left, REACH))
        drive(
            world, route, Gripper.CLOSE, limit, ahead=ahead, within=0.7 * subgoal.tolerance, reverse=manoeuvre.reverse
        )
        if math.dist(world.block(block), subgoal.target) <= subgoal.tolerance:
            return True
    return False


def _route(world: Lookahead, goal: Goal, tolls: Ints, limit: int) -> list[Point]:
    """Through which points to drive so that what is ahead of the robot comes to its goal."""
    x, y, _ = world.robot
    dx, dy = goal.x - x, goal.y - y
    distance = math.hypot(dx, dy)
    share = 1 - goal.ahead / distance if distance else 0.0
    end = (x + share * dx, y + share * dy, 0.0)
    if share <= 0 or _clear((x, y, 0.0), end, tolls):
        return [(goal.x, goal.y)]
    ways = explore(world.robot, tolls, limit, goal)
    gaps = np.hypot(*(places(ways.poses, goal.ahead) - (goal.x, goal.y)).T)
    costs = ways.steps + MISSED * gaps + MISSED_BY_FAR * np.clip(gaps - goal.within, 0, None)
    way = ways.to(int(costs.argmin()))
    return [*simplified(way, tolls)[:-1], (goal.x, goal.y)]


def _let_go(world: Lookahead, block: int, limit: int, distance: float) -> None:
    """Open the fingers and back off until the block is far enough ahead, with a moment of waiting for the fingers."""
    for number in range(min(BACKING, limit - len(world.trace))):
        if world.seen(block)[1] > distance:
            return
        world.act(Gripper.OPEN, Turn.NONE, Drive.NONE if number == 1 else Drive.BACK)
