"""The scores, on known final states and on hand-made ones at the borders of each rule."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.tasks import Rules
from magical_mj.tasks.registry import TASKS, sample_scene, score, task_spec
from magical_mj.utils.errors import InvalidSceneError, UnknownNameError

CASES = json.loads((Path(__file__).parents[1] / "data" / "score_cases.json").read_text())
"""40 final states for each task, with the scores by the paper's formulas and by the original's released code."""

ROBOT = Robot(0.9, -0.7, 0.0)
OUT = (0.9, 0.9)
"""A place outside every region of the demo scenes."""


def demo(task: str) -> Scene:
    return sample_scene(task, "Demo", 0)


def placed(task: str, positions: dict[int, tuple[float, float]]) -> Scene:
    """The task's demo scene with some blocks elsewhere."""
    scene = demo(task)
    poses = [(*positions.get(index, (block.x, block.y)), 0.0) for index, block in enumerate(scene.blocks)]
    return scene.moved(blocks=poses)


@pytest.mark.parametrize(("rules", "key"), [("paper", "score"), ("released", "original_code_score")])
@pytest.mark.parametrize("task", [task for task in TASKS if task in CASES])
def test_known_final_states(task: str, rules: Rules, key: str) -> None:
    for case in CASES[task]:
        final = demo(task).moved(robot=case["robot"], blocks=case["blocks"])
        assert score(task, demo(task), final, rules) == pytest.approx(case[key], abs=1e-6), case["id"]


@pytest.mark.parametrize("task", TASKS)
def test_doing_nothing_scores_nothing_with_one_exception(task: str) -> None:
    """By the paper's rule 5 of the 8 blocks of the ClusterShape demo are right before anyone moves."""
    expected = 0.25 if task == "ClusterShape" else 0.0
    assert score(task, demo(task), demo(task)) == expected
    assert score(task, demo(task), demo(task), "released") == 0.0


@pytest.mark.parametrize(
    ("distance", "expected"),
    [
        (0.0, 1.0),
        (math.sqrt(2) / 2, 1.0),
        (math.sqrt(2) * 0.625, 0.75),
        (math.sqrt(2) * 0.75, 0.5),
        (math.sqrt(2), 0.0),
        (2.0, 0.0),
    ],
)
def test_move_to_corner_falls_linearly_with_the_distance(distance: float, expected: float) -> None:
    for direction in (0.0, -math.pi / 4):
        where = (-1 + distance * math.cos(direction), 1 + distance * math.sin(direction))
        final = placed("MoveToCorner", {0: where})
        assert score("MoveToCorner", demo("MoveToCorner"), final) == pytest.approx(expected)


@pytest.mark.parametrize(("x", "expected"), [(-0.62, 1.0), (0.13, 1.0), (0.1301, 0.0), (-0.6201, 0.0)])
def test_move_to_region_wants_the_robots_centre_inside(x: float, expected: float) -> None:
    start = demo("MoveToRegion")
    assert score("MoveToRegion", start, start.moved(robot=(x, -0.17, 0.0))) == expected


@pytest.mark.parametrize(
    ("inside", "expected"),
    [((), 0.0), ((0, 1), 1.0), ((0,), 0.5), ((0, 1, 2), 2 / 3), ((0, 2), 0.25), ((2, 3, 4), 0.0), (range(5), 0.4)],
)
def test_match_regions_rewards_targets_and_punishes_distractors(inside: Any, expected: float) -> None:
    """Blocks 0 and 1 are the targets; (0.7, 0.7) is the region's corner and so inside."""
    where = {index: (0.7, 0.7) if index in inside else OUT for index in range(5)}
    assert score("MatchRegions", demo("MatchRegions"), placed("MatchRegions", where)) == pytest.approx(expected)


def line(*positions: tuple[float, float]) -> Scene:
    return Scene(ROBOT, tuple(Block("circle", "red", x, y, 0.0) for x, y in positions))


