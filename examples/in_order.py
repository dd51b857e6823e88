"""InOrder: drive into the red region, then into the green one, then into the blue one.

The score depends on the whole episode. docs/adding-a-task.md explains such tasks.
"""

from __future__ import annotations

from collections.abc import Sequence

from magical_mj.scene import GoalRegion, Robot, Scene
from magical_mj.tasks.planning import Noise, Subgoal, drive, places_inside
from magical_mj.tasks.rules import require
from magical_mj.tasks.spec import Rules, TaskSpec

ORDER = ("red", "green", "blue")


def visited(scenes: Sequence[Scene]) -> int:
    """The number of regions that the robot has visited in the required order."""
    number = 0
    for scene in scenes:
        if number < len(ORDER) and any(r.colour == ORDER[number] and r.contains(scene.robot) for r in scene.regions):
            number += 1
    return number


def check(scene: Scene) -> None:
    """Raises an `InvalidSceneError` unless there is one region of each colour."""
    require(sorted(region.colour for region in scene.regions) == sorted(ORDER), "InOrder", "one region of each colour")


def score(scenes: Sequence[Scene], rules: Rules = "paper") -> float:
    """The share of the regions that were visited in the required order."""
    return visited(scenes) / len(ORDER)


def plan(scenes: Sequence[Scene], noise: Noise) -> list[Subgoal]:
    """The robot drives into the next region."""
    (region,) = (region for region in scenes[-1].regions if region.colour == ORDER[visited(scenes)])
    return [drive(scenes[-1], places_inside(region), noise, tolerance=0.1)]


SPEC = TaskSpec(
    name="InOrder",
    summary="drive into the red region, then into the green one, then into the blue one",
    demo=Scene(
        Robot(0.0, -0.6, 0.4),
        regions=(
            GoalRegion("red", 0.3, -0.3, 0.8, 0.2),
            GoalRegion("green", -0.8, -0.3, -0.3, 0.2),
            GoalRegion("blue", -0.25, 0.35, 0.25, 0.85),
        ),
    ),
    steps=140,
    score=score,
    trajectory=True,
    check=check,
    plan=plan,
    region_size=(0.45, 0.55),
)
