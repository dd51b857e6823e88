"""Routes around blocks: the next point on the way to a block, and with it to its place, by search on a map.

The map and the search are those of the experts. They need the scene, but no simulation.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_intents.scenes import ROBOT, scene_of
from magical_mj.experts.manoeuvres import manoeuvres, obstacles, simplified
from magical_mj.experts.navigation import EMPTY, LOADED, Goal, cell_costs, explore, farthest, points_ahead
from magical_mj.scene import Scene
from magical_mj.scene.bodies import GRIPPER, body_named
from magical_mj.tasks.planning import Noise, Point, Subgoal

FARTHEST: Final = 90
"""The longest route, in actions."""
VIA: Final = 0.13
"""A point is reached at this distance (units)."""
HELD, LOST = 0.38, 0.46
"""A block nearer to the robot (units) may be held; a held block that is farther is lost."""
CLOSED: Final = 0.33
"""The fingers hold a block if their mean angle is smaller (rad)."""
ARRIVED: Final = 0.07
"""A block this near to its place needs no route."""
RENEWED: Final = 12
"""A route is planned again after this number of steps."""
FAR: Final = 0.8
"""The robot looks for another route if a block that it has approached is farther."""
WITHIN: Final = 0.03
"""A route should end this near to the place (units)."""
MISSED, MISSED_BY_FAR = 60.0, 1000.0
"""The cost (actions) of each unit between a route's end and the place, and of each unit beyond `WITHIN`."""


class Guide:
    """Says where to go to bring an object to its place: the next point of the robot, or of the block if it is held.

    Args:
        number: the number of the block, or `ROBOT`.
        place: where it is brought.
    """

    def __init__(self, number: int, place: Point) -> None:
        self._number, self._place = number, place
        self._route: list[Point] | None = None
        self._held, self._age = False, 0

    def __call__(self, state: NDArray[np.float32]) -> Point:
        """The point in this state (names,)."""
        scene = scene_of(state)
        at, end = scene.robot.pose[:2], self._place
        if self._number != ROBOT:
            block = scene.blocks[self._number].pose[:2]
            if math.dist(block, end) < ARRIVED:
                return end
            apart, open_by = math.dist(at, block), sum(map(abs, scene.robot.fingers)) / 2
            held = apart < (LOST if self._held else HELD) and open_by < CLOSED
            if held != self._held or (not held and not self._route and apart > FAR):
                self._held, self._route = held, None
            at, end = (block, end) if held else (at, block)
        self._age += 1
        if self._route is None or (self._route and self._age > RENEWED):
            self._age = 0
            find = carrying if self._held else approach
            self._route = find(scene, self._number, self._place)
        while self._route and math.dist(self._route[0], at) < VIA:
            self._route.pop(0)
        return self._route[0] if self._route else end


def approach(scene: Scene, number: int, place: Point) -> list[Point]:
    """The points of the robot on the best way to a block that is brought to a place; or to the place itself."""
    costs = cell_costs(obstacles(scene), EMPTY)
    tree = explore(scene.robot.pose, costs, FARTHEST)
    subgoal = Subgoal(None if number == ROBOT else number, place)
    options = manoeuvres(tree, costs, scene, subgoal, Noise(np.random.default_rng(0), 0.0), body_named(GRIPPER))
    return list(min(options, key=lambda option: option.estimate).route) if options else []


def carrying(scene: Scene, number: int, place: Point) -> list[Point]:
    """The points of a held block on the way to its place."""
    x, y, _ = scene.robot.pose
    ahead = math.dist((x, y), scene.blocks[number].pose[:2])
    costs = cell_costs(obstacles(scene, number), LOADED)
    distance = math.dist((x, y), place)
    share = 1 - ahead / distance if distance else 0.0
    end = (x + share * (place[0] - x), y + share * (place[1] - y), 0.0)
    if share <= 0 or farthest([(x, y, 0.0), end], 0, costs):
        return [place]
    tree = explore(scene.robot.pose, costs, FARTHEST, Goal(ahead, *place, WITHIN))
    gaps = np.hypot(*(points_ahead(tree.poses, ahead) - place).T)
    totals = tree.steps + MISSED * gaps + MISSED_BY_FAR * np.clip(gaps - WITHIN, 0, None)
    return [*simplified(tree.path_to(int(totals.argmin())), costs)[:-1], place]
