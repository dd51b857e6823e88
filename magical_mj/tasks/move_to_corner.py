"""MoveToCorner: push the only block from the lower right into the top left corner.

Goal
    The block is within sqrt(2)/2 of the corner (-1, 1) when the episode ends.

What varies
    Colour and shape of the block. Poses are only jittered, never drawn from the whole workspace. The block
    starts near the opposite corner and there is only one, because otherwise the goal would be ambiguous. So
    there are no Layout and CountPlus variants, and All jitters.

Score
    With d the distance of the block's centre from the corner: 1 for d <= sqrt(2)/2, 0 for d >= sqrt(2),
    linear in between.

Remaining distance
    With d as above: d - sqrt(2)/2, plus 0.3; 0 for d <= sqrt(2)/2. At most 2.4.

Differences from the original
    None. (The paper's main text mentions the "top left eighth". Its appendix and the released code use the
    quarter disc, as here.)
"""

from __future__ import annotations

import math
from typing import Final

from magical_mj.scene import Block, Robot, Scene
from magical_mj.tasks.planning import TOLERANCE, Noise, Subgoal, bring, places_anywhere
from magical_mj.tasks.rules import WRONG, any_colours, any_shapes, require, require_regions
from magical_mj.tasks.spec import Rules, TaskSpec

DEMO: Final = Scene(
    robot=Robot(0.4, 0.0, 1.7278759594743864),
    blocks=(Block("square", "red", 0.1, -0.65, 0.4084070449666731),),
)

CORNER: Final = (-1.0, 1.0)
FULL_SCORE_DISTANCE: Final = math.sqrt(2) / 2
ZERO_SCORE_DISTANCE: Final = math.sqrt(2)


def check(scene: Scene) -> None:
    """Raises an `InvalidSceneError` unless there is exactly one block and no goal region."""
    require(len(scene.blocks) == 1, "MoveToCorner", f"exactly one block, but this has {len(scene.blocks)}")
    require_regions(scene, "MoveToCorner", 0)


def score(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """The block's closeness to the corner, in [0, 1]. The same under both rules."""
    (block,) = final.blocks
    distance = math.hypot(block.x - CORNER[0], block.y - CORNER[1])
    return min(1.0, max(0.0, (ZERO_SCORE_DISTANCE - distance) / (ZERO_SCORE_DISTANCE - FULL_SCORE_DISTANCE)))


def distance(initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """The remaining distance; see the module's docstring."""
    (block,) = final.blocks
    excess = math.hypot(block.x - CORNER[0], block.y - CORNER[1]) - FULL_SCORE_DISTANCE
    return WRONG + excess if excess > 0.0 else 0.0


def plan(initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """The block moves to the nearest position within the full-score distance of the corner, less a margin."""
    near = FULL_SCORE_DISTANCE - 2 * TOLERANCE
    places = [place for place in places_anywhere() if math.dist(place, CORNER) < near]
    return [bring(now, 0, places, noise)]


SPEC: Final = TaskSpec(
    name="MoveToCorner",
    summary="push the block into the top left corner",
    demo=DEMO,
    steps=80,
    score=score,
    distance=distance,
    check=check,
    plan=plan,
    colour=any_colours,
    shape=any_shapes,
    layout=False,
    bodies=("gripper", "shortstick", "mediumstick"),
)
