"""Manoeuvres, carried out by lookahead: go to a block, take it, carry it, let go and back off."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.actions import Drive, Gripper, Turn
from magical_mj.experts.driving import follow
from magical_mj.experts.lookahead import Lookahead
from magical_mj.experts.navigation import GRIP, Goal, Ways, cells, explore, places, toll
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
DETOUR: Final = 4.0  # actions by which noise makes a way longer or shorter
DRIVES: Final = 4  # ways tried where only the robot has to go somewhere

# Taking a block
CENTRED: Final = 0.17  # rad, so straight ahead it must be before the robot stops turning
BEARING: Final = 0.4  # rad, so straight ahead before the robot drives
REACHED: Final = (0.35, 0.1)  # ahead, aside: it is between the fingers
LOST: Final = (0.44, 0.12)  # it is not held any more
PROGRESS, PATIENCE = 0.01, 8  # so much nearer must it come, or after so many actions the robot gives up

# Carrying it, letting go
REACH: Final = 80  # actions, the longest way
CORRECTIONS: Final = 2  # ways driven, the second if the first did not end where it should
MISSED: Final = 60.0  # actions that a unit of distance from the target counts as, within the tolerance
MISSED_BY_FAR: Final = 1000.0  # and beyond it
FREE: Final = 0.42  # ahead: so far off, the robot can turn
BACKING: Final = 8  # actions


@dataclass(frozen=True)
class Manoeuvre:
    """A subgoal, and how to begin it."""

    subgoal: Subgoal
    approach: list[Pose]
    estimate: float
    """About how many actions it takes."""


def obstacles(scene: Scene, without: int | None = None) -> NDArray[np.float64]:
    """x, y, radius of each block but one. Shape (n, 3)."""
    found = [(b.x, b.y, BLOCK_RADIUS[b.shape]) for number, b in enumerate(scene.blocks) if number != without]
    return np.array(found).reshape(-1, 3)


def manoeuvres(ways: Ways, scene: Scene, subgoal: Subgoal, noise: Noise) -> list[Manoeuvre]:
    """The ways to begin a subgoal: for each side of the block one of the quickest."""
    if subgoal.block is None:
        nodes = np.flatnonzero(np.hypot(*(ways.poses[:, :2] - subgoal.target).T) <= subgoal.tolerance)
        best = nodes[(ways.steps[nodes] + noise(DETOUR, nodes.shape)).argsort()[:DRIVES]]
        return [Manoeuvre(subgoal, ways.to(node), float(ways.steps[node])) for node in best.tolist()]
    block = scene.blocks[subgoal.block]
    tolls = toll(obstacles(scene, subgoal.block), loaded=True)
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
        tight = tolls[cells(np.array(stops))]
        tight[tight < 0] = WALLED
        estimate = ways.steps[node] + TIGHT * tight.sum() + _carrying(block.x, block.y, heading, subgoal)
        found.append(Manoeuvre(subgoal, ways.to(node), float(estimate)))
    return found


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
    subgoal = manoeuvre.subgoal
    approached = follow(world, manoeuvre.approach, Gripper.CLOSE, limit)
    if subgoal.block is None:
        return approached
    if not _take(world, subgoal.block, limit):
        return False
    carried = _carry(world, subgoal.block, subgoal, limit)
    _let_go(world, subgoal.block, limit)
    return carried


def _take(world: Lookahead, block: int, limit: int) -> bool:
    """Drive so that the block comes between the fingers, and close them; whether it is held."""
    nearest, waited = math.inf, 0
    while len(world.trace) < limit and not _within(world, block, REACHED):
        right, ahead = world.seen(block)
        waited += ahead > nearest - PROGRESS
        if waited > PATIENCE:
            break
        nearest = min(nearest, ahead)
        bearing = math.atan2(-right, ahead)  # to the left
        turn = Turn.NONE if abs(bearing) < CENTRED else Turn.LEFT if bearing > 0 else Turn.RIGHT
        world.act(Gripper.OPEN, turn, Drive.FORWARD if abs(bearing) < BEARING else Drive.NONE)
    if len(world.trace) < limit:
        world.act(Gripper.CLOSE)
    return _within(world, block, LOST)


def _within(world: Lookahead, block: int, box: tuple[float, float]) -> bool:
    """Whether a block is at most so far ahead of the robot, and at most so far aside."""
    right, ahead = world.seen(block)
    return ahead < box[0] and abs(right) < box[1]


def _carry(world: Lookahead, block: int, subgoal: Subgoal, limit: int) -> bool:
    """Drive until the block is at its target; whether it is."""
    for _ in range(CORRECTIONS):
        left = limit - len(world.trace)
        if left <= 0 or not _within(world, block, LOST):
            return False
        tolls, ahead = toll(obstacles(world.scene(), block), loaded=True), world.seen(block)[1]
        ways = explore(world.robot, tolls, min(left, REACH), Goal(ahead, *subgoal.target, subgoal.tolerance / 2))
        gaps = np.hypot(*(places(ways.poses, ahead) - subgoal.target).T)
        costs = ways.steps + MISSED * gaps + MISSED_BY_FAR * np.clip(gaps - subgoal.tolerance, 0, None)
        follow(world, ways.to(int(costs.argmin())), Gripper.CLOSE, left)
        if math.dist(world.block(block), subgoal.target) <= subgoal.tolerance:
            return True
    return False


def _let_go(world: Lookahead, block: int, limit: int) -> None:
    """Open the fingers and back off."""
    for _ in range(min(BACKING, limit - len(world.trace))):
        if world.seen(block)[1] > FREE:
            return
        world.act(Gripper.OPEN, Turn.NONE, Drive.BACK)
