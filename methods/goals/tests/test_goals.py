"""Goals: inference from hand-made and shipped demonstrations, and the policy that plans towards the goal."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest
from magical_goals.arrangements import Grouped, InLine, Together
from magical_goals.inference import Example, InferredGoal, infer
from magical_goals.method import ends
from magical_goals.policy import GOALS, GoalPolicy, from_json, load_goals, to_json
from magical_goals.regions import Belonging, Near, RobotInside
from magical_goals.relation import Relation, layouts_of

import magical_mj
from magical_mj import TASKS, Block, GoalRegion, Robot, Scene, demos
from magical_mj.learners import load_settings, train
from magical_mj.learners.data import drawn
from magical_mj.policies.interface import Episode, play_actions
from magical_mj.tasks.planning import Noise, scene_after
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import SettingsError, TrainingError
from tests.helpers.learners import check_own_demonstrations

PROJECT = Path(__file__).parents[1]
COLOUR, BEGAN = "has the region's colour", "began in the region"
SHAPE = "has the shape of a block that began there"
GOAL_OF: dict[str, Relation] = {
    "MoveToCorner": Near("every block", "top left corner"),
    "MoveToRegion": RobotInside(),
    "MatchRegions": Belonging(((COLOUR, True),)),
    "MakeLine": InLine(),
    "FindDupe": Belonging(((COLOUR, True), (SHAPE, True))),
    "FixColour": Belonging(((COLOUR, True), (BEGAN, True))),
    "ClusterColour": Grouped("colour"),
    "ClusterShape": Grouped("shape"),
}


@pytest.fixture(scope="module")
def goals() -> dict[str, InferredGoal]:
    """Of each task, from the ten demonstrations of seed 0."""
    return {task: infer(examples(task, 0))[0] for task in TASKS}


def examples(task: str, seed: int) -> list[Example]:
    shipped = demos.load(task)
    return [ends(shipped[number]) for number in drawn(task, seed, 10, len(shipped))]


@pytest.mark.parametrize("task", TASKS)
def test_the_shipped_demonstrations_show_the_tasks_goal(task: str, goals: dict[str, InferredGoal]) -> None:
    assert goals[task].relation == GOAL_OF[task]
    first, second, *_ = [*infer(examples(task, 1)), InferredGoal(RobotInside(), (), 0.0)]
    assert first.relation == GOAL_OF[task]
    assert first.saved > second.saved + 5, f"{second} is nearly as likely"


@pytest.mark.parametrize("task", TASKS)
def test_subgoals_lead_to_the_goal_and_so_to_the_full_score(task: str, goals: dict[str, InferredGoal]) -> None:
    for seed in range(5):
        scene = magical_mj.sample_scene(task, "All", seed)
        after, noise = scene, Noise(np.random.default_rng(seed), 1.0)
        for _ in range(3):
            after = scene_after(after, goals[task].subgoals(scene, after, noise))
        assert goals[task].score(scene, after) == 1.0
        assert goals[task].subgoals(scene, after, noise) == ()
        assert magical_mj.score(task, scene, after) == 1.0


# Hand-made demonstrations, in which the robot does not move.

ROBOT = Robot(0.8, -0.8, 0.0)
LEFT, RIGHT = GoalRegion("red", -0.9, -0.3, -0.3, 0.3), GoalRegion("blue", 0.3, -0.3, 0.9, 0.3)
IN_LEFT, IN_RIGHT = (-0.6, 0.0), (0.6, 0.0)
CORNERS = [(-0.8, 0.8), (0.0, 0.8), (0.8, 0.7), (-0.7, -0.8), (0.0, -0.7)]


def scene_of(*kinds: str, regions: tuple[GoalRegion, ...] = ()) -> Scene:
    """A scene with blocks such as "red star", each at another position."""
    words: list[Any] = [kind.split() for kind in kinds]
    blocks = tuple(Block(shape, colour, *at, 0.0) for (colour, shape), at in zip(words, CORNERS, strict=False))
    return Scene(ROBOT, blocks, regions)


def demonstrations_of(scene: Scene, places: dict[int, tuple[float, float]], count: int = 10) -> list[Example]:
    """Demonstrations that bring some blocks near these positions, with small random differences."""
    rng = np.random.default_rng(0)
    ends = []
    for _ in range(count):
        poses = [block.pose for block in scene.blocks]
        for number, (x, y) in places.items():
            dx, dy = rng.uniform(-0.25, 0.25, 2)
            poses[number] = (x + dx, y + dy, 0.0)
        ends.append((scene, scene.moved(blocks=poses)))
    return ends


def test_what_relates_things_is_preferred_to_colours_and_shapes_as_such() -> None:
    scene = scene_of("red star", "green circle", "blue square", regions=(LEFT,))
    goal = infer(demonstrations_of(scene, {0: IN_LEFT}))[0]  # it is red, it is a star, and it has the region's colour
    assert goal.relation == Belonging(((COLOUR, True),))


def test_what_the_relation_cannot_explain_is_told_by_colours_and_shapes() -> None:
    scene = scene_of("red star", "green circle", "blue square", regions=(LEFT,))
    other = replace(scene, regions=(replace(LEFT, colour="blue"),))
    goals = infer([*demonstrations_of(scene, {0: IN_LEFT}, 5), *demonstrations_of(other, {0: IN_LEFT}, 5)])
    assert goals[0].relation in (Belonging((("is red", True),)), Belonging((("is a star", True),)))


def test_each_block_in_the_region_of_its_colour() -> None:
    scene = scene_of("red star", "blue star", "green star", regions=(LEFT, RIGHT))
    assert infer(demonstrations_of(scene, {0: IN_LEFT, 1: IN_RIGHT}))[0].relation == Belonging(((COLOUR, True),))


def test_limits_are_as_strict_as_the_demonstrations() -> None:
    scene = scene_of("red star", "blue star", "red circle")
    demonstrations = demonstrations_of(scene, {0: (-0.6, -0.6), 1: (-0.6, -0.6), 2: (-0.6, -0.6)})
    goal = infer(demonstrations)[0]
    assert goal.relation == Near("every block", "bottom left corner")
    farthest = max(np.hypot(block.x + 1, block.y + 1) for _, end in demonstrations for block in end.blocks)
    assert goal.limits == pytest.approx((farthest,))
    assert all(goal.score(*example) == 1.0 for example in demonstrations)
    assert goal.score(scene, scene) == 0.0


def test_blocks_together_whatever_they_are() -> None:
    scene = scene_of("red star", "blue star", "red circle", "green square")
    middles = [(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.4), (0.5, -0.3), (0.1, 0.0)] * 2
    rng = np.random.default_rng(0)
    ends = [np.add((*middle, 0.0), rng.uniform(-0.2, 0.2, (4, 3))) for middle in middles]
    assert infer([(scene, scene.moved(blocks=poses.tolist())) for poses in ends])[0].relation == Together()


def test_one_demonstration_that_failed_changes_nothing(goals: dict[str, InferredGoal]) -> None:
    (initial, _), *others = examples("FixColour", 0)
    assert infer([(initial, initial), *others])[0].relation == goals["FixColour"].relation


def test_demonstrations_that_show_nothing_are_refused() -> None:
    scene = scene_of("red star", "green circle", regions=(LEFT,))
    with pytest.raises(TrainingError, match="show no goal"):
        infer([(scene, scene)] * 10)
    rng = np.random.default_rng(0)
    poses = [rng.uniform(-0.8, 0.8, (3, 3)).tolist() for _ in range(10)]
    anywhere = [(scene, scene.moved(robot, blocks)) for robot, *blocks in poses]
    with pytest.raises(TrainingError, match="show no goal"):
        infer(anywhere)


@pytest.mark.parametrize(
    ("relation", "good", "bad"),
    [
        (InLine(), [(-0.6, 0.0), (-0.3, 0.0), (0.0, 0.0)], [(-0.6, 0.0), (-0.3, 0.5), (0.0, 0.0)]),
        (InLine(), [(-0.3, -0.3), (0.3, 0.3), (0.0, 0.0)], [(-0.8, 0.0), (0.8, 0.0), (0.6, 0.0)]),
        (Grouped("colour"), [(0.0, 0.0), (0.3, 0.0), (0.8, 0.8)], [(0.0, 0.0), (0.8, 0.8), (0.3, 0.0)]),
        (Grouped("shape"), [(0.0, 0.0), (0.8, 0.8), (0.3, 0.0)], [(0.0, 0.0), (0.3, 0.0), (0.8, 0.8)]),
        (Together(), [(0.0, 0.0), (0.3, 0.0), (0.0, 0.3)], [(0.0, 0.0), (0.3, 0.0), (0.0, 0.8)]),
        (Near("every block", "middle"), [(0.0, 0.0), (0.3, 0.0), (0.0, 0.3)], [(0.0, 0.0), (0.3, 0.0), (0.0, 0.8)]),
    ],
)
def test_how_far_blocks_are_off(relation: Relation, good: list[Any], bad: list[Any]) -> None:
    scene = scene_of("red star", "red circle", "blue star")
    scenes = [scene.moved(blocks=[(x, y, 0.0) for x, y in places]) for places in (good, bad)]
    off = relation.deviations(layouts_of(scene, scenes))
    assert off.shape[:2] == (2, 3)
    assert off[0].max() < off[1].max()
    assert (off >= 0).all()


def test_goals_survive_their_file(goals: dict[str, InferredGoal], tmp_path: Path) -> None:
    assert from_json(to_json({task: [goal] for task, goal in goals.items()})) == goals
    whole = to_json({"FixColour": [goals["FixColour"]], "MakeLine": [goals["MakeLine"]]})
    damaged = ["", "[]", '{"FixColour": 1}', "3", "[" * 50_000]
    damaged += [
        whole.replace("Belonging", "Longing"),
        whole.replace("began in", "ended in"),
        whole.replace("0.0", "NaN"),
        re.sub('"saved_bits": [0-9.]+', f'"saved_bits": {10**400}', whole),
    ]
    damaged += [whole.replace("InLine", "Together"), whole.replace('"limits"', '"limit"')]
    for text in damaged:
        (tmp_path / GOALS).write_text(text)
        with pytest.raises(TrainingError, match=GOALS):
            load_goals(tmp_path)


def test_from_training_to_scores(tmp_path: Path) -> None:
    settings = load_settings("goals", "MoveToRegion,FixColour", preset="State", evaluations=0)
    train(settings, tmp_path / "run")
    table = json.loads((tmp_path / "run" / GOALS).read_text())
    assert table["MoveToRegion"]["goal"] == "the robot is in a region"
    before = (tmp_path / "run" / GOALS).read_bytes()
    train(settings, tmp_path / "run", resume=True)  # the training is complete
    assert (tmp_path / "run" / GOALS).read_bytes() == before
    (tmp_path / "run" / GOALS).unlink()
    train(settings, tmp_path / "run", resume=True)  # from the checkpoint
    assert (tmp_path / "run" / GOALS).read_bytes() == before
    asked = {"tasks": "MoveToRegion,FixColour", "variants": "Layout", "episodes": 3, "preset": "State", "jobs": 1}
    first = magical_mj.evaluate(str(tmp_path / "run"), **asked)
    assert (first["score"] == 1.0).all()
    assert set(first["preset"]) == {"State"}
    assert list(magical_mj.evaluate(load_goals(tmp_path / "run"), **asked)["actions"]) == list(first["actions"])
    with pytest.raises(SettingsError, match="give --preset State"):
        magical_mj.evaluate(str(tmp_path / "run"), tasks="FixColour", variants="Demo", preset="LoRes4E", episodes=1)


def test_ones_own_demonstrations_are_learnt_from(tmp_path: Path) -> None:
    check_own_demonstrations("goals", {"preset": "State"}, tmp_path)


def test_pictures_are_refused() -> None:
    with pytest.raises(SettingsError, match="give --preset State"):
        train(load_settings("goals", "FixColour"), "never-made")


@pytest.mark.slow
def test_whoever_installs_the_package_has_the_method(tmp_path: Path) -> None:
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--disable-pip-version-check", "--target", "site"]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, str(PROJECT)], cwd=tmp_path, check=True)
    path = os.pathsep.join(filter(None, (str(tmp_path / "site"), os.environ.get("PYTHONPATH"))))
    code = """
    from magical_mj.cli import main

    for command in (
        "train goals --tasks FixColour --preset State --set evaluations=0 --out run",
        "evaluate --policy run --tasks FixColour --variants Demo --episodes 1 --jobs 1 --preset State --out scores",
    ):
        assert main(command.split()) == 0, command
    """
    call = [sys.executable, "-c", dedent(code)]
    subprocess.run(call, cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}, check=True)
    assert set((tmp_path / "run").iterdir()) >= {tmp_path / "run" / GOALS}
    assert "[ppo]" not in (tmp_path / "run" / "config.toml").read_text()  # it uses none of these settings
    assert '"score": 1.0' in (tmp_path / "scores" / "scores.jsonl").read_text()


ASKED: list[str] = []
"""The forbidden calls of the policy to the task below."""


def _score(*_: Any) -> float:
    ASKED.append("score")
    return 0.0


def _plan(*_: Any) -> list[Any]:
    ASKED.append("plan")
    return []


TASK = replace(task_spec("FixColour"), name="Unscored", score=_score, plan=_plan)


def test_the_policy_uses_neither_the_tasks_score_nor_its_plan(goals: dict[str, InferredGoal]) -> None:
    env = magical_mj.Engine(f"{__name__}:TASK", "Layout", seed=4)
    env.reset(seed=4)
    ASKED.clear()
    policy = GoalPolicy({"Unscored": goals["FixColour"]})
    policy.reset(Episode("Unscored", "Layout", 4, 0, env=env))
    actions = [action for action, _ in play_actions(env, iter(lambda: policy(None), None))]
    assert len(actions) == env.horizon
    assert not ASKED
    assert magical_mj.score("FixColour", env.initial_scene, env.scene) == 1.0
