"""Plans of tasks: subgoals and their target positions. Pure geometry, without a simulator. Costs are in actions.

A plan gives blocks and their target positions, and experts find the actions. It is part of a task (`TaskSpec.plan`).

The second half finds low-cost target positions that form a line or clusters. A line goes through one of the blocks,
which stays. All directions, spacings and orders are compared. Clusters are found by local search: the best move of one
block to one position is made, until no move is an improvement. A block may also return to its current position, at no
cost, so that only the necessary blocks are moved.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene import GoalRegion, Scene
from magical_mj.utils.errors import PlacementError

Floats = NDArray[np.float64]
Point = tuple[float, float]

FETCHING: Final = 14  # cost of driving to a block, gripping it and releasing it
CARRYING: Final = 11  # cost of carrying it one unit
SPREAD: Final = 2.0  # the largest change of a position's cost by noise
WANDER: Final = 10.0  # the largest change of a position's cost by noise, if only the robot moves
CHOICE: Final = 3.0  # the largest change of a block's cost by noise, where one of several blocks is chosen
TOLERANCE: Final = 0.12  # a block this close to its target has reached it
APART: Final = 0.27  # distance between the centres of blocks that do not touch
CROWDED_COST: Final = 1000.0  # cost for each unit that two blocks are closer than `APART`, or `CLUSTER_APART`
INSIDE, OUTSIDE = 0.14, 0.16  # distances from the border of a goal region
REACHABLE: Final = 0.84  # blocks are placed within this square (half side)
GRID: Final = 0.06

# Lines, with the costs FETCHING and CARRYING
SPACINGS: Final = (0.29, 0.34, 0.39)  # between neighbours; blocks are up to 0.31 wide, the score allows gaps up to 0.42
ANGLES: Final = 24
STAYS: Final = 0.09  # a block this near to its target position is not moved
LINE_SPREAD: Final = 12.0  # the largest change of a line's cost by noise
# the number of cheapest plans that are checked: blocks that stay near their targets may leave too large a gap
CHECKED: Final = 500
SPARE: Final = 1.05  # safety factor: the rule must still hold if distances grow by this factor
FIXED_COST: Final = 1000.0  # cost of moving a block that should stay
LINE_LIMIT: Final = 0.84  # lines end within this square

# Clusters
CLUSTER_FETCHING, CLUSTER_CARRYING, CLUSTER_APART = 16.0, 13.0, 0.28  # instead of FETCHING, CARRYING and APART
WRONG_COST: Final = 60.0  # cost of a block that is nearer to another kind
SAFE: Final = 0.6  # a block is safe if its squared distance to its kind is below this share of the limit
DOUBTFUL, HOPELESS = 0.7, 2.2  # the cost of a wrong block rises between these shares
PITCH: Final = 0.14  # pitch of the grid of positions
CLUSTER_LIMIT: Final = 0.78  # positions are within this square (half side)
STARTS: Final = 3
CLUSTER_SPREAD: Final = 30.0  # the largest change of a layout's cost by noise
ROUNDS: Final = 24


class Noise:
    """Random amounts that are added to costs before the minimum is chosen, so that experts solve a task differently.

    Args:
        rng: the random generator.
        strength: 0 for the plan with the least estimated cost, 1 for the variety of an expert.
    """

    def __init__(self, rng: np.random.Generator, strength: float) -> None:
        self.rng, self.strength = rng, strength

    def __call__(self, spread: float, shape: tuple[int, ...] = ()) -> Any:
        """Independent uniform draws between 0 and `spread` times the strength; a float, or an array of this shape."""
        draws = spread * self.strength * self.rng.random(shape)
        return draws if shape else float(draws)


@dataclass(frozen=True)
class Subgoal:
    """Move a block to a position. If `block` is None, move the robot."""

    block: int | None
    target: Point
    tolerance: float = TOLERANCE

    def left(self, scene: Scene) -> float:
        """The remaining distance (world units); 0 if the subgoal is reached."""
        body = scene.robot if self.block is None else scene.blocks[self.block]
        distance = math.dist((body.x, body.y), self.target)
        return 0.0 if distance <= self.tolerance else distance

    def cost(self, scene: Scene) -> float:
        """The approximate number of remaining actions."""
        distance = self.left(scene)
        return FETCHING + CARRYING * distance if distance else 0.0


Subgoals = tuple[Subgoal, ...]


def scene_after(scene: Scene, subgoals: Iterable[Subgoal]) -> Scene:
    """The scene after all subgoals are reached, if nothing else changes."""
    robot, blocks = scene.robot, list(scene.blocks)
    for subgoal in subgoals:
        if subgoal.left(scene) == 0.0:
            continue
        x, y = subgoal.target
        if subgoal.block is None:
            robot = replace(robot, x=x, y=y)
        else:
            blocks[subgoal.block] = replace(blocks[subgoal.block], x=x, y=y)
    return replace(scene, robot=robot, blocks=tuple(blocks))


def _grid_points(x_min: float, y_min: float, x_max: float, y_max: float) -> list[Point]:
    """The centres of a grid's cells in a box; the box's middle if it is empty."""
    if x_min >= x_max or y_min >= y_max:
        return [((x_min + x_max) / 2, (y_min + y_max) / 2)]
    columns, rows = (math.ceil((high - low) / GRID) for low, high in ((x_min, x_max), (y_min, y_max)))
    at = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), axis=-1) + 0.5
    points = at / (columns, rows) * (x_max - x_min, y_max - y_min) + (x_min, y_min)
    return [(x, y) for x, y in points.reshape(-1, 2).tolist()]


def places_anywhere() -> list[Point]:
    """Positions for a block anywhere in the arena."""
    return _grid_points(-REACHABLE, -REACHABLE, REACHABLE, REACHABLE)


def places_inside(region: GoalRegion) -> list[Point]:
    """Positions for a block in a region."""
    box = (region.x_min + INSIDE, region.y_min + INSIDE, region.x_max - INSIDE, region.y_max - INSIDE)
    x_min, y_min, x_max, y_max = (max(-REACHABLE, min(REACHABLE, side)) for side in box)
    return _grid_points(x_min, y_min, x_max, y_max)


def places_outside(regions: Sequence[GoalRegion]) -> list[Point]:
    """Positions for a block outside all these regions."""

    def clear(place: Point, region: GoalRegion) -> bool:
        aside = max(region.x_min - place[0], place[0] - region.x_max, region.y_min - place[1], place[1] - region.y_max)
        return aside >= OUTSIDE

    return [place for place in places_anywhere() if all(clear(place, region) for region in regions)]


def bring(scene: Scene, block: int, places: Iterable[Point], noise: Noise) -> Subgoal:
    """The subgoal of bringing a block to the nearest free position.

    Raises:
        PlacementError: if `places` is empty.
    """
    here = scene.blocks[block]

    def cost(place: Point) -> float:
        crowding = sum(
            max(0.0, APART - math.dist(place, (other.x, other.y)))
            for number, other in enumerate(scene.blocks)
            if number != block
        )
        return CARRYING * math.dist(place, (here.x, here.y)) + CROWDED_COST * crowding + noise(SPREAD)

    return Subgoal(block, _cheapest(places, cost, f"block {block}"))


def drive(scene: Scene, places: Iterable[Point], noise: Noise, tolerance: float) -> Subgoal:
    """The subgoal of driving the robot to the nearest of the positions.

    Raises:
        PlacementError: if `places` is empty.
    """
    here = scene.robot

    def cost(place: Point) -> float:
        return CARRYING * math.dist(place, (here.x, here.y)) + noise(WANDER)

    return Subgoal(None, _cheapest(places, cost, "the robot"), tolerance)


def _cheapest(places: Iterable[Point], cost: Callable[[Point], float], what: str) -> Point:
    """The position with the least cost for a block or the robot (`what`)."""
    place = min(places, key=cost, default=None)
    if place is None:
        raise PlacementError(f"a plan has no position for {what}: the scene has no free space left")
    return place


def each_to(targets: Sequence[Point | None], tolerance: float) -> list[Subgoal]:
    """The subgoals of an arrangement. It has a target for each block, or None for blocks that stay."""
    return [Subgoal(number, target, tolerance) for number, target in enumerate(targets) if target is not None]


def line_targets(
    points: Sequence[Point], are_lines: Callable[[Floats], Iterable[bool]], noise: Noise, fixed: Collection[int] = ()
) -> list[Point | None]:
    """A target for each block, or None for blocks that stay.

    Lines go through one of the blocks, which stays. All directions, spacings and positions of that block in the line
    are tried, with all orders of the other blocks.

    Args:
        points: the blocks' positions.
        are_lines: whether each arrangement of the blocks, shape (n, blocks, 2), forms a line; iterated until one does.
        noise: selects one of several good lines.
        fixed: the blocks that should stay, if possible.
    """
    here = np.array(points)
    count = len(here)
    lines = _lines(here, noise)
    if not len(lines):  # too many blocks for a line in the arena
        return [None] * count
    distances = np.linalg.norm(lines[:, :, None] - here, axis=-1)  # (line, slot, block)
    costs = np.where(distances <= STAYS, 0.0, FETCHING + CARRYING * distances)
    costs[:, :, list(fixed)] += FIXED_COST * (distances[:, :, list(fixed)] > STAYS)
    orders = np.array(list(itertools.permutations(range(count))))  # (order, slot): the block in each slot
    totals = costs[:, np.arange(count), orders[:, None]].reshape(len(lines), len(orders), count).sum(axis=-1)
    totals += noise(LINE_SPREAD, totals.shape)

    line, order = np.divmod(totals.ravel().argsort()[:CHECKED], len(orders))
    blocks = orders[order]  # (plan, slot)
    moved = distances[line[:, None], np.arange(count), blocks] > STAYS
    plan, slot = moved.nonzero()
    ends = np.repeat(here[None], len(line), axis=0)
    ends[plan, blocks[plan, slot]] = lines[line[plan], slot]
    lined_up = (end for end, is_line in zip(ends, are_lines(SPARE * ends), strict=True) if is_line)
    return _targets(next(lined_up, ends[-1]), here)


def _lines(here: Floats, noise: Noise) -> Floats:
    """The positions in lines through each of the blocks at these points. Shape (lines, slots, 2)."""
    count = len(here)
    angles = (np.arange(ANGLES) + noise.rng.random()) * math.pi / ANGLES
    pairs = here[None] - here[:, None]
    angles = np.concatenate([angles, np.arctan2(pairs[..., 1], pairs[..., 0])[~np.eye(count, dtype=bool)]])
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    offsets = np.arange(count) - np.arange(count)[:, None]  # offsets of the slots, by the block's slot
    steps = offsets * np.array(SPACINGS)[:, None, None]  # (spacing, slot of the block, slot)
    lines = steps[:, :, None, :, None] * directions[:, None]  # (spacing, slot of the block, direction, slot, 2)
    places = (here[:, None, None, None, None] + lines).reshape(-1, count, 2)
    return places[(np.abs(places) <= LINE_LIMIT).all(axis=(1, 2))]


def _targets(ends: Floats, here: Floats) -> list[Point | None]:
    """The blocks' target positions; None for blocks that stay."""
    return [
        None if (end == start).all() else (float(end[0]), float(end[1])) for end, start in zip(ends, here, strict=True)
    ]


