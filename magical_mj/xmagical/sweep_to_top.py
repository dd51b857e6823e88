"""SweepToTop: push all debris to the top. x-magical's task (Zakka et al. 2021, XIRL), not part of the benchmark.

Goal
    The three pieces of debris, which are very light, are entirely inside the goal zone along the top wall.

What varies
    Layout: one y for all debris, U(-0.1, 0.5), and three of the four columns x = -0.8, -0.32, 0.16, 0.64, in random
    order. Shape: each piece's shape. Colour: each piece's colour and the zone's, which may differ. Dynamics: the five
    force caps. All: all four. The robot's pose and the zone's box are fixed. There is neither Jitter nor CountPlus.

Score
    The share of the debris whose bounding box is in the zone. As a reward, each step has this value ("sparse"), or
    minus the mean distance of the debris to y = 1, where debris above y = 0.88 counts as 0 ("dense").

Remaining distance
    In environments with the 60 tasks' rewards: the sum over the debris outside the zone of 0.3 and its distance to
    y = 0.88. At most 2.3 for each piece.

Differences from the original
    By default, the axes of a scene are drawn separately. With ``seeds="original"``, environments draw the scenes that
    the original draws. Everything else in this description is the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene import Block, Dynamics, GoalRegion, Robot, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.bodies import BODIES, GRIPPER
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.scene.geometry import block_outline, placed
from magical_mj.tasks.rules import (
    WRONG,
    any_shapes,
    coloured,
    pick,
    pick_each,
    require,
    require_regions,
    shaped,
    shuffled,
)
from magical_mj.tasks.spec import Rules, TaskSpec

DEBRIS_MASS: Final = 0.01
HALF_WIDTH: Final = 1.1  # half width of the arena, world units
COLUMNS: Final = (-0.8, -0.32, 0.16, 0.64)
ROWS: Final = (-0.1, 0.5)
DRIVE_FORCES: Final = (3.2, 5.5)
TARGET, ARRIVED = 1.0, 0.88  # the dense reward measures distances to y = TARGET; they count as 0 above y = ARRIVED
DIAGONAL: Final = 2 * math.sqrt(2)
"""The unit of distances in the state vector: the diagonal of an arena of half width 1."""
OPEN: Final = math.pi / 4
"""The angle between the open fingers."""

RewardKind = Literal["sparse", "dense"]
REWARDS: Final[tuple[RewardKind, ...]] = get_args(RewardKind)

DEMO: Final = Scene(
    robot=Robot(0.0, -0.6, 0.0),
    blocks=tuple(Block("square", "red", x, 0.0, 0.0, DEBRIS_MASS) for x in (-0.5, 0.0, 0.5)),
    regions=(GoalRegion("red", -1.2, 0.76, 1.2, 1.16, "solid"),),
    dynamics=Dynamics(drive_force=5.0),
    half_width=HALF_WIDTH,
)


def layout(rng: np.random.Generator, scene: Scene) -> Scene:
    """Three of the four columns in random order, in one row."""
    low, high = ROWS
    y = low + (high - low) * rng.random()
    return _at(scene, shuffled(rng, COLUMNS)[:3], y)


def colour(rng: np.random.Generator, scene: Scene) -> Scene:
    """The zone and each piece of debris get independent uniform colours."""
    zone = replace(scene.regions[0], colour=pick(rng, COLOURS))
    return replace(coloured(scene, pick_each(rng, COLOURS, len(scene.blocks))), regions=(zone,))


def check(scene: Scene) -> None:
    """Raises an `InvalidSceneError` unless there are three pieces of debris and one zone."""
    require_regions(scene, "SweepToTop", 1)
    require(len(scene.blocks) == 3, "SweepToTop", f"three blocks, but this has {len(scene.blocks)}")


def arrived(scene: Scene) -> NDArray[np.bool_]:
    """Whether each piece of debris is entirely inside the zone. Shape (3,)."""
    zone = scene.regions[0]
    inside = []
    for block in scene.blocks:
        if block.shape == "circle":
            x_min, x_max = block.x - c.BLOCK_SIZE, block.x + c.BLOCK_SIZE
            y_min, y_max = block.y - c.BLOCK_SIZE, block.y + c.BLOCK_SIZE
        else:
            corners = placed(block_outline(block.shape), block.pose)
            margin = c.SQUARE_MARGIN if block.shape == "square" else 0.0
            (x_min, y_min), (x_max, y_max) = corners.min(axis=0) - margin, corners.max(axis=0) + margin
        inside.append(zone.x_min <= x_min and zone.y_min <= y_min and x_max <= zone.x_max and y_max <= zone.y_max)
    return np.array(inside)


def score(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """The share of the debris that is entirely inside the zone. The same under both rules."""
    return float(arrived(final).mean())


def distance(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """The sum of the distances of the debris into the zone."""
    return sum(
        0.0 if there else WRONG + max(ARRIVED - block.y, 0.0)
        for block, there in zip(final.blocks, arrived(final), strict=True)
    )


def dense_reward(scene: Scene) -> float:
    """Minus the mean distance of the debris to y = 1, where debris above y = 0.88 counts as 0."""
    ys = np.array([block.y for block in scene.blocks])
    return -float(np.where(ys > ARRIVED, 0.0, np.abs(TARGET - ys)).mean())


def state_vector(scene: Scene) -> NDArray[np.float32]:
    """x-magical's state vector, in the order of its documentation. Shape (16,), with fingers (17,).

    The entries are the robot's x, y; x, y of each piece of debris; cosine and sine of the robot's angle; the distance
    of each piece to the robot's centre, and to y = 1, both in diagonals of MAGICAL's arena; and the opening of the
    fingers, in [0, 1].
    """
    robot, body = scene.robot, BODIES.get(scene.robot.body)
    debris = np.array([(block.x, block.y) for block in scene.blocks])
    away = np.hypot(*(debris - (robot.x, robot.y)).T) / DIAGONAL
    left = np.abs(TARGET - debris[:, 1]) / DIAGONAL
    heading = math.cos(robot.angle), math.sin(robot.angle)
    entries = [robot.x, robot.y, *debris.ravel(), *heading, *away, *left]
    if body is not None and body.fingers:
        entries.append(min(max((robot.fingers[0] - robot.fingers[1]) / OPEN, 0.0), 1.0))
    return np.array(entries, np.float32)


def original_scene(variant: str, rng: np.random.RandomState, body: str = GRIPPER) -> Scene:
    """The next scene that the original draws from its generator.

    The draws are, if the variant has them, in this order: five force caps, the zone's colour, the row, the columns, the
    shapes and the colours of the debris.
    """
    dynamic, layouts, shapes, colours = (variant in (name, "All") for name in ("Dynamics", "Layout", "Shape", "Colour"))
    scene = replace(DEMO, robot=replace(DEMO.robot, body=body))
    if dynamic:
        ranges = (DRIVE_FORCES, (0.7, 1.5), (2.5, 4.5), (1.0, 1.8), (0.07, 0.15))
        scene = replace(scene, dynamics=Dynamics(*(float(rng.uniform(*span)) for span in ranges)))
    if colours:
        zone = replace(scene.regions[0], colour=COLOURS[COLOURS.index(str(rng.choice(COLOURS)))])
        scene = replace(scene, regions=(zone,))
    if layouts:
        y = float(rng.uniform(*ROWS))
        scene = _at(scene, rng.choice(COLUMNS, size=3, replace=False).tolist(), y)
    if shapes:
        scene = shaped(scene, _chosen(rng, SHAPES))
    if colours:
        scene = coloured(scene, _chosen(rng, COLOURS))
    return scene


def _chosen(rng: np.random.RandomState, options: Sequence[str]) -> Any:
    return [str(name) for name in rng.choice(options, size=3)]


def _at(scene: Scene, columns: Sequence[float], y: float) -> Scene:
    return scene.moved(blocks=[(x, y, 0.0) for x in columns])


SPEC: Final = TaskSpec(
    name="SweepToTop",
    summary="push all debris into the zone at the top",
    demo=DEMO,
    steps=100,
    steps_of=(("longstick", 50),),
    score=score,
    distance=distance,
    check=check,
    jitter=False,
    layout=layout,
    colour=colour,
    shape=any_shapes,
    drive_forces=DRIVE_FORCES,
    region_size=(0.4, 2.4),
    bodies=tuple(BODIES),
    speeds=True,
)
