"""Four tasks outside the benchmark, for testing methods on tasks that their authors did not know.

- RedLeft: bring the red block into the left half. The goal refers to a colour.
- VisitStar: drive next to the star. The goal refers to a shape, and no block must be moved.
- PairUp: bring the two blocks of one colour next to each other.
- Huddle: bring all blocks together.

The demo scenes have no goal regions. A fifth task is PushOut, in ../push_out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from magical_mj.scene import Block, Robot, Scene
from magical_mj.scene.constants import COLOURS, SHAPES, Colour, Shape
from magical_mj.tasks.planning import Noise, Point, Subgoal, bring, drive, places_anywhere, scene_after
from magical_mj.tasks.rules import any_colours, any_shapes, coloured, pick, require, shaped
from magical_mj.tasks.spec import Rules, TaskSpec

LEFT: Final = -0.2
"""The largest x of a block in the left half, with a margin to the centre."""
ADJACENT: Final = 0.45
"""The largest distance between the centres of adjacent objects."""
TOGETHER: Final = 0.45
"""The largest distance of a block from the centroid of all blocks in a huddle."""
DEMONSTRATIONS: Final = Path(__file__).parent / "outside_demonstrations"
"""The folder that `magical-mj demos generate` writes: see README.md."""


def _distance(first: Block | Robot, second: Block | Robot) -> float:
    return math.dist((first.x, first.y), (second.x, second.y))


def _numbers(scene: Scene, fits: Callable[[Block], bool]) -> list[int]:
    return [number for number, block in enumerate(scene.blocks) if fits(block)]


def _only(name: str, count: int, what: str, fits: Callable[[Block], bool]) -> Callable[[Scene], None]:
    """A check that exactly `count` blocks fit."""

    def check(scene: Scene) -> None:
        require(len(_numbers(scene, fits)) == count, name, f"{count} {what}")

    return check


def _around(scene: Scene, block: int, least: float, most: float) -> list[Point]:
    here = scene.blocks[block]
    return [point for point in places_anywhere() if least <= math.dist(point, (here.x, here.y)) <= most]


def _red(block: Block) -> bool:
    return block.colour == "red"


def _star(block: Block) -> bool:
    return block.shape == "star"


# RedLeft


def red_left(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """1 if the red block is in the left half."""
    return float(all(final.blocks[number].x <= LEFT for number in _numbers(final, _red)))


def plan_red_left(initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """Brings the red block to the nearest free position in the left half."""
    places = [place for place in places_anywhere() if place[0] <= LEFT - 0.15]
    return [bring(now, number, places, noise) for number in _numbers(now, _red)]


def other_colours(rng: np.random.Generator, scene: Scene) -> Scene:
    """Gives all blocks except the red one uniform colours other than red."""
    others: list[Colour] = [colour for colour in COLOURS if colour != "red"]
    return coloured(scene, (block.colour if _red(block) else pick(rng, others) for block in scene.blocks))


RED_LEFT: Final = TaskSpec(
    name="RedLeft",
    summary="bring the red block into the left half",
    demo=Scene(
        Robot(-0.1, -0.7, 0.3),
        (
            Block("square", "red", 0.45, 0.3, 0.2),
            Block("circle", "blue", 0.4, -0.4, 0.0),
            Block("pentagon", "green", -0.5, 0.5, 0.7),
        ),
    ),
    steps=100,
    score=red_left,
    check=_only("RedLeft", 1, "red block", _red),
    plan=plan_red_left,
    demonstrations=DEMONSTRATIONS,
    colour=other_colours,
    shape=any_shapes,
)

# VisitStar


def visit_star(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """1 if the robot is next to the star."""
    return float(all(_distance(final.robot, final.blocks[number]) <= ADJACENT for number in _numbers(final, _star)))


def plan_visit_star(initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """Drives next to the star without moving it."""
    (star,) = _numbers(now, _star)
    return [drive(now, _around(now, star, 0.34, 0.4), noise, tolerance=0.06)]


def other_shapes(rng: np.random.Generator, scene: Scene) -> Scene:
    """Gives all blocks except the star uniform shapes other than stars."""
    others: list[Shape] = [shape for shape in SHAPES if shape != "star"]
    return shaped(scene, (block.shape if _star(block) else pick(rng, others) for block in scene.blocks))


VISIT_STAR: Final = TaskSpec(
    name="VisitStar",
    summary="drive next to the star",
    demo=Scene(
        Robot(0.5, -0.6, 1.0),
        (
            Block("star", "blue", -0.4, 0.45, 0.4),
            Block("square", "yellow", 0.45, 0.4, 0.1),
            Block("circle", "red", -0.5, -0.4, 0.0),
        ),
    ),
    steps=60,
    score=visit_star,
    check=_only("VisitStar", 1, "star", _star),
    plan=plan_visit_star,
    demonstrations=DEMONSTRATIONS,
    colour=any_colours,
    shape=other_shapes,
)

# PairUp


def _pair(scene: Scene) -> list[int]:
    colours = [block.colour for block in scene.blocks]
    return _numbers(scene, lambda block: colours.count(block.colour) == 2)


def pair_up(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """1 if the two blocks of one colour are next to each other."""
    first, second = (final.blocks[number] for number in _pair(final))
    return float(_distance(first, second) <= ADJACENT)


def plan_pair_up(initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """Brings one block of the pair next to the other."""
    first, second = _pair(now)
    return [bring(now, first, _around(now, second, 0.28, 0.36), noise)]


def check_pair(scene: Scene) -> None:
    """Raises an `InvalidSceneError` unless exactly two blocks share a colour."""
    require(len(_pair(scene)) == 2, "PairUp", "two blocks of one colour")


def colours_of_pair(rng: np.random.Generator, scene: Scene) -> Scene:
    """Gives the pair a uniform colour, and each other block a different one."""
    left: Sequence[str] = COLOURS
    blocks, pair = list(scene.blocks), _pair(scene)
    for numbers in (pair, *([number] for number in range(len(blocks)) if number not in pair)):
        colour = pick(rng, left)
        left = [other for other in left if other != colour]
        for number in numbers:
            blocks[number] = replace(blocks[number], colour=colour)
    return replace(scene, blocks=tuple(blocks))


PAIR_UP: Final = TaskSpec(
    name="PairUp",
    summary="bring the two blocks of one colour next to each other",
    demo=Scene(
        Robot(0.0, -0.7, 0.0),
        (
            Block("square", "green", 0.5, 0.4, 0.2),
            Block("circle", "green", -0.5, -0.2, 0.0),
            Block("star", "red", -0.4, 0.55, 0.5),
        ),
    ),
    steps=100,
    score=pair_up,
    check=check_pair,
    plan=plan_pair_up,
    demonstrations=DEMONSTRATIONS,
    colour=colours_of_pair,
    shape=any_shapes,
)

# Huddle


def _farthest(scene: Scene) -> float:
    points = np.array([(block.x, block.y) for block in scene.blocks])
    return float(np.linalg.norm(points - points.mean(0), axis=1).max())


def huddle(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """1 if all blocks are near their centroid."""
    return float(_farthest(final) <= TOGETHER)


def plan_huddle(initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """Brings all other blocks next to the first one."""
    todo: list[Subgoal] = []
    for number in range(1, len(now.blocks)):
        if _distance(now.blocks[0], now.blocks[number]) > 0.4:
            after = scene_after(now, todo)
            todo.append(bring(after, number, _around(after, 0, 0.28, 0.36), noise))
    return todo


def check_huddle(scene: Scene) -> None:
    """Raises an `InvalidSceneError` unless there are at least two blocks."""
    require(len(scene.blocks) > 1, "Huddle", "several blocks")


HUDDLE: Final = TaskSpec(
    name="Huddle",
    summary="bring all blocks together",
    demo=Scene(
        Robot(0.6, -0.7, 0.5),
        (
            Block("square", "green", 0.55, 0.55, 0.2),
            Block("circle", "yellow", -0.55, -0.4, 0.0),
            Block("star", "red", -0.5, 0.55, 0.5),
        ),
    ),
    steps=140,
    score=huddle,
    check=check_huddle,
    plan=plan_huddle,
    demonstrations=DEMONSTRATIONS,
    colour=any_colours,
    shape=any_shapes,
)
