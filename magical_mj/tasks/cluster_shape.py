"""ClusterShape: push the blocks into clusters, one for each shape.

Goal
    Every block is near the blocks of its shape and away from all others, anywhere. Colours do not matter.

What varies
    Colour and Shape draw every block's colour or shape, with at least one block of each, in both cluster tasks.
    CountPlus has 7 to 10 blocks (the demo has 8), with at least one block of each shape.

Score
    Depends on the share of blocks that are much nearer to their own shape's centroid than to any other: see
    `magical_mj.tasks.cluster`. By the paper's rule, the demo scene itself scores 0.25.

Differences from the original
    The released code has its own rule, ramp and horizon (rules="released"), also described in that module.
    In the Shape variant the poses are fixed, so shapes that would overlap (a square at the right wall) are drawn
    again.
"""

from __future__ import annotations

from typing import Final

from magical_mj.scene import Block, Robot, Scene
from magical_mj.tasks import cluster
from magical_mj.tasks.spec import Rules

DEMO: Final = Scene(
    robot=Robot(0.286, -0.202, -1.878),
    blocks=(
        Block("square", "yellow", -0.414, 0.297, -1.731),
        Block("pentagon", "blue", 0.068, 0.705, 2.184),
        Block("pentagon", "red", 0.821, 0.22, 0.65),
        Block("pentagon", "red", -0.461, -0.749, -2.673),
        Block("circle", "green", 0.867, -0.149, -2.215),
        Block("star", "yellow", -0.785, -0.14, -0.405),
        Block("star", "blue", -0.305, -0.226, 1.341),
        Block("circle", "green", 0.758, -0.708, -2.14),
    ),
)


def score(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """The score for clustering the blocks by shape."""
    return cluster.score(final, "shape", rules)


SPEC: Final = cluster.spec("ClusterShape", "shape", DEMO, score)
