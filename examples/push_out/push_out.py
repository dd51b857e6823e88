"""PushOut: push every block out of the goal region.

Goal
    No block's centre is in the region when the episode ends.

What varies
    Colour draws the colours of the region and of every block, Shape every block's shape. CountPlus has 1 to 3 blocks
    (the demo has 2). All blocks start in the region.

Score
    The share of the blocks that are outside the region.

Differences from the original
    The original benchmark does not have this task.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.scene.constants import COLOURS
from magical_mj.tasks.planning import Noise, Subgoal, bring, places_outside, scene_after
from magical_mj.tasks.rules import any_colours, any_shapes, inside, pick, require, require_regions, uniform_integer
from magical_mj.tasks.spec import Rules, TaskSpec

DEMO: Final = Scene(
    robot=Robot(0.6, -0.6, 0.4),
    blocks=(Block("square", "red", -0.35, 0.35, 0.3), Block("circle", "blue", -0.05, 0.05, 0.0)),
    regions=(GoalRegion("green", -0.6, -0.2, 0.2, 0.6),),
)


def colour(rng: np.random.Generator, scene: Scene) -> Scene:
    """Gives the region and each block independent uniform colours."""
    (region,) = scene.regions
    return any_colours(rng, replace(scene, regions=(replace(region, colour=pick(rng, COLOURS)),)))


def count(rng: np.random.Generator, scene: Scene) -> Scene:
    """Draws 1 to 3 blocks."""
    return replace(scene, blocks=(scene.blocks * 2)[: uniform_integer(rng, 1, 3)])


def check(scene: Scene) -> None:
    """Raises an `InvalidSceneError` unless there is one goal region, with a block in it."""
    require_regions(scene, "PushOut", 1)
    require(bool(inside(scene.regions[0], scene.blocks)), "PushOut", "a block in the goal region, and it is empty")


def score(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """The share of the blocks that are outside the region."""
    return 1 - len(inside(final.regions[0], final.blocks)) / len(final.blocks)


def plan(initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """Brings every block in the region to the nearest free position outside of it.

    `scene_after` returns the scene after the subgoals so far; `places_outside` returns positions clear of all regions.
    """
    todo: list[Subgoal] = []
    for number in inside(now.regions[0], now.blocks):
        todo.append(bring(scene_after(now, todo), number, places_outside(now.regions), noise))
    return todo


SPEC: Final = TaskSpec(
    name="PushOut",
    summary="push every block out of the goal region",
    demo=DEMO,
    steps=120,
    score=score,
    check=check,
    plan=plan,
    demonstrations=Path(__file__).parent / "push_out_demonstrations",
    colour=colour,
    shape=any_shapes,
    count=count,
    region_size=(0.7, 0.9),  # layouts draw the region's sides between these (world units)
    inner_margin=0.1,  # and keep the blocks' centres at least this far inside of it
)
