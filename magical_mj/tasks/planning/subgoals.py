"""Subgoals: which block should go where, and the candidate places. Costs are approximate numbers of actions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from magical_mj.scene import GoalRegion, Scene
from magical_mj.utils.errors import PlacementError

FETCHING: Final = 14  # actions to drive to a block, grip it and release it
CARRYING: Final = 11  # actions to carry it one unit
SPREAD: Final = 2.0  # actions: the largest change of a place's cost by noise
WANDER: Final = 10.0  # the same where only the robot moves
CHOICE: Final = 3.0  # the same for the choice between several blocks
TOLERANCE: Final = 0.12  # a block this close to its target has reached it
APART: Final = 0.27  # between the centres of blocks that do not touch
CROWDED: Final = 1000.0  # actions for each unit by which they are closer than `APART`
INSIDE, OUTSIDE = 0.14, 0.16  # from the border of a goal region
REACHABLE: Final = 0.84  # blocks are left within this square
GRID: Final = 0.06

Point = tuple[float, float]


class Noise:
    """Random amounts that are added to costs before the least is chosen: so different experts solve a task differently.

    Args:
        rng: the random generator.
        strength: 0 for the plan that seems best, 1 for the variety of an expert.
    """

    def __init__(self, rng: np.random.Generator, strength: float) -> None:
        self.rng, self.strength = rng, strength

    def __call__(self, spread: float, shape: tuple[int, ...] = ()) -> Any:
        """Independent uniform draws between 0 and `spread` times the strength; a float, or an array of this shape."""
        draws = spread * self.strength * self.rng.random(shape)
        return draws if shape else float(draws)


@dataclass(frozen=True)
class Subgoal:
    """Bring a block to a place, or, if `block` is None, the robot itself."""

    block: int | None
    target: Point
    tolerance: float = TOLERANCE

    def left(self, scene: Scene) -> float:
        """The remaining distance (world units); 0 if the subgoal is reached."""
        thing = scene.robot if self.block is None else scene.blocks[self.block]
        way = math.dist((thing.x, thing.y), self.target)
        return 0.0 if way <= self.tolerance else way

    def cost(self, scene: Scene) -> float:
        """The approximate number of remaining actions."""
        way = self.left(scene)
        return FETCHING + CARRYING * way if way else 0.0


Subgoals = tuple[Subgoal, ...]


def scene_after(scene: Scene, subgoals: Iterable[Subgoal]) -> Scene:
    """The scene after all subgoals are reached, if nothing else changes."""
    poses = [block.pose for block in scene.blocks]
    robot = scene.robot.pose
    for subgoal in subgoals:
        if subgoal.left(scene) == 0.0:
            continue
        if subgoal.block is None:
            robot = (*subgoal.target, robot[2])
        else:
            poses[subgoal.block] = (*subgoal.target, poses[subgoal.block][2])
    return scene.moved(robot, poses)


def _scattered(x_min: float, y_min: float, x_max: float, y_max: float) -> list[Point]:
    """Points that fill a box, one in each cell of a grid; its middle if the box is empty."""
    if x_min >= x_max or y_min >= y_max:
        return [((x_min + x_max) / 2, (y_min + y_max) / 2)]
    columns, rows = (math.ceil((high - low) / GRID) for low, high in ((x_min, x_max), (y_min, y_max)))
    at = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), axis=-1) + 0.5
    points = at / (columns, rows) * (x_max - x_min, y_max - y_min) + (x_min, y_min)
    return [(x, y) for x, y in points.reshape(-1, 2).tolist()]


def places_anywhere() -> list[Point]:
    """Places for a block anywhere in the arena."""
    return _scattered(-REACHABLE, -REACHABLE, REACHABLE, REACHABLE)


def places_inside(region: GoalRegion) -> list[Point]:
    """Places for a block in a region."""
    box = (region.x_min + INSIDE, region.y_min + INSIDE, region.x_max - INSIDE, region.y_max - INSIDE)
    x_min, y_min, x_max, y_max = (max(-REACHABLE, min(REACHABLE, side)) for side in box)
    return _scattered(x_min, y_min, x_max, y_max)


def places_outside(regions: Sequence[GoalRegion]) -> list[Point]:
    """Places for a block outside of all these regions."""

    def clear(place: Point, region: GoalRegion) -> bool:
        aside = max(region.x_min - place[0], place[0] - region.x_max, region.y_min - place[1], place[1] - region.y_max)
        return aside >= OUTSIDE

    return [place for place in places_anywhere() if all(clear(place, region) for region in regions)]


def bring(scene: Scene, block: int, places: Iterable[Point], noise: Noise) -> Subgoal:
    """The subgoal of bringing a block to the nearest place that no other block occupies.

    Raises:
        PlacementError: if there are no places.
    """
    here = scene.blocks[block]

    def cost(place: Point) -> float:
        crowding = sum(
            max(0.0, APART - math.dist(place, (other.x, other.y)))
            for number, other in enumerate(scene.blocks)
            if number != block
        )
        return CARRYING * math.dist(place, (here.x, here.y)) + CROWDED * crowding + noise(SPREAD)

    return Subgoal(block, _cheapest(places, cost, f"block {block}"))


def drive(scene: Scene, places: Iterable[Point], noise: Noise, tolerance: float) -> Subgoal:
    """The subgoal of driving the robot to the nearest of the places.

    Raises:
        PlacementError: if there are no places.
    """
    here = scene.robot

    def cost(place: Point) -> float:
        return CARRYING * math.dist(place, (here.x, here.y)) + noise(WANDER)

    return Subgoal(None, _cheapest(places, cost, "the robot"), tolerance)


def _cheapest(places: Iterable[Point], cost: Callable[[Point], float], what: str) -> Point:
    """The place with the least cost for a block or the robot (`what`)."""
    place = min(places, key=cost, default=None)
    if place is None:
        raise PlacementError(f"a plan has no place for {what}: the scene leaves no room, as for blocks between regions")
    return place


def each_to(targets: Sequence[Point | None], tolerance: float) -> list[Subgoal]:
    """The subgoals of an arrangement with a target for each block, or None for blocks that stay."""
    return [Subgoal(number, target, tolerance) for number, target in enumerate(targets) if target is not None]
