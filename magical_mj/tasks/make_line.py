"""MakeLine: arrange all blocks in a line, anywhere and at any angle.

Goal
    All blocks lie along one straight line without large gaps. Colours and shapes do not matter.

What varies
    Colour and Shape draw every block's colour or shape. CountPlus has 3 or 4 blocks (the demo has 4).

Score
    For every pair of blocks take the straight line through both. Its inliers are the blocks within 0.18 of
    it; cut them into runs wherever neighbours are more than 0.42 apart, measured along the line. With m the
    size of the largest run over all pairs and n the number of blocks: 1 if m = n, 0.5 if m = n - 1, else 0.

Differences from the original
    With three blocks, the paper's m = n - 1 = 2 gives 0.5 for any two blocks near each other. The released
    code gives 0 for it (rules="released"). With four blocks the two agree.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Final

import numpy as np

from magical_mj.scene import Block, Robot, Scene
from magical_mj.scene.arrays import Array, SceneArrays, length, namespace
from magical_mj.tasks.planning import Noise, Subgoal, each_to
from magical_mj.tasks.planning.arrangements import line_targets
from magical_mj.tasks.rules import any_colours, any_shapes, require, require_regions, uniform_integer
from magical_mj.tasks.spec import Rules, TaskSpec, array_score

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
RELEASED_LEAST: Final = 3  # blocks in a line that score, by the released code's rules


def count(rng: np.random.Generator, scene: Scene) -> Scene:
    """3 or 4 blocks."""
    return replace(scene, blocks=scene.blocks[: uniform_integer(rng, MIN_BLOCKS, len(scene.blocks))])


def check(scene: Scene) -> None:
    """Raise `InvalidSceneError` unless there are at least three blocks and no goal region."""
    number = len(scene.blocks)
    require(number >= MIN_BLOCKS, "MakeLine", f"at least {MIN_BLOCKS} blocks, and this has {number}")
    require_regions(scene, "MakeLine", 0)


def longest_line(points: Array, present: Array) -> Array:
    """The number of blocks in the longest line: m in the module's docstring. At least 1.

    Args:
        points: x, y of the blocks. Shape (..., blocks, 2).
        present: which of them there are. Shape (..., blocks), bool.

    Returns:
        Shape (...). All arrays between have the axes (..., pair, block) or (..., pair, block, other block).
    """
    pairs = [*itertools.combinations(range(points.shape[-2]), 2)]
    first, second = [one for one, _ in pairs], [other for _, other in pairs]
    way = points[..., second, :] - points[..., first, :]
    distance = length(way[..., 0], way[..., 1])
    defined = present[..., first] & present[..., second] & (distance > 0)  # centres in one place define no line
    along_x, along_y = (way[..., None, axis] / distance.clip(1e-300)[..., None] for axis in (0, 1))
    offset = points[..., None, :, :] - points[..., first, None, :]
    x, y = offset[..., 0], offset[..., 1]
    inlier = (abs(along_x * y - along_y * x) <= INLIER_DISTANCE) & present[..., None, :] & defined[..., None]
    along = along_x * x + along_y * y

    ahead = along[..., :, None] - along[..., None, :]  # how far a block is ahead of the other one
    near_behind = inlier[..., None, :] & (ahead > 0) & (ahead <= MAX_GAP)
    starts = inlier & ~near_behind.any(-1)  # the first blocks of the runs
    run = (starts[..., None, :] & (ahead >= 0)).sum(-1)  # a number that the blocks of a run share
    same_run = inlier[..., :, None] & inlier[..., None, :] & (run[..., :, None] == run[..., None, :])
    xp = namespace(points)
    return xp.amax(same_run.sum(-1), (-2, -1)).clip(1)


def are_lines(points: Array) -> Array:
    """Whether blocks with these centres are all in one line. Shape (...) for points of shape (..., blocks, 2)."""
    present = namespace(points).ones_like(points[..., 0], dtype=bool)
    return longest_line(points, present) == points.shape[-2]


@array_score
def score(initial: SceneArrays, final: SceneArrays, rules: Rules = "paper") -> Array:
    """1.0 if all blocks are in one line, 0.5 if all but one are, else 0.0."""
    in_line, total = longest_line(final.blocks, final.present), final.present.sum(-1)
    nearly = in_line == total - 1
    if rules == "released":
        nearly = nearly & (in_line >= RELEASED_LEAST)
    return 1.0 * (in_line == total) + 0.5 * nearly


def plan(initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """One of the blocks stays, and the others go to places in a line through it."""
    return each_to(line_targets([(block.x, block.y) for block in now.blocks], are_lines, noise), tolerance=0.07)


SPEC: Final = TaskSpec(
    name="MakeLine",
    summary="arrange all blocks in a line, anywhere and at any angle",
    demo=DEMO,
    steps=180,
    score=score,
    check=check,
    plan=plan,
    colour=any_colours,
    shape=any_shapes,
    count=count,
)
