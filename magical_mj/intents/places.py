"""Slack: by how much a relation holds for a block, or for the robot, at each of some positions.

The slack is a distance (world units). Below 0, the relation does not hold. Plans use it to choose positions with a
margin. The relations `line` and `clustered` have no slack, since they depend on the positions of several blocks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.intents.relations import (
    ANY,
    APART,
    AT_WALL,
    CORNERS,
    HOME,
    NEAR,
    STAYED,
    WALLS,
    Conjunct,
)
from magical_mj.intents.selectors import block_of, homes
from magical_mj.scene import GoalRegion, Scene
from magical_mj.tasks.move_to_corner import FULL_SCORE_DISTANCE

Floats = NDArray[np.float64]
"""Positions have the shape (n, 2), and slacks (n,)."""
Slack = Callable[[Scene, Floats], Floats]
"""(current scene, positions) -> the slack at each of them. The object itself is not part of the current scene."""


def slack_of(conjunct: Conjunct, initial: Scene, block: int | None, chosen: Sequence[int] = ()) -> Slack:
    """The slack of a conjunct for one of its blocks, or for the robot.

    Args:
        conjunct: one with a slack.
        initial: the initial scene of the episode.
        block: the block's index; None for the robot.
        chosen: the blocks that the conjunct is about.
    """
    name, argument = conjunct.relation, conjunct.argument
    match name:
        case "in" if argument == HOME and block is not None and (home := homes(initial)[block]) is not None:
            return lambda _, places: _depth(initial.regions[home], places)
        case "in" | "exactly" | "robot in":
            return lambda _, places: np.max([_depth(region, places) for region in initial.regions], axis=0)
        case "out":
            return lambda _, places: np.min([-_depth(region, places) for region in initial.regions], axis=0)
        case "wall" | "robot wall":
            sides = list(WALLS.values()) if argument == ANY else [WALLS[argument]]
            return lambda scene, places: (places @ np.array(sides).T).max(axis=1) - scene.half_width + AT_WALL
        case "corner":
            corners = list(CORNERS.values()) if argument == ANY else [CORNERS[argument]]
            return lambda scene, places: (
                FULL_SCORE_DISTANCE
                - np.min([distances(places, (u * scene.half_width, v * scene.half_width)) for u, v in corners], axis=0)
            )
        case "near" | "robot near":
            reference = block_of(argument, initial)
            return lambda scene, places: NEAR - distances(places, scene.blocks[reference].pose)
        case "untouched" if block is not None:
            return lambda _, places: STAYED - distances(places, initial.blocks[block].pose)
        case "apart":
            others = [index for index in chosen if index != block]
            return lambda scene, places: (
                np.min([distances(places, scene.blocks[index].pose) for index in others], axis=0, initial=math.inf)
                - APART
            )
        case _:
            raise NotImplementedError(name)


def distances(places: Floats, point: Sequence[float]) -> Floats:
    """The distances of positions from a point; an angle after its x and y is ignored."""
    return np.hypot(places[:, 0] - point[0], places[:, 1] - point[1])


def _depth(region: GoalRegion, places: Floats) -> Floats:
    """The distance of each position from the border of a region, negative outside."""
    x, y = places.T
    return np.minimum.reduce([x - region.x_min, region.x_max - x, y - region.y_min, region.y_max - y])


ARRANGED: Final = ("line", "clustered")
"""The relations without a slack. A plan arranges their blocks together."""
