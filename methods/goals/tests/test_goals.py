"""Goals: what demonstrations have in common, hand-made and shipped; and the policies that plan towards it."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from magical_goals.inference import Goal, best_intent, infer
from magical_goals.policy import GOALS, GoalPolicy, InferredGoal, from_json, load_goals, to_json

import magical_mj
from magical_mj import Block, GoalRegion, Robot, Scene, demos
from magical_mj.intents import EIGHT, parse
from magical_mj.intents.ambiguity import Ends, ends_of
from magical_mj.learners import load_settings, train
from magical_mj.learners.data import drawn
from magical_mj.policies.interface import Episode, play_actions
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import SettingsError, TrainingError
from tests.helpers.learners import check_own_demonstrations

PROJECT = Path(__file__).parents[1]
INFERRED = {
    "MoveToCorner": "corner(all, top left)",
    "MoveToRegion": "robot in()",
    "MatchRegions": "exactly(2, colour=green)",
    "MakeLine": "line(all)",
    "FindDupe": "exactly(2, all) & untouched(like!=both)",
    "FixColour": "out(odd=colour)",
    "ClusterColour": "clustered(all, by=colour)",
    "ClusterShape": "clustered(all, by=shape)",
}


def examples(task: str, seed: int) -> list[Ends]:
    shipped = demos.load(task)
    return [ends_of(shipped[number]) for number in drawn(task, seed, 10, len(shipped))]


@pytest.mark.parametrize("task", INFERRED)
def test_intents_are_inferred_from_the_shipped_demonstrations(task: str) -> None:
    first, *others = infer(examples(task, 0))
    assert str(first.intent) == INFERRED[task]
    assert all(first.saved >= other.saved for other in others)
    ambiguous = ("MoveToCorner", "MatchRegions", "FindDupe", "FixColour")
    assert (first.intent == EIGHT[task]) == (task not in ambiguous)


# Hand-made demonstrations. The robot has nothing to do with them.

ROBOT = Robot(0.8, -0.8, 0.0)
LEFT = GoalRegion("red", -0.9, -0.3, -0.3, 0.3)
IN_LEFT = (-0.6, 0.0)
CORNERS = [(-0.8, 0.8), (0.0, 0.8), (0.8, 0.7), (-0.7, -0.8), (0.0, -0.7)]


def scene_of(*kinds: str, regions: tuple[GoalRegion, ...] = (LEFT,)) -> Scene:
    """A scene with blocks such as "red star", all in other places."""
    words: list[Any] = [kind.split() for kind in kinds]
    blocks = tuple(Block(shape, colour, *at, 0.0) for (colour, shape), at in zip(words, CORNERS, strict=False))
    return Scene(ROBOT, blocks, regions)


def ended(scene: Scene, places: dict[int, tuple[float, float]]) -> Ends:
    """A demonstration that brings some blocks to these places."""
    poses = [(*places.get(number, block.pose[:2]), 0.0) for number, block in enumerate(scene.blocks)]
    return scene, scene.moved(blocks=poses)


def test_further_scenes_settle_what_one_leaves_open() -> None:
    one = scene_of("red star", "green circle", "blue square")
    in_left = ended(one, {0: IN_LEFT})
    assert str(infer([in_left] * 4)[0].intent) != "in(shape=star, region)"
    other = scene_of("green square", "yellow star", "red circle", "red square")
    third = scene_of("green circle", "blue star", "blue star", "yellow square")
    both = ended(third, {1: (-0.7, 0.1), 2: (-0.5, -0.1)})
    assert str(infer([in_left, ended(other, {1: IN_LEFT}), both, both])[0].intent) == "in(shape=star, region)"


def test_the_strictest_of_equally_simple_intents_is_inferred() -> None:
    scene = scene_of("red star", "green circle", regions=())
    places = [{0: (-0.9, y), 1: (-0.85, -y)} for y in (0.5, 0.3, -0.4, -0.5)]
    assert str(infer([ended(scene, each) for each in places])[0].intent) == "wall(all, left)"


def test_several_relations_are_inferred() -> None:
    scenes = [
        scene_of("red square", "green circle", "blue square", "yellow star"),
        scene_of("green star", "red circle", "red square", "blue star"),
        scene_of("blue circle", "green star", "red square", "red pentagon"),
    ]
    red = [{0: IN_LEFT}, {1: IN_LEFT, 2: (-0.7, 0.2)}, {2: IN_LEFT, 3: (-0.7, 0.2)}]
    stars = [{3: (0.9, 0.1)}, {0: (0.9, 0.5), 3: (0.9, -0.2)}, {1: (0.9, 0.1)}]
    goals = infer([ended(scene, a | b) for scene, a, b in zip(scenes, red, stars, strict=True)] * 2)
    relations = [str(one) for one in goals[0].intent.conjuncts]
    assert len(relations) == 2
    assert "wall(shape=star, right)" in relations


def test_demonstrations_that_show_nothing_are_refused() -> None:
    scene = scene_of("red star", "green circle")
    with pytest.raises(TrainingError, match="show no goal"):
        infer([(scene, scene)] * 10)


def test_an_intent_that_means_nothing_or_holds_in_a_scene_is_not_pursued() -> None:
    goals = [Goal(parse(text), 1.0) for text in ("in(shape=star, region)", "out(all)", "wall(all, left)")]
    scene = scene_of("red square", "green circle")  # no block is in a region
    assert best_intent(goals[:2], scene_of("red star", "green circle")) == goals[0].intent
    assert best_intent(goals, scene) == goals[2].intent
    assert best_intent(goals[:2], scene) is None


def test_the_plan_with_the_largest_expected_score_is_pursued() -> None:
    one, both, other = map(
        parse,
        ("wall(colour=red, right)", "wall(colour=red, right) & wall(colour=blue, bottom)", "wall(colour=blue, bottom)"),
    )
    scene = scene_of("red square", "blue circle")
    assert best_intent([Goal(one, 1.0), Goal(both, 0.9)], scene) == both
    assert best_intent([Goal(one, 1.0), Goal(other, 0.9)], scene) == one
    assert best_intent([Goal(one, 9.0), Goal(other, 1.0)], scene) == one


def test_goals_survive_their_file(tmp_path: Path) -> None:
    goals = {task: infer(examples(task, 0))[:3] for task in ("MoveToRegion", "FixColour")}
    assert from_json(to_json(goals)) == goals
    whole = to_json(goals)
    damaged = ["", "[]", '{"FixColour": 1}', "3", "[" * 50_000]
    damaged += [whole.replace("robot in()", "robot on()"), whole.replace('"intents"', '"intent"')]
    damaged += [re.sub(r"\d+\.\d+", "NaN", whole), re.sub(r"\d+\.\d+", str(10**400), whole)]
    damaged.append(re.sub(r'"intents": {[^}]*}', '"intents": {}', whole))
    for text in damaged:
        (tmp_path / GOALS).write_text(text)
        with pytest.raises(TrainingError, match=GOALS):
            load_goals(tmp_path)


def test_from_training_to_scores(tmp_path: Path) -> None:
    settings = load_settings("goals", "MoveToRegion,MakeLine", preset="State", evaluations=0)
    train(settings, tmp_path / "run")
    table = json.loads((tmp_path / "run" / GOALS).read_text())
    assert table["MoveToRegion"]["goal"] == EIGHT["MoveToRegion"].sentence
    before = (tmp_path / "run" / GOALS).read_bytes()
    train(settings, tmp_path / "run", resume=True)  # there is nothing left to do
    assert (tmp_path / "run" / GOALS).read_bytes() == before
    (tmp_path / "run" / GOALS).unlink()
    train(settings, tmp_path / "run", resume=True)  # with what the checkpoint holds
    assert (tmp_path / "run" / GOALS).read_bytes() == before
    asked = {"tasks": "MoveToRegion,MakeLine", "variants": "Layout", "episodes": 2, "jobs": 1}
    first = magical_mj.evaluate(str(tmp_path / "run"), **asked)
    assert (first["score"] == 1.0).all()
    assert set(first["preset"]) == {"State"}
    assert list(magical_mj.evaluate(load_goals(tmp_path / "run"), **asked)["actions"]) == list(first["actions"])
    with pytest.raises(SettingsError, match="give --preset State"):
        magical_mj.evaluate(str(tmp_path / "run"), tasks="MakeLine", variants="Demo", preset="LoRes4E", episodes=1)


def test_demonstrations_at_test_time_say_what_to_do() -> None:
    asked = {"tasks": "MoveToRegion,MoveToCorner", "demonstrations": 10, "jobs": 1}
    scores = magical_mj.evaluate(InferredGoal(), variants="Demo,Jitter", episodes=1, **asked)
    assert (scores["score"] == 1.0).all()
    assert set(scores["given"]) == {"10 demonstrations"}
    wrong = magical_mj.evaluate(
        InferredGoal(), variants="Demo", episodes=1, control="wrong-demonstrations", **asked | {"tasks": "MakeLine"}
    )
    assert wrong["score"].item() < 1.0


def test_ones_own_demonstrations_are_learnt_from(tmp_path: Path) -> None:
    check_own_demonstrations("goals", {"preset": "State"}, tmp_path)


def test_pictures_are_refused() -> None:
    with pytest.raises(SettingsError, match="give --preset State"):
        train(load_settings("goals", "FixColour"), "never-made")


@pytest.mark.weekly
def test_the_installed_package_announces_the_method(tmp_path: Path) -> None:
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--disable-pip-version-check", "--target", "site"]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, str(PROJECT)], cwd=tmp_path, check=True)
    path = os.pathsep.join(filter(None, (str(tmp_path / "site"), os.environ.get("PYTHONPATH"))))
    command = "train goals --tasks MoveToRegion --preset State --set evaluations=0 --out run"
    call = [sys.executable, "-m", "magical_mj", *command.split()]
    subprocess.run(call, cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}, check=True)
    assert set((tmp_path / "run").iterdir()) >= {tmp_path / "run" / GOALS}
    assert "[ppo]" not in (tmp_path / "run" / "config.toml").read_text()  # it uses none of these settings


ASKED: list[str] = []
"""What the policy asked of the task below, and must not."""


def _score(*_: Any) -> float:
    ASKED.append("score")
    return 0.0


def _plan(*_: Any) -> list[Any]:
    ASKED.append("plan")
    return []


TASK = replace(task_spec("FixColour"), name="Unscored", score=_score, plan=_plan)


def test_the_policy_uses_neither_the_tasks_score_nor_its_plan() -> None:
    env = magical_mj.Engine(f"{__name__}:TASK", "Layout", seed=4)
    env.reset(seed=4)
    ASKED.clear()
    policy = GoalPolicy({"Unscored": [Goal(EIGHT["FixColour"], 1.0)]})
    policy.reset(Episode("Unscored", "Layout", 4, 0, env=env))
    actions = [action for action, _ in play_actions(env, iter(lambda: policy(None), None))]
    assert len(actions) == env.horizon
    assert not ASKED
    assert magical_mj.score("FixColour", env.initial_scene, env.scene) == 1.0
