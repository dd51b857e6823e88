"""What to do, as subgoals: the cheapest rearrangement of a scene that solves its task. No simulator here.

Every task has a function that lists what is still to be done in a scene: which block goes where. Costs are in
actions, roughly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from magical_mj.experts.arrangements import cluster_targets, line_targets
from magical_mj.experts.noise import Noise
from magical_mj.scene import GoalRegion, Scene
from magical_mj.tasks import SPECS
from magical_mj.tasks.move_to_corner import CORNER, FULL_SCORE_DISTANCE

FETCHING: Final = 14  # actions to go to a block, take it and let go of it
CARRYING: Final = 11  # actions to carry it one unit
SPREAD: Final = 8.0  # actions by which noise makes a place better or worse
CHOICE: Final = 20.0  # likewise for one of several blocks
TOLERANCE: Final = 0.06  # so near its target a block is there
APART: Final = 0.27  # between the centres of blocks that do not touch
CROWDED: Final = 1000.0  # actions for each unit by which they are nearer
INSIDE, OUTSIDE = 0.08, 0.06  # from the border of a goal region
REACHABLE: Final = 0.84  # blocks are left within this square
GRID: Final = 0.06

Point = tuple[float, float]


@dataclass(frozen=True)
class Subgoal:
    """Bring a block somewhere, or with `block` None only the robot."""

    block: int | None
    target: Point
    tolerance: float = TOLERANCE

    def left(self, scene: Scene) -> float:
        """How far there still is to go; 0 if it is done."""
        thing = scene.robot if self.block is None else scene.blocks[self.block]
        way = math.dist((thing.x, thing.y), self.target)
        return 0.0 if way <= self.tolerance else way

    def cost(self, scene: Scene) -> float:
        """About how many actions it still takes."""
        way = self.left(scene)
        return FETCHING + CARRYING * way if way else 0.0


Subgoals = tuple[Subgoal, ...]


def subgoals(task: str, initial: Scene, now: Scene, noise: Noise) -> Subgoals:
    """What is still to be done; nothing if the task is solved.

    Args:
        task: a task's name.
        initial: the scene at the start.
        now: the present scene.
        noise: which of several good plans it is.
    """
    if SPECS[task].score(initial, now, "paper") >= 1.0:
        return ()
    return _PLANS[task](initial, now, noise)


def done(scene: Scene, todo: Iterable[Subgoal]) -> Scene:
    """The scene as it would be if all subgoals were done, and nothing else changed."""
    poses = [block.pose for block in scene.blocks]
    robot = scene.robot.pose
    for subgoal in todo:
        if subgoal.left(scene) == 0.0:
            continue
        if subgoal.block is None:
            robot = (*subgoal.target, robot[2])
        else:
            poses[subgoal.block] = (*subgoal.target, poses[subgoal.block][2])
    return scene.moved(robot, poses)


def _scattered(x_min: float, y_min: float, x_max: float, y_max: float, noise: Noise) -> list[Point]:
    """Points that fill a box, one in each cell of a grid and nowhere exactly; its middle if the box is empty."""
    if x_min >= x_max or y_min >= y_max:
        return [((x_min + x_max) / 2, (y_min + y_max) / 2)]
    columns, rows = (math.ceil((high - low) / GRID) for low, high in ((x_min, x_max), (y_min, y_max)))
    at = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), axis=-1) + noise.rng.random(
        (columns, rows, 2)
    )
    points = at / (columns, rows) * (x_max - x_min, y_max - y_min) + (x_min, y_min)
    return [(x, y) for x, y in points.reshape(-1, 2).tolist()]


def _everywhere(noise: Noise) -> list[Point]:
    """Places for a block anywhere in the arena."""
    return _scattered(-REACHABLE, -REACHABLE, REACHABLE, REACHABLE, noise)


def _inside(region: GoalRegion, noise: Noise) -> list[Point]:
    """Places for a block in a region."""
    box = (region.x_min + INSIDE, region.y_min + INSIDE, region.x_max - INSIDE, region.y_max - INSIDE)
    x_min, y_min, x_max, y_max = (max(-REACHABLE, min(REACHABLE, side)) for side in box)
    return _scattered(x_min, y_min, x_max, y_max, noise)


def _nearest(scene: Scene, block: int, places: Iterable[Point], noise: Noise) -> Subgoal:
    """The subgoal to bring a block to the nearest of the places that no other block takes."""
    here = scene.blocks[block]

    def cost(place: Point) -> float:
        crowding = sum(
            max(0.0, APART - math.dist(place, (other.x, other.y)))
            for number, other in enumerate(scene.blocks)
            if number != block
        )
        return CARRYING * math.dist(place, (here.x, here.y)) + CROWDED * crowding + noise(SPREAD)

    return Subgoal(block, min(places, key=cost))


def _move_to_corner(initial: Scene, now: Scene, noise: Noise) -> Subgoals:
    near = FULL_SCORE_DISTANCE - 2 * TOLERANCE
    places = [place for place in _everywhere(noise) if math.dist(place, CORNER) < near]
    return (_nearest(now, 0, places, noise),)


def _move_to_region(initial: Scene, now: Scene, noise: Noise) -> Subgoals:
    robot = now.robot
    places = _inside(now.regions[0], noise)
    place = min(places, key=lambda at: CARRYING * math.dist(at, (robot.x, robot.y)) + noise(SPREAD))
    return (Subgoal(None, place, tolerance=0.04),)


def _match_regions(initial: Scene, now: Scene, noise: Noise) -> Subgoals:
    (region,) = now.regions
    todo, scene = [], now
    for number, block in enumerate(now.blocks):
        if block.colour == region.colour and not region.contains(block):
            todo.append(_nearest(scene, number, _inside(region, noise), noise))
        elif block.colour != region.colour and region.contains(block):
            todo.append(_nearest(scene, number, _outside(now, noise), noise))
        scene = done(scene, todo)
    return tuple(todo)


def _find_dupe(initial: Scene, now: Scene, noise: Noise) -> Subgoals:
    (region,) = now.regions
    (query,) = (number for number, block in enumerate(initial.blocks) if region.contains(block))
    kind = now.blocks[query].shape, now.blocks[query].colour
    alike = [n for n, block in enumerate(now.blocks) if (block.shape, block.colour) == kind and n != query]
    todo = [
        _nearest(now, number, _outside(now, noise), noise)
        for number, block in enumerate(now.blocks)
        if region.contains(block) and number != query and number not in alike
    ]
    if not region.contains(now.blocks[query]):
        todo.append(_nearest(now, query, _inside(region, noise), noise))
    if not any(region.contains(now.blocks[number]) for number in alike):
        choices = [_nearest(now, number, _inside(region, noise), noise) for number in alike]
        todo.append(min(choices, key=lambda subgoal: subgoal.cost(now) + noise(CHOICE)))
    return tuple(todo)


def _outside(scene: Scene, noise: Noise) -> list[Point]:
    """Places for a block outside of all regions."""

    def clear(place: Point, region: GoalRegion) -> bool:
        aside = max(region.x_min - place[0], place[0] - region.x_max, region.y_min - place[1], place[1] - region.y_max)
        return aside >= OUTSIDE

    return [place for place in _everywhere(noise) if all(clear(place, region) for region in scene.regions)]


def _fix_colour(initial: Scene, now: Scene, noise: Noise) -> Subgoals:
    todo, scene = [], now
    for region in now.regions:
        (home,) = (number for number, block in enumerate(initial.blocks) if region.contains(block))
        odd = initial.blocks[home].colour != region.colour
        if odd and any(other.contains(now.blocks[home]) for other in now.regions):
            todo.append(_nearest(scene, home, _outside(now, noise), noise))
        elif not odd and not region.contains(now.blocks[home]):
            todo.append(_nearest(scene, home, _inside(region, noise), noise))
        scene = done(scene, todo)
    return tuple(todo)


def _moves(targets: Sequence[Point | None], tolerance: float) -> Subgoals:
    """The subgoals of a plan that has a target, or None, for each block."""
    return tuple(Subgoal(n, target, tolerance) for n, target in enumerate(targets) if target is not None)


def _make_line(initial: Scene, now: Scene, noise: Noise) -> Subgoals:
    return _moves(line_targets([(block.x, block.y) for block in now.blocks], noise), 0.07)


def _cluster_by(attribute: str) -> Callable[[Scene, Scene, Noise], Subgoals]:
    def plan(initial: Scene, now: Scene, noise: Noise) -> Subgoals:
        kinds = [getattr(block, attribute) for block in now.blocks]
        return _moves(cluster_targets([(block.x, block.y) for block in now.blocks], kinds, noise), 0.09)

    return plan


_PLANS: Final[Mapping[str, Callable[[Scene, Scene, Noise], Subgoals]]] = MappingProxyType(
    {
        "MoveToCorner": _move_to_corner,
        "MoveToRegion": _move_to_region,
        "MatchRegions": _match_regions,
        "MakeLine": _make_line,
        "FindDupe": _find_dupe,
        "FixColour": _fix_colour,
        "ClusterColour": _cluster_by("colour"),
        "ClusterShape": _cluster_by("shape"),
    }
)
