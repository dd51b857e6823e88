"""MakeLine: arrange all blocks in a line, anywhere and at any angle.

Goal
    All blocks are along one straight line without large gaps. Colours and shapes do not matter.

What varies
    Colour and Shape draw every block's colour or shape. CountPlus has 3 or 4 blocks (the demo has 4).

Score
    For every pair of blocks, take the straight line through both. Its inliers are the blocks within 0.18 of
    it. Split them into runs at gaps of more than 0.42, measured along the line. With m the size of
    the largest run over all pairs and n the number of blocks: 1 if m = n, 0.5 if m = n - 1, else 0.

Remaining distance
    Take the line through a pair of blocks. Each block farther than 0.18 from it adds the excess and 0.3. Each gap
    wider than 0.42 between neighbours along the line also adds the excess and 0.3. The remaining distance is the least
    such sum over all pairs; at most 3.4 for each block.

Differences from the original
    With three blocks, the paper's m = n - 1 = 2 gives 0.5 for any two blocks near each other. The released
    code gives 0 in this case (rules="released"). With four blocks, both agree.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene import Block, Robot, Scene
from magical_mj.tasks.planning import Noise, Point, Subgoal, each_to, line_targets
from magical_mj.tasks.rules import WRONG, any_colours, any_shapes, require, require_regions, uniform_integer
from magical_mj.tasks.spec import Rules, TaskSpec

DEMO: Final = Scene(
    robot=Robot(0.702, -0.255, 0.347),
    blocks=(
        Block("star", "blue", 0.79, -0.82, -0.721),
        Block("circle", "yellow", -0.177, 0.383, -1.733),
        Block("star", "red", -0.051, -0.128, 2.696),
        Block("pentagon", "green", -0.292, -0.745, -0.159),
    ),
)

INLIER_DISTANCE: Final = 0.18
MAX_GAP: Final = 0.42
MIN_BLOCKS: Final = 3
RELEASED_LEAST: Final = 3  # the least number of blocks in a line with a score above 0, by the released code's rules


def count(rng: np.random.Generator, scene: Scene) -> Scene:
    """3 or 4 blocks."""
    return replace(scene, blocks=scene.blocks[: uniform_integer(rng, MIN_BLOCKS, len(scene.blocks))])


def check(scene: Scene) -> None:
    """Raises an `InvalidSceneError` unless there are at least three blocks and no goal region."""
    number = len(scene.blocks)
    require(number >= MIN_BLOCKS, "MakeLine", f"at least {MIN_BLOCKS} blocks, but this has {number}")
    require_regions(scene, "MakeLine", 0)


def _through_pairs(points: Sequence[Point]) -> Iterator[list[tuple[float, float]]]:
    """For the line through each pair of points: each point's position along the line and its distance from the line."""
    for (x, y), (other_x, other_y) in itertools.combinations(points, 2):
        length = math.hypot(other_x - x, other_y - y)
        if length > 0.0:  # two equal centres (never in a legal scene) define no line
            along_x, along_y = (other_x - x) / length, (other_y - y) / length
            offsets = [(block_x - x, block_y - y) for block_x, block_y in points]
            yield [(along_x * u + along_y * v, abs(along_x * v - along_y * u)) for u, v in offsets]


def longest_line(points: Sequence[Point]) -> int:
    """The number of blocks in the longest line of blocks with these centres: m in the module's docstring."""
    longest = 1
    for line in _through_pairs(points):
        run = 1
        for here, there in itertools.pairwise(sorted(along for along, off in line if off <= INLIER_DISTANCE)):
            run = run + 1 if there - here <= MAX_GAP else 1
            longest = max(longest, run)
    return longest


def are_lines(arrangements: NDArray[np.float64]) -> Iterator[bool]:
    """Whether all blocks are in one line, for each of the arrangements of their centres, shape (n, blocks, 2)."""
    return (longest_line(points) == len(points) for points in arrangements.tolist())


def score(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """1.0 if all blocks are in one line, 0.5 if all but one are, else 0.0."""
    in_line, total = longest_line([(block.x, block.y) for block in final.blocks]), len(final.blocks)
    if in_line == total:
        return 1.0
    if rules == "released" and in_line < RELEASED_LEAST:
        return 0.0
    return 0.5 if in_line == total - 1 else 0.0


def distance(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """How far the blocks are from the nearest line through two of them."""
    points = [(block.x, block.y) for block in final.blocks]
    least = math.inf
    for line in _through_pairs(points):
        gaps = itertools.pairwise(sorted(along for along, _ in line))
        excess = [off - INLIER_DISTANCE for _, off in line] + [there - here - MAX_GAP for here, there in gaps]
        least = min(least, sum(WRONG + each for each in excess if each > 0.0))
    return least


def plan(initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """One of the blocks stays, and the others move to positions in a line through it."""
    return each_to(line_targets([(block.x, block.y) for block in now.blocks], are_lines, noise), tolerance=0.07)


SPEC: Final = TaskSpec(
    name="MakeLine",
    summary="arrange all blocks in a line, anywhere and at any angle",
    demo=DEMO,
    steps=180,
    score=score,
    distance=distance,
    check=check,
    plan=plan,
    colour=any_colours,
    shape=any_shapes,
    count=count,
)