def cluster_targets(
    points: Sequence[Point], kinds: Sequence[str], nearer: float, noise: Noise, fixed: Collection[int] = ()
) -> list[Point | None]:
    """A target for each block, or None for blocks that stay.

    Args:
        points: the blocks' positions.
        kinds: each block's colour or shape, the criterion of the clusters.
        nearer: the factor between a block's squared distances to the nearest other centroid and to its own.
        noise: selects one of several good layouts.
        fixed: the blocks that must stay.
    """
    if len(fixed) == len(points):
        return [None] * len(points)
    here = np.array(points)
    values = sorted(set(kinds))
    members = np.array([[kind == value for kind in kinds] for value in values], float)
    best, best_cost = here, np.inf
    for number in range(STARTS):
        start = here.copy() if number == 0 else _gathered(here, members, noise)
        start[list(fixed)] = here[list(fixed)]
        layout, cost = _improved(here, start, members, nearer, noise, fixed)
        cost += noise(CLUSTER_SPREAD)
        if cost < best_cost:
            best, best_cost = layout, cost
    return _targets(best, here)


def _gathered(here: Floats, members: Floats, noise: Noise) -> Floats:
    """A start of the search, with each kind gathered at one position: near its own or another kind's blocks."""
    middles = members @ here / members.sum(axis=1, keepdims=True)
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    centres = 0.5 * middles + 0.5 * corners[noise.rng.permutation(4)][np.arange(len(middles)) % 4]
    return members.T @ centres + noise.rng.normal(0, 0.1, here.shape)


