"""FindDupe: bring a duplicate of the block in the goal region into the region.

Goal
    One block, the query, starts in the goal region. At the end, the region contains the query, at least one other
    block with its shape and colour, and no other blocks.

What varies
    Colour and Shape draw the query's colour or shape, and the guaranteed duplicate has the same. Those of the
    distractors are drawn independently: a distractor that happens to match in both is another duplicate. If colours
    are drawn, the region has the query's colour. CountPlus has 1 to 5 distractors (the demo has 5), so 3 to 7
    blocks. All blocks except the query start outside the region. The query starts with its centre inside.

Score
    [query in region] x [another block of its shape and colour in region]
    x (1 - distractors in region / blocks in region), where the query counts as a block in the region.

Remaining distance
    The sum of these distances, each with 0.3 added if it is above 0: from the query's centre to the region, from the
    nearest duplicate's centre to the region, and from the centre of each distractor in the region to the nearest side
    with room for a block between it and the wall. By the released code's rules, the two nearest blocks like the query
    count instead of query and duplicate. At most 3.1 for each block.

Differences from the original
    The released code accepts any two blocks with the query's attributes, including or without the query
    (rules="released"). This differs only if there are several duplicates. Its Jitter first moves the
    query to the middle of the region. Ours jitters it around its demo position, as in the paper.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.scene.constants import COLOURS, REGION_SIZE, SHAPES
from magical_mj.tasks.planning import CHOICE, Noise, Subgoal, bring, places_inside, places_outside
from magical_mj.tasks.rules import (
    coloured,
    inside,
    pick,
    pick_each,
    require,
    require_regions,
    shaped,
    uniform_integer,
    way_in,
    way_out,
)
from magical_mj.tasks.spec import Rules, TaskSpec

DEMO: Final = Scene(  # five distractors, the duplicate, and the query; the rules keep this order
    robot=Robot(-0.57, 0.25, 3.83),
    blocks=(
        Block("pentagon", "green", -0.066751, 0.7552, -2.9266),
        Block("circle", "red", -0.05195, 0.31468, 1.5418),
        Block("circle", "red", 0.57528, -0.46865, -2.2141),
        Block("square", "yellow", 0.40594, -0.74977, 0.24582),
        Block("star", "blue", 0.45254, 0.3681, -1.0834),
        Block("pentagon", "yellow", 0.76849, -0.10652, 0.10028),
        Block("pentagon", "yellow", -0.33, -0.49, -0.51),
    ),
    regions=(GoalRegion("yellow", -0.72, -0.89, 0.0, -0.22),),
)


def colour(rng: np.random.Generator, scene: Scene) -> Scene:
    """A uniform colour for query, duplicate and region; independent uniform ones for the distractors."""
    query = pick(rng, COLOURS)
    scene = replace(scene, regions=(replace(scene.regions[0], colour=query),))
    return coloured(scene, [*pick_each(rng, COLOURS, len(scene.blocks) - 2), query, query])


def shape(rng: np.random.Generator, scene: Scene) -> Scene:
    """A uniform shape for query and duplicate; independent uniform ones for the distractors."""
    query = pick(rng, SHAPES)
    return shaped(scene, [*pick_each(rng, SHAPES, len(scene.blocks) - 2), query, query])


def count(rng: np.random.Generator, scene: Scene) -> Scene:
    """1 to 5 distractors."""
    *distractors, duplicate, query = scene.blocks
    return replace(scene, blocks=(*distractors[: uniform_integer(rng, 1, len(distractors))], duplicate, query))


def _alike(scene: Scene, query: int) -> set[int]:
    """The indices of all blocks with the query's shape and colour, including the query's."""
    wanted = scene.blocks[query]
    return {i for i, b in enumerate(scene.blocks) if (b.shape, b.colour) == (wanted.shape, wanted.colour)}


def check(scene: Scene) -> None:
    """Raises an `InvalidSceneError` unless there is one region with one block in it, and a duplicate outside."""
    require_regions(scene, "FindDupe", 1)
    inner = inside(scene.regions[0], scene.blocks)
    require(len(inner) == 1, "FindDupe", f"exactly one block (the query) in the goal region, but this has {len(inner)}")
    query = scene.blocks[inner[0]]
    has_duplicate = len(_alike(scene, inner[0])) > 1
    require(has_duplicate, "FindDupe", f"another {query.colour} {query.shape}, like the query, outside the goal region")


def score(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """The share of blocks like the query among the blocks in the region; 0 unless it and a duplicate are inside.

    The query is the block in the region of the initial scene.
    """
    (query,) = inside(initial.regions[0], initial.blocks)
    inner = inside(final.regions[0], final.blocks)
    alike = _alike(final, query).intersection(inner)
    satisfied = len(alike) >= 2 and (query in inner or rules == "released")
    return len(alike) / len(inner) if satisfied else 0.0


def distance(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """The distances of the query and the nearest duplicate into the region, and of distractors out of it."""
    (region,) = final.regions
    (query,) = inside(initial.regions[0], initial.blocks)
    alike = _alike(final, query)
    distances = {number: way_in(region, final.blocks[number]) for number in alike}
    if rules == "paper":
        pair = distances.pop(query) + min(distances.values())
    else:
        nearest, second, *_ = sorted(distances.values())
        pair = nearest + second
    others = (block for number, block in enumerate(final.blocks) if number not in alike)
    return pair + sum(way_out(region, block, final.half_width) for block in others)


def plan(initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """Distractors leave the region, the query returns to it if necessary, and a duplicate moves into it."""
    (region,) = now.regions
    (query,) = inside(region, initial.blocks)
    alike = sorted(_alike(now, query) - {query})
    todo = [
        bring(now, number, places_outside(now.regions), noise)
        for number in inside(region, now.blocks)
        if number != query and number not in alike
    ]
    if not region.contains(now.blocks[query]):
        todo.append(bring(now, query, places_inside(region), noise))
    if not any(region.contains(now.blocks[number]) for number in alike):
        choices = [bring(now, number, places_inside(region), noise) for number in alike]
        todo.append(min(choices, key=lambda subgoal: subgoal.cost(now) + noise(CHOICE)))
    return todo


SPEC: Final = TaskSpec(
    name="FindDupe",
    summary="bring a duplicate of the block in the goal region into the region",
    demo=DEMO,
    steps=100,
    score=score,
    distance=distance,
    check=check,
    plan=plan,
    colour=colour,
    shape=shape,
    count=count,
    region_size=REGION_SIZE,
    inner_margin=0.06,
    bodies=("gripper", "shortstick"),
)
