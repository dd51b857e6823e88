"""MoveToRegion: drive the robot into the goal region.

Goal
    The centre of the robot's body is in the goal region when the episode ends.

What varies
    Position, size and colour of the region, and the robot's pose. The robot always starts outside. There are
    no blocks, so there are no Shape and CountPlus variants, and All is Layout, Colour and Dynamics.

Score
    1 if the robot's centre is in the region, borders included, else 0.

Remaining distance
    The distance from the robot's centre to the region, plus 0.3; 0 in the region. At most 3.1.

Differences from the original
    None.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from magical_mj.scene import GoalRegion, Robot, Scene
from magical_mj.scene.constants import COLOURS, REGION_SIZE
from magical_mj.tasks.planning import Noise, Subgoal, drive, places_inside
from magical_mj.tasks.rules import pick, require, require_regions, way_in
from magical_mj.tasks.spec import Rules, TaskSpec

DEMO: Final = Scene(
    robot=Robot(0.058, 0.53, -2.13),
    regions=(GoalRegion("blue", -0.62, -0.93, 0.13, -0.17),),
)


def colour(rng: np.random.Generator, scene: Scene) -> Scene:
    """The region gets a uniform colour."""
    return replace(scene, regions=(replace(scene.regions[0], colour=pick(rng, COLOURS)),))


def check(scene: Scene) -> None:
    """Raises an `InvalidSceneError` unless there is exactly one goal region and no block."""
    require_regions(scene, "MoveToRegion", 1)
    require(not scene.blocks, "MoveToRegion", f"no blocks, but this has {len(scene.blocks)}")


def score(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """1.0 if the robot's centre is in the region, else 0.0. The same under both rules."""
    return float(final.regions[0].contains(final.robot))


def distance(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """The robot's distance to the region."""
    return way_in(final.regions[0], final.robot)


def plan(initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """The robot drives to the nearest position in the region."""
    return [drive(now, places_inside(now.regions[0]), noise, tolerance=0.1)]


SPEC: Final = TaskSpec(
    name="MoveToRegion",
    summary="drive into the goal region",
    demo=DEMO,
    steps=40,
    score=score,
    distance=distance,
    check=check,
    plan=plan,
    colour=colour,
    region_size=REGION_SIZE,
    bodies=("gripper", "shortstick", "mediumstick"),
)
