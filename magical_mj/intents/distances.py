"""How far relations are from holding: the slack at positions, for plans, and the remaining distance, for rewards.

The slack (world units) of a relation at a position is how far a block, or the robot, could move before the relation
stops holding. Below 0, the relation does not hold there. The relations `line` and `clustered` have no slack, since they
depend on the positions of several blocks.

The remaining distance of an intent is the sum over its relations, by the same formulas as those of the benchmark's
tasks. If a relation does not hold for an object, this adds `WRONG` and the distance to the nearest position where it
would hold. If one block of several is enough, the nearest counts. The remaining distance is 0 if and only if the intent
holds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.intents.intent import Intent
from magical_mj.intents.relations import (
    ANY,
    APART,
    AT_WALL,
    CORNERS,
    HOME,
    IN_CORNER,
    NEAR,
    ROBOT_AT_WALL,
    STAYED,
    WALLS,
    Conjunct,
)
from magical_mj.intents.selectors import block_of, homes, the_region
from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.tasks import cluster, make_line
from magical_mj.tasks.move_to_corner import FULL_SCORE_DISTANCE
from magical_mj.tasks.rules import WRONG, way_in, way_out

Floats = NDArray[np.float64]
"""Positions have the shape (n, 2), and slacks (n,)."""
Slack = Callable[[Scene, Floats], Floats]
"""(current scene, positions) -> the slack at each of them. The object itself is not part of the current scene."""
ARRANGED: Final = ("line", "clustered")
"""The relations without a slack. A plan arranges their blocks together."""


def slack_of(conjunct: Conjunct, initial: Scene, block: int | None, chosen: Sequence[int] = ()) -> Slack:
    """The slack of a conjunct for one of its blocks, or for the robot.

    Args:
        conjunct: one with a slack.
        initial: the initial scene of the episode.
        block: the block's index; None for the robot.
        chosen: the blocks that the conjunct selects.
    """
    name, argument = conjunct.relation, conjunct.argument
    match name:
        case "in" if argument == HOME and block is not None and (home := homes(initial)[block]) is not None:
            return lambda _, positions: _depth(initial.regions[home], positions)
        case "in" | "exactly" | "robot in":
            return lambda _, positions: np.max([_depth(region, positions) for region in initial.regions], axis=0)
        case "out":
            return lambda _, positions: np.min([-_depth(region, positions) for region in initial.regions], axis=0)
        case "wall" | "robot wall":
            sides = list(WALLS.values()) if argument == ANY else [WALLS[argument]]
            reach = AT_WALL if name == "wall" else ROBOT_AT_WALL
            return lambda scene, positions: (positions @ np.array(sides).T).max(axis=1) - scene.half_width + reach
        case "corner" | "near corner":
            corners = np.array(list(CORNERS.values()) if argument == ANY else [CORNERS[argument]])
            within = IN_CORNER if name == "corner" else FULL_SCORE_DISTANCE
            return lambda scene, positions: (
                within - np.min([distances(positions, corner) for corner in corners * scene.half_width], axis=0)
            )
        case "near" | "robot near":
            reference = block_of(argument, initial)
            return lambda scene, positions: NEAR - distances(positions, scene.blocks[reference].pose)
        case "untouched" if block is not None:
            return lambda _, positions: STAYED - distances(positions, initial.blocks[block].pose)
        case "apart":
            others = [index for index in chosen if index != block]
            return lambda scene, positions: (
                np.min([distances(positions, scene.blocks[index].pose) for index in others], axis=0, initial=math.inf)
                - APART
            )
        case _:
            raise NotImplementedError(name)


def distances(positions: Floats, point: Sequence[float] | Floats) -> Floats:
    """The distances of positions from a point; an angle after its x and y is ignored."""
    return np.hypot(positions[:, 0] - point[0], positions[:, 1] - point[1])


def _depth(region: GoalRegion, positions: Floats) -> Floats:
    """The distance of each position from the border of a region, negative outside."""
    x, y = positions.T
    return np.minimum.reduce([x - region.x_min, region.x_max - x, y - region.y_min, region.y_max - y])


def remaining(intent: Intent, initial: Scene, final: Scene) -> float:
    """How far an intent is from holding in the final scene (world units).

    Raises:
        UngroundedError: if a relation is undefined in the initial scene.
    """
    parts = zip(intent.conjuncts, intent.blocks(initial), intent.parts(initial, final), strict=True)
    return sum(_remaining(*part, initial, final) for part in parts if not all(part[2]))


def _remaining(
    conjunct: Conjunct, blocks: tuple[int, ...], parts: Sequence[bool], initial: Scene, final: Scene
) -> float:
    """The distance of a relation that does not hold."""
    chosen = [final.blocks[index] for index in blocks]
    match conjunct.relation:
        case "exactly":
            return _to_number(conjunct.number, chosen, final)
        case "line":
            return make_line.distance(initial, replace(final, blocks=tuple(chosen)))
        case "clustered":
            ways = cluster.ways(final, "colour" if conjunct.argument == "colour" else "shape")
            return sum(ways[index] for index in blocks)
        case "robot in" | "robot near" | "robot wall":
            return _of_object(conjunct, None, blocks, initial, final)
    judged = conjunct.judged(blocks, initial)
    if conjunct.any_of:
        return min(_of_object(conjunct, index, blocks, initial, final) for index in judged)
    wrong = [index for index, right in zip(judged, parts, strict=True) if not right]
    return sum(_of_object(conjunct, index, blocks, initial, final) for index in wrong)


def _to_number(number: int, blocks: list[Block], final: Scene) -> float:
    """The distances of the nearest blocks into the region if there are too few, or out of it if there are too many."""
    region = the_region(final)
    ways = sorted(way_in(region, block) for block in blocks)
    surplus = ways.count(0.0) - number
    outward = sorted(way_out(region, block, final.half_width) for block in blocks if region.contains(block))
    return sum(outward[:surplus]) if surplus > 0 else sum(ways[:number])


def _of_object(conjunct: Conjunct, index: int | None, blocks: tuple[int, ...], initial: Scene, final: Scene) -> float:
    """The distance that a block, or the robot, adds if the relation does not hold for it."""
    item: Block | Robot = final.robot if index is None else final.blocks[index]
    if conjunct.relation == "in" and conjunct.argument == HOME and index is not None:
        return way_in(final.regions[homes(initial)[index] or 0], item)
    if conjunct.relation in ("in", "robot in"):
        return min(way_in(region, item) for region in final.regions)
    if conjunct.relation == "out":
        return sum(way_out(region, item, final.half_width) for region in final.regions)
    slack = slack_of(conjunct, initial, index, blocks)(final, np.array([[item.x, item.y]]))
    return WRONG + max(-float(slack[0]), 0.0)
