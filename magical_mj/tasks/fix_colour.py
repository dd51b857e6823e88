"""FixColour: find the block whose colour differs from its goal region's and push it out.

Goal
    Each goal region starts with one block in it. Exactly one block, the mismatched one, differs in colour from its
    region. At the end, the mismatched block is in no region, and every other block is in its own.

What varies
    Colour draws every region's colour independently, with repeats. Every block has its region's colour, except
    one, which has one of the other three. Shape draws every block's shape. CountPlus has 2 or 3 regions with
    their blocks (the demo has 3). A block starts with its centre in its region, but it may stick out.

Score
    1 if the mismatched block is in no region and every other region contains exactly its own block, else 0.

Remaining distance
    The sum of these distances, each with 0.3 added if it is above 0. For the mismatched block: out of the region that
    contains it. For each other block: into its own region, and out of other regions (except the mismatched block's).
    Distances are from a block's centre to the nearest side. On the way out, only sides with room for a block between
    them and the wall count. At most 3.1 for each block.

Differences from the original
    The mismatched block's colour is uniform over the three others. The released code never makes it yellow
    in a red or green region, and its draws are also uneven otherwise. Its Jitter first moves the blocks to the middle
    of their regions. Ours jitters them around their demo positions, as in the paper.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.scene.constants import COLOURS, FIX_COLOUR_REGION_SIZE
from magical_mj.tasks.planning import Noise, Subgoal, bring, places_inside, places_outside, scene_after
from magical_mj.tasks.rules import (
    any_shapes,
    coloured,
    inside,
    pick,
    pick_each,
    require,
    uniform_integer,
    way_in,
    way_out,
)
from magical_mj.tasks.spec import Rules, TaskSpec

DEMO: Final = Scene(  # block i is that of region i; the third is mismatched
    robot=Robot(0.368, 0.586, 0.718),
    blocks=(
        Block("pentagon", "green", 0.289, 0.03, 0.307),
        Block("square", "green", 0.133, -0.561, 1.699),
        Block("pentagon", "blue", -0.336, 0.0, -1.529),
    ),
    regions=(
        GoalRegion("green", -0.032, -0.079, 0.436, 0.348),
        GoalRegion("green", 0.019, -0.851, 0.477, -0.391),
        GoalRegion("red", -0.681, -0.302, -0.263, 0.196),
    ),
)


def colour(rng: np.random.Generator, scene: Scene) -> Scene:
    """Independent uniform region colours. A uniformly chosen block gets one of the three wrong colours."""
    colours = pick_each(rng, COLOURS, len(scene.regions))
    regions = tuple(replace(region, colour=new) for region, new in zip(scene.regions, colours, strict=True))
    odd = uniform_integer(rng, 0, len(colours) - 1)
    colours[odd] = pick(rng, [other for other in COLOURS if other != colours[odd]])
    return coloured(replace(scene, regions=regions), colours)


def count(rng: np.random.Generator, scene: Scene) -> Scene:
    """2 or 3 regions with their blocks. The mismatched one is last in the demo, and is always kept."""
    number = uniform_integer(rng, 2, len(scene.regions))
    return replace(scene, blocks=scene.blocks[-number:], regions=scene.regions[-number:])


def _homes(scene: Scene) -> list[list[int]]:
    """For each region the indices of the blocks in it. In an initial scene, this is only its own block."""
    return [inside(region, scene.blocks) for region in scene.regions]


def _mismatched(scene: Scene, homes: list[list[int]]) -> list[int]:
    """Indices of the regions whose own block has another colour."""
    pairs = zip(scene.regions, homes, strict=True)
    return [index for index, (region, (own,)) in enumerate(pairs) if scene.blocks[own].colour != region.colour]


def check(scene: Scene) -> None:
    """Raises an `InvalidSceneError` unless each region has its own block and exactly one of these is mismatched."""
    require(len(scene.regions) > 0, "FixColour", "at least one goal region, but this has none")
    homes = _homes(scene)
    numbers = [len(blocks) for blocks in homes]
    one_each = set(numbers) == {1} and len({blocks[0] for blocks in homes}) == len(homes)
    require(one_each, "FixColour", f"exactly one block of its own in every goal region, but the numbers are {numbers}")
    odd = len(_mismatched(scene, homes))
    require(odd == 1, "FixColour", f"exactly one block whose colour differs from its goal region's, but this has {odd}")


def score(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """1.0 if the mismatched block has left its region and each other region contains just its own block, else 0.0.

    The initial scene determines each region's block and the mismatched one. The score is the same under
    both rules.
    """
    homes, now = _homes(initial), _homes(final)
    (odd,) = _mismatched(initial, homes)
    (odd_block,) = homes.pop(odd)
    return float(odd_block not in now.pop(odd) and now == homes)


def distance(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """The distance of the mismatched block out of all regions, and of the others into their own one."""
    left = 0.0
    for region, (home,) in zip(final.regions, _homes(initial), strict=True):
        odd = initial.blocks[home].colour != region.colour
        for number, block in enumerate(final.blocks):
            if number == home and not odd:
                left += way_in(region, block)
            elif number == home or not odd:
                left += way_out(region, block, final.half_width)
    return left


def plan(initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """The mismatched block leaves all regions, and the others return to their initial positions."""
    todo: list[Subgoal] = []
    scene = now
    for region in now.regions:
        (home,) = inside(region, initial.blocks)
        odd = initial.blocks[home].colour != region.colour
        if odd and any(other.contains(now.blocks[home]) for other in now.regions):
            todo.append(bring(scene, home, places_outside(now.regions), noise))
        elif not odd and not region.contains(now.blocks[home]):
            todo.append(bring(scene, home, places_inside(region), noise))
        scene = scene_after(scene, todo)
    return todo


SPEC: Final = TaskSpec(
    name="FixColour",
    summary="push the block whose colour differs from its goal region's out of it",
    demo=DEMO,
    steps=60,
    score=score,
    distance=distance,
    check=check,
    plan=plan,
    bodies=("gripper", "shortstick", "mediumstick"),
    colour=colour,
    shape=any_shapes,
    count=count,
    region_size=FIX_COLOUR_REGION_SIZE,
    inner_margin=0.12,
)
