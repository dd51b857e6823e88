"""Manoeuvres, carried out in the imagination: go to a block, take it, carry it, let go and back off."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.actions import Drive, Gripper, Turn
from magical_mj.experts.driving import follow
from magical_mj.experts.errands import CARRYING, Errand
from magical_mj.experts.imagination import Imagination
from magical_mj.experts.navigation import GRIP, Ways, cells, explore, toll
from magical_mj.scene import Pose, Scene

BLOCK_RADIUS: Final = {"square": 0.125, "pentagon": 0.13, "star": 0.14, "circle": 0.12}
BEFORE: Final = (0.46, 0.68)  # how far ahead of the robot a block is before it is taken
ASIDE: Final = 0.1  # and at most how far to the side
SIDES: Final = 16  # from which a block can be taken
TIGHT: Final = 1.5  # actions for each of toll on the way to a block
WALLED: Final = 12  # toll where a finger is in a wall, by calculation: now and then it still works
CENTRED: Final = 0.17  # rad, so straight ahead must a block be
HELD: Final = 0.35  # so near must it come
LOST: Final = 0.44  # so far away it is not held any more
FREE: Final = 0.42


@dataclass(frozen=True)
class Manoeuvre:
    """An errand, and how to begin it."""

    errand: Errand
    approach: list[Pose]
    estimate: float
    """About how many actions it takes."""


def obstacles(scene: Scene, without: int | None = None) -> NDArray[np.float64]:
    """x, y, radius of each block but one. Shape (n, 3)."""
    found = [(b.x, b.y, BLOCK_RADIUS[b.shape]) for number, b in enumerate(scene.blocks) if number != without]
    return np.array(found).reshape(-1, 3)


def manoeuvres(ways: Ways, scene: Scene, errand: Errand) -> list[Manoeuvre]:
    """The ways to begin an errand: for each side of the block the quickest."""
    if errand.block is None:
        nodes = np.flatnonzero(np.hypot(*(ways.poses[:, :2] - errand.target).T) <= errand.tolerance)
        best = nodes[ways.steps[nodes].argsort()[:4]]
        return [Manoeuvre(errand, ways.to(node), float(ways.steps[node])) for node in best.tolist()]
    block = scene.blocks[errand.block]
    tolls = toll(obstacles(scene, errand.block), loaded=True)
    x, y, angle = ways.poses.T
    right = np.cos(angle) * (block.x - x) + np.sin(angle) * (block.y - y)
    ahead = np.cos(angle) * (block.y - y) - np.sin(angle) * (block.x - x)
    near = np.flatnonzero((np.abs(right) < ASIDE) & (BEFORE[0] < ahead) & (ahead < BEFORE[1]))
    sides = np.round(angle[near] * SIDES / (2 * math.pi)).astype(int) % SIDES
    found = []
    for side in np.unique(sides).tolist():
        nodes = near[sides == side]
        node = int(nodes[ways.steps[nodes].argmin()])
        heading = side * 2 * math.pi / SIDES
        stops = [_behind(block.x, block.y, heading, ahead) for ahead in (GRIP, GRIP + 0.07, GRIP + 0.14)]
        tight = tolls[cells(np.array(stops))]
        tight[tight < 0] = WALLED
        estimate = ways.steps[node] + TIGHT * tight.sum() + _carrying(block.x, block.y, heading, errand)
        found.append(Manoeuvre(errand, ways.to(node), float(estimate)))
    return found


def _behind(x: float, y: float, heading: float, ahead: float) -> Pose:
    """Where the robot has the point (x, y) so far ahead."""
    return x + ahead * math.sin(heading), y - ahead * math.cos(heading), heading


def _carrying(x: float, y: float, heading: float, errand: Errand) -> float:
    """About how many actions it takes to bring a block from (x, y) to its target, taken with the given heading."""
    robot = _behind(x, y, heading, GRIP)
    dx, dy = errand.target[0] - robot[0], errand.target[1] - robot[1]
    turn = abs((math.atan2(-dx, dy) - heading + math.pi) % (2 * math.pi) - math.pi)
    way = math.hypot(dx, dy) - GRIP
    return 8 + turn * 3.5 + CARRYING * (way if way > 0 else -1.6 * way + 0.1)


def perform(world: Imagination, manoeuvre: Manoeuvre, limit: int) -> bool:
    """Carry it out; whether it went as planned."""
    errand = manoeuvre.errand
    approached = follow(world, manoeuvre.approach, Gripper.CLOSE, limit)
    if errand.block is None:
        return approached
    if not _take(world, errand.block, limit):
        return False
    carried = _carry(world, errand.block, errand, limit)
    _let_go(world, errand.block, limit)
    return carried


def _take(world: Imagination, block: int, limit: int) -> bool:
    """Drive so that the block comes between the fingers, and close them; whether it is held."""
    nearest, patience = math.inf, 0
    while len(world.trace) < limit:
        right, ahead = world.seen(block)
        aside = math.atan2(-right, ahead)
        if ahead < HELD and abs(right) < 0.1:
            break
        if ahead > nearest - 0.01:
            patience += 1
            if patience > 8:
                break
        nearest = min(nearest, ahead)
        turn = Turn.NONE if abs(aside) < CENTRED else Turn.LEFT if aside > 0 else Turn.RIGHT
        world.act(Gripper.OPEN, turn, Drive.FORWARD if abs(aside) < 0.4 else Drive.NONE)
    if len(world.trace) < limit:
        world.act(Gripper.CLOSE)
    right, ahead = world.seen(block)
    return ahead < LOST and abs(right) < 0.12


def _carry(world: Imagination, block: int, errand: Errand, limit: int) -> bool:
    """Drive until the block is at its target."""
    for _ in range(2):
        left = limit - len(world.trace)
        if left <= 0:
            return False
        scene = world.scene()
        ahead = world.seen(block)[1]
        if ahead > LOST:
            return False
        ways = explore(world.robot, toll(obstacles(scene, block), loaded=True), min(left, 80))
        gaps = np.hypot(*(ways.places(ahead) - errand.target).T)
        cost = ways.steps + 60 * gaps + 1000 * np.clip(gaps - errand.tolerance, 0, None)
        follow(world, ways.to(int(cost.argmin())), Gripper.CLOSE, left)
        if math.dist(world.block(block), errand.target) <= errand.tolerance:
            return True
    return False


def _let_go(world: Imagination, block: int, limit: int) -> None:
    """Open the fingers and back off."""
    for _ in range(8):
        if len(world.trace) >= limit or world.seen(block)[1] > FREE:
            return
        world.act(Gripper.OPEN, Turn.NONE, Drive.BACK)