@pytest.mark.parametrize(
    ("positions", "paper", "released"),
    [
        (((0, 0), (0.4, 0), (0.8, 0), (-0.4, 0)), 1.0, 1.0),
        (((0, 0), (0.29, 0.29), (-0.29, -0.29), (0.58, 0.58)), 1.0, 1.0),  # any direction: gaps of 0.41
        (((-0.42, 0), (0, 0), (0.42, 0), (0.84, 0)), 1.0, 1.0),  # the widest gaps
        (((-0.43, 0), (0, 0), (0.42, 0), (0.84, 0)), 0.5, 0.5),  # one gap too wide
        (((0, 0), (0.4, 0), (0.2, 0.18), (-0.2, -0.18)), 1.0, 1.0),  # as far off as an inlier may be
        (((0, 0), (0.4, 0), (0.8, 0), (0.4, 0.9)), 0.5, 0.5),
        (((-0.8, 0), (-0.5, 0), (0.3, 0), (0.6, 0)), 0.0, 0.0),  # two pairs, far apart
        (((-0.9, -0.9), (0.9, -0.9), (0.9, 0.5), (-0.9, 0.9)), 0.0, 0.0),
        (((-0.3, 0), (0, 0.1), (0.3, 0)), 1.0, 1.0),
        (((0, 0), (0.3, 0), (0, 0.9)), 0.5, 0.0),  # of three blocks any two near ones are a line to the paper
        (((0, 0), (0.9, 0), (0, 0.9)), 0.0, 0.0),
    ],
)
def test_make_line_counts_the_longest_run(positions: Any, paper: float, released: float) -> None:
    for scene in (line(*positions), line(*reversed(positions)), line(*((y, -x) for x, y in positions))):
        assert score("MakeLine", scene, scene) == paper
        assert score("MakeLine", scene, scene, "released") == released


@pytest.mark.parametrize(
    ("inside", "expected"),
    [((), 0.0), ((6,), 0.0), ((5,), 0.0), ((5, 6), 1.0), ((0, 5, 6), 2 / 3), ((0, 6), 0.0), (range(7), 2 / 7)],
)
def test_find_dupe_wants_the_query_and_a_duplicate(inside: Any, expected: float) -> None:
    """Block 6 is the query, block 5 its duplicate."""
    where = {index: (-0.72, -0.22) if index in inside else OUT for index in range(7)}
    assert score("FindDupe", demo("FindDupe"), placed("FindDupe", where)) == pytest.approx(expected)


def test_find_dupe_by_the_released_rules_does_not_need_the_query_itself() -> None:
    start = demo("FindDupe")
    blocks = list(start.blocks)
    blocks[0] = replace(blocks[0], shape="pentagon", colour="yellow")  # a second duplicate
    start = replace(start, blocks=tuple(blocks))
    poses = [(-0.4, -0.5, 0.0) if index in (0, 5) else (*OUT, 0.0) for index in range(7)]
    final = start.moved(blocks=poses)
    assert score("FindDupe", start, final) == 0.0
    assert score("FindDupe", start, final, "released") == 1.0


@pytest.mark.parametrize(
    ("moves", "expected"),
    [
        ({}, 0.0),
        ({2: OUT}, 1.0),
        ({2: (-0.682, 0.0)}, 1.0),  # just outside
        ({2: (-0.681, 0.0)}, 0.0),  # on the border
        ({2: (0.2, 0.2)}, 0.0),  # in another region
        ({2: OUT, 0: OUT}, 0.0),
        ({2: OUT, 0: (0.2, -0.6), 1: (0.2, 0.1)}, 0.0),  # exchanged
        ({2: OUT, 0: (-0.4, 0.0)}, 0.0),  # another block in the mismatched one's region
    ],
)
def test_fix_colour_wants_the_odd_block_out_and_all_others_at_home(moves: Any, expected: float) -> None:
    assert score("FixColour", demo("FixColour"), placed("FixColour", moves)) == expected


@pytest.mark.parametrize("task", ["ClusterColour", "ClusterShape"])
def test_clusters_apart_score_one_and_one_heap_scores_nothing(task: str) -> None:
    attribute = {"ClusterColour": "colour", "ClusterShape": "shape"}[task]
    corners = dict(zip({getattr(b, attribute): None for b in demo(task).blocks}, [-0.9, -0.3, 0.3, 0.9], strict=True))
    apart = {index: (corners[getattr(b, attribute)], 0.0) for index, b in enumerate(demo(task).blocks)}
    heap = dict.fromkeys(range(8), (0.0, 0.0))
    for rules in ("paper", "released"):
        assert score(task, demo(task), placed(task, apart), rules) == 1.0
        assert score(task, demo(task), placed(task, heap), rules) == 0.0