def _improved(
    here: Floats, start: Floats, members: Floats, nearer: float, noise: Noise, fixed: Collection[int]
) -> tuple[Floats, float]:
    axis = np.arange(-CLUSTER_LIMIT, CLUSTER_LIMIT + 1e-9, PITCH)
    places = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    places = np.clip(places + noise.rng.uniform(-PITCH / 2, PITCH / 2, places.shape), -CLUSTER_LIMIT, CLUSTER_LIMIT)
    layout, cost = start, np.inf
    for _ in range(ROUNDS):
        options = [
            _layouts(layout, block, np.concatenate([places, here[block : block + 1]]))
            for block in range(len(here))
            if block not in fixed
        ]
        layouts = np.concatenate(options)
        costs = _costs(layouts, here, members, nearer)
        best = int(costs.argmin())
        if costs[best] >= cost - 1e-9:
            break
        layout, cost = layouts[best], float(costs[best])
    return layout, cost


def _layouts(layout: Floats, block: int, places: Floats) -> Floats:
    """The layouts with one block at each of the positions. Shape (positions, blocks, 2)."""
    layouts = np.repeat(layout[None], len(places), axis=0)
    layouts[:, block] = places
    return layouts


def _costs(layouts: Floats, here: Floats, members: Floats, nearer: float) -> Floats:
    """The cost of moving the blocks to each layout, plus penalties for wrong blocks. Shape (layouts,)."""
    ways = np.sqrt(_squared(layouts, here))
    moved = ways > 0
    cost = (moved * CLUSTER_FETCHING + CLUSTER_CARRYING * ways).sum(axis=-1)
    centres = members @ layouts / members.sum(axis=1, keepdims=True)
    squares = _squared(layouts[:, :, None], centres[:, None])  # (layout, block, kind)
    own = (squares * members.T).sum(axis=-1)
    nearest = np.where(members.T > 0, np.inf, squares).min(axis=-1)
    share = nearer * own / np.maximum(nearest, 1e-9)
    # makes the cost slope towards layouts with fewer wrong blocks
    doubt = np.clip(share / SAFE, DOUBTFUL, HOPELESS) - DOUBTFUL
    cost += WRONG_COST * (doubt + (share > SAFE)).sum(axis=-1)
    gaps = np.sqrt(_squared(layouts[:, :, None], layouts[:, None]))
    crowded = np.clip(CLUSTER_APART - gaps, 0, None) * (moved[:, :, None] | moved[:, None, :])
    first = np.triu(np.ones(gaps.shape[1:]), 1)
    return cost + CROWDED_COST * (crowded * first).sum(axis=(1, 2))


def _squared(points: Floats, others: Floats) -> Floats:
    """Squared distances between points. The last axis contains x and y."""
    dx, dy = points[..., 0] - others[..., 0], points[..., 1] - others[..., 1]
    return dx * dx + dy * dy
