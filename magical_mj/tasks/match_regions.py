"""MatchRegions: bring all blocks of the goal region's colour, and only them, into the region.

Goal
    Every target (a block of the region's colour) is in the region, and no distractor (any other block) is.

What varies
    Colour draws one colour for the region and all targets. The distractors take the
    other three in the order red, green, blue, yellow, so that none of them becomes a target. Shape draws
    every block's shape. CountPlus draws 1 or 2 targets and 0 to 2 distractors for each other colour.
    There is always one region, and every block starts outside it.

Score
    (targets in region / targets) x (1 - distractors in region / blocks in region); 0 if the region is empty.

Remaining distance
    The sum of these distances, each with 0.3 added if it is above 0: from each target's centre to the region, and from
    the centre of each distractor in the region to the nearest side with room for a block between it and the wall. At
    most 3.1 for each block.

Differences from the original
    None.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.scene.constants import COLOURS, REGION_SIZE, Colour
from magical_mj.tasks.planning import Noise, Subgoal, bring, places_inside, places_outside, scene_after
from magical_mj.tasks.rules import (
    any_shapes,
    coloured,
    inside,
    pick,
    require,
    require_regions,
    uniform_integer,
    way_in,
    way_out,
)
from magical_mj.tasks.spec import Rules, TaskSpec

DEMO: Final = Scene(
    robot=Robot(-0.5, 0.1, -3.7699111843077517),
    blocks=(
        Block("star", "green", 0.8, -0.7, 2.37),
        Block("square", "green", -0.68, 0.72, 1.28),
        Block("pentagon", "blue", -0.05, -0.2, -1.09),
        Block("circle", "yellow", -0.75, -0.55, 2.78),
        Block("pentagon", "yellow", 0.3, -0.82, -1.15),
    ),
    regions=(GoalRegion("green", 0.1, 0.0, 0.7, 0.7),),
)

MAX_TARGETS: Final = 2
MAX_DISTRACTORS: Final = 2
"""The maximum number for each colour other than the region's, in the CountPlus variant."""


def _others(colour: Colour) -> list[Colour]:
    return [other for other in COLOURS if other != colour]


def colour(rng: np.random.Generator, scene: Scene) -> Scene:
    """A uniform colour for region and targets. Distractors of the same colour keep a common colour."""
    (region,) = scene.regions
    target = pick(rng, COLOURS)
    new = dict(zip(_others(region.colour), _others(target), strict=True))
    new[region.colour] = target
    scene = replace(scene, regions=(replace(region, colour=target),))
    return coloured(scene, (new[block.colour] for block in scene.blocks))


def count(rng: np.random.Generator, scene: Scene) -> Scene:
    """1 or 2 targets, and 0 to 2 distractors of each other colour. Targets come first, as in the demo."""
    target = scene.regions[0].colour
    numbers: dict[Colour, int] = {target: uniform_integer(rng, 1, MAX_TARGETS)}
    for other in _others(target):
        numbers[other] = uniform_integer(rng, 0, MAX_DISTRACTORS)
    colours: list[Colour] = [colour for colour, number in numbers.items() for _ in range(number)]
    models = [scene.blocks[index % len(scene.blocks)] for index in range(len(colours))]
    return coloured(replace(scene, blocks=tuple(models)), colours)


def check(scene: Scene) -> None:
    """Raises an `InvalidSceneError` unless there is exactly one goal region and a block of its colour."""
    require_regions(scene, "MatchRegions", 1)
    wanted = scene.regions[0].colour
    has_target = any(block.colour == wanted for block in scene.blocks)
    require(has_target, "MatchRegions", f"at least one block of the goal region's colour, which is {wanted}")


def score(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """The share of targets in the region, times 1 - the share of distractors in it. The same under both rules."""
    (region,) = final.regions
    inner = inside(region, final.blocks)
    if not inner:
        return 0.0
    is_target = [block.colour == region.colour for block in final.blocks]
    inner_targets = sum(is_target[index] for index in inner)
    return (inner_targets / sum(is_target)) * (inner_targets / len(inner))


def distance(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """The distances of targets into the region, and of distractors out of it."""
    (region,) = final.regions
    return sum(
        way_in(region, block) if block.colour == region.colour else way_out(region, block, final.half_width)
        for block in final.blocks
    )


def plan(initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """Targets move into the region and distractors out of it, each to a position that is then free."""
    (region,) = now.regions
    todo: list[Subgoal] = []
    scene = now
    for number, block in enumerate(now.blocks):
        if block.colour == region.colour and not region.contains(block):
            todo.append(bring(scene, number, places_inside(region), noise))
        elif block.colour != region.colour and region.contains(block):
            todo.append(bring(scene, number, places_outside(now.regions), noise))
        scene = scene_after(scene, todo)
    return todo


SPEC: Final = TaskSpec(
    name="MatchRegions",
    summary="bring all blocks of the region's colour, and no others, into the goal region",
    demo=DEMO,
    steps=120,
    score=score,
    distance=distance,
    check=check,
    plan=plan,
    colour=colour,
    shape=any_shapes,
    count=count,
    region_size=REGION_SIZE,
)
