"""ClusterColour: push the blocks into clusters, one for each colour.

Goal
    Every block is near the blocks of its colour and away from all others, anywhere. Shapes do not matter.

What varies
    Colour and Shape draw every block's colour or shape, with at least one block of each, in both cluster tasks.
    CountPlus has 7 to 10 blocks (the demo has 8), with at least one block of each colour.

Score
    Depends on the share of blocks that are much nearer to their own colour's centroid than to any other: see
    `magical_mj.tasks.cluster`.

Differences from the original
    The released code has its own rule, ramp and horizon (rules="released"), also described in that module.
    In the Shape variant the poses are fixed, so shapes that would overlap (two stars next to each other) are drawn
    again.
"""

from __future__ import annotations

from typing import Final

from magical_mj.scene import Block, Robot, Scene
from magical_mj.tasks import cluster
from magical_mj.tasks.spec import Rules

DEMO: Final = Scene(
    robot=Robot(0.71692, -0.34374, 0.83693),
    blocks=(
        Block("circle", "blue", -0.5147, 0.14149, -0.38871),
        Block("star", "blue", -0.1347, -0.71414, 1.0533),
        Block("square", "blue", -0.74247, -0.097592, 1.1571),
        Block("pentagon", "green", -0.077363, -0.42964, -0.64379),
        Block("pentagon", "green", 0.51978, 0.1853, -1.1762),
        Block("square", "red", -0.5278, -0.21642, 2.9356),
        Block("star", "yellow", -0.54039, 0.48292, 0.072818),
        Block("pentagon", "yellow", -0.16761, 0.64303, -2.3255),
    ),
)


def score(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """The score for clustering the blocks by colour."""
    return cluster.score(final, "colour", rules)


SPEC: Final = cluster.spec("ClusterColour", "colour", DEMO, score)