def test_a_block_is_right_below_a_third_of_the_squared_distance() -> None:
    """The inner red block is 0.1 from its centroid, so the blue block must be over 0.1 sqrt(3) from it."""

    def scene(far: float) -> Scene:
        reds = (Block("circle", "red", 0.0, 0.0, 0.0), Block("circle", "red", 0.2, 0.0, 0.0))
        return Scene(ROBOT, (*reds, Block("star", "blue", far, 0.0, 0.0)))

    limit = 0.2 + 0.1 * math.sqrt(3)
    assert score("ClusterColour", scene(limit + 1e-6), scene(limit + 1e-6)) == 1.0
    assert score("ClusterColour", scene(limit - 1e-6), scene(limit - 1e-6)) == pytest.approx(1 / 3)


@pytest.mark.parametrize(
    ("task", "scene", "message"),
    [
        ("MoveToCorner", Scene(ROBOT), "one block"),
        ("MoveToCorner", replace(demo("MoveToCorner"), regions=demo("MoveToRegion").regions), "no goal regions"),
        ("MoveToRegion", Scene(ROBOT), "one goal region"),
        ("MoveToRegion", demo("MatchRegions"), "no blocks"),
        ("MatchRegions", replace(demo("MatchRegions"), blocks=()), "region's colour"),
        ("MatchRegions", demo("FixColour"), "one goal region"),
        ("MakeLine", line((0, 0), (0.5, 0)), "3 blocks"),
        ("FindDupe", placed("FindDupe", {6: OUT}), "query.* has 0"),
        ("FindDupe", placed("FindDupe", {5: (-0.1, -0.3)}), "query.* has 2"),
        (
            "FindDupe",
            replace(demo("FindDupe"), blocks=(*demo("FindDupe").blocks[:5], demo("FindDupe").blocks[6])),
            "yellow pentagon",
        ),
        ("FixColour", placed("FixColour", {0: OUT}), r"\[0, 1, 1\]"),
        ("FixColour", replace(demo("FixColour"), regions=demo("FixColour").regions[:2]), "differs"),
        ("FixColour", Scene(ROBOT), "at least one goal region"),
        ("ClusterColour", line((0, 0), (0.5, 0), (0, 0.5)), "different colours"),
        ("ClusterShape", line((0, 0), (0.5, 0), (0, 0.5)), "different shapes"),
    ],
)
def test_scenes_of_no_such_task_are_refused(task: str, scene: Scene, message: str) -> None:
    with pytest.raises(InvalidSceneError, match=message) as caught:
        score(task, scene, scene)
    assert f"this is not a scene of {task}: it needs" in str(caught.value)


def test_overlapping_regions_that_share_a_block_are_no_fix_colour_scene() -> None:
    block = Block("star", "red", 0.0, 0.0, 0.0)
    regions = (GoalRegion("red", -0.5, -0.5, 0.5, 0.5), GoalRegion("blue", -0.4, -0.4, 0.4, 0.4))
    with pytest.raises(InvalidSceneError, match="every goal region"):
        task_spec("FixColour").check(Scene(ROBOT, (block,), regions))


def test_the_final_scene_must_be_the_initial_one_with_other_poses() -> None:
    start = demo("FindDupe")
    with pytest.raises(InvalidSceneError, match="blocks"):
        score("FindDupe", start, replace(start, blocks=start.blocks[::-1]))
    with pytest.raises(InvalidSceneError, match="goal regions"):
        score("FindDupe", start, replace(start, regions=(replace(start.regions[0], x_max=0.01),)))
    with pytest.raises(InvalidSceneError, match="goal regions"):
        score("FindDupe", start, replace(start, regions=()))
    for wrong in (None, "scene", start.to_json(), [start]):
        for pair in ((start, wrong), (wrong, start)):
            with pytest.raises(InvalidSceneError, match="Scene"):
                score("FindDupe", *pair)
    rounded = replace(start, regions=(replace(start.regions[0], x_max=1e-9),))
    assert score("FindDupe", start, rounded) == 0.0


def test_unknown_tasks_and_rules_are_refused() -> None:
    start = demo("FindDupe")
    with pytest.raises(UnknownNameError, match="FindDupe"):
        score("FindDup", start, start)
    with pytest.raises(UnknownNameError, match="paper"):
        score("FindDupe", start, start, "papers")  # type: ignore[arg-type]


def test_horizons() -> None:
    assert [task_spec(task).horizon("paper") for task in TASKS[:8]] == [80, 40, 120, 180, 100, 60, 320, 320]
    assert [task_spec(task).horizon("released") for task in TASKS[:8]] == [80, 40, 120, 180, 100, 60, 240, 240]
