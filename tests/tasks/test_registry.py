"""Tasks, variants and environments by name."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from magical_mj.engine import Engine
from magical_mj.envs.registration import env_id
from magical_mj.tasks.planning import Noise
from magical_mj.tasks.registry import ENVIRONMENTS, environments, sample_scene, score, task_name, task_spec
from magical_mj.utils.errors import InvalidSceneError, SettingsError, TaskError, UnknownNameError


def test_lists_of_environments() -> None:
    """In the given order, each once."""
    assert environments() == environments("all", ["all"]) == list(ENVIRONMENTS)
    assert environments("MoveToRegion,MoveToCorner,MoveToRegion", "Shape,Layout,Demo") == [
        ("MoveToRegion", "Layout"),
        ("MoveToRegion", "Demo"),
        ("MoveToCorner", "Shape"),
        ("MoveToCorner", "Demo"),
    ]
    assert environments("MoveToCorner, MoveToRegion", ["Layout", "TestShape"]) == [
        ("MoveToCorner", "Shape"),
        ("MoveToRegion", "Layout"),
    ]


@pytest.mark.parametrize(
    ("tasks", "variants", "error", "word"),
    [
        *((nothing, "all", SettingsError, "at least one") for nothing in ("", ",", [], [""], 5, None, np.array("all"))),
        ([np.ones(3)], "all", UnknownNameError, "array"),
        ("FindDup", "all", UnknownNameError, "FindDupe"),
        ("all", "Shapes", UnknownNameError, "Shape"),
        ("MoveToCorner", "Layout", UnknownNameError, "Layout"),
    ],
)
def test_lists_that_name_no_environment(tasks: Any, variants: str, error: type[Exception], word: str) -> None:
    with pytest.raises(error, match=word):
        environments(tasks, variants)


def test_a_reference_to_a_task_with_a_name_is_that_task() -> None:
    assert task_name("magical_mj.tasks.find_dupe:SPEC") == "FindDupe"
    assert environments("magical_mj.tasks.find_dupe:SPEC,FindDupe", "Demo") == [("FindDupe", "Demo")]
    assert env_id("magical_mj.tasks.find_dupe:SPEC", "TestShape") == "magical_mj/FindDupe-TestShape-v0"


MINE = """
from dataclasses import replace
import numpy as np
from magical_mj.tasks.planning import Subgoal
from magical_mj.scene import Robot
from magical_mj.tasks.match_regions import SPEC as OURS

GOOD = replace(OURS, name="Mine")
AGAIN = replace(GOOD)
TAKEN = replace(OURS)
DEMO = OURS.demo
OUTSIDE = replace(GOOD, demo=replace(DEMO, robot=Robot(2.0, 0.0, 0.0)))
NOT_ITS_OWN = replace(GOOD, demo=replace(DEMO, regions=()))
TWO = replace(GOOD, score=lambda initial, final, rules: 2.0)
TEXT = replace(GOOD, score=lambda initial, final, rules: "all")
NO_RULES = replace(GOOD, score=lambda initial, final: 0.0)
YES = replace(GOOD, check=lambda scene: True)
WRONG_ERROR = replace(GOOD, check=lambda scene: 1 / 0)
NO_SCENE = replace(GOOD, colour=lambda rng, scene: None)
MOVED = replace(GOOD, colour=lambda rng, scene: scene.moved(blocks=[(0, 0, 0)] * len(scene.blocks)))
LATER = replace(GOOD, score=lambda initial, final, rules: 2.0 if final.robot != initial.robot else 0.0)
ROUNDED = replace(GOOD, score=lambda initial, final, rules: 0.05 + 0.55 + 0.3 + 0.1)
PURPLE = replace(GOOD, colour=lambda rng, scene: replace(scene, blocks=(replace(scene.blocks[0], colour="purple"),)))
TURNED = lambda scene: scene.moved(robot=(scene.robot.x, scene.robot.y, float(np.random.default_rng().uniform())))
CHANCE = replace(GOOD, colour=lambda rng, scene: TURNED(scene))
LOST = lambda initial, now: 1 / 0 if now.robot != initial.robot else None
FAILS = replace(GOOD, score=lambda initial, final, rules: LOST(initial, final) or 0.0)
NO_PLAN = replace(GOOD, plan=lambda initial, now, noise: LOST(initial, now) or (Subgoal(k / 0, (0, 0)) for k in (0,)))
ERRS = replace(GOOD, colour=lambda rng, scene: 1 / 0 if rng.random() < 0.1 else scene)
NOWHERE = replace(GOOD, plan=lambda initial, now, noise: None)
PAIRS = replace(GOOD, plan=lambda initial, now, noise: [(0, (0.0, 0.0))])
BEYOND = replace(GOOD, plan=lambda initial, now, noise: [Subgoal(99, (0.0, 0.0))])
NAN = replace(GOOD, plan=lambda initial, now, noise: [Subgoal(0, (float("nan"), 0.0))])
SOLID = replace(GOOD, plan=lambda initial, now, noise: [Subgoal(0, (0.0, 0.0, 0.0))])
NUMBER = replace(GOOD, plan=lambda initial, now, noise: [Subgoal(None, 0.5)])
MANY = lambda rng, scene: replace(scene, blocks=scene.blocks[:1] * (20 - int(rng.integers(8, 13))))
CROWDED = replace(GOOD, count=MANY)
RARELY = replace(GOOD, colour=lambda rng, scene: replace(scene, regions=()) if rng.random() < 0.1 else scene)
(REGION,) = DEMO.regions
STUCK = replace(GOOD, demo=DEMO.moved(robot=(REGION.x_min - 0.05, REGION.y_max - 0.3, 0.0)))
POSES = [block.pose for block in DEMO.blocks]
SHAPES = replace(GOOD, demo=DEMO.moved(blocks=[POSES[0], (-0.68, 0.72, 0.0), POSES[2], (-0.48, 0.72, 0.0), POSES[4]]))
TOUCHING = replace(SHAPES, shape=None, count=None)
AT_WALL = replace(GOOD, demo=DEMO.moved(robot=(0.82, -0.3, 0.0)))
SOLVED = replace(GOOD, score=lambda initial, final, rules: float(initial.robot == final.robot))
INSIDE = replace(GOOD, demo=DEMO.moved(robot=(*REGION.centre, 0.0)))
"""


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The name of a module with tasks of one's own."""
    name = f"mine_{tmp_path.name}"
    (tmp_path / f"{name}.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)  # whose modules are found
    monkeypatch.setattr(sys, "path", sys.path[:])
    monkeypatch.setattr(gymnasium, "registry", dict(gymnasium.registry))
    monkeypatch.setattr("gymnasium.envs.registration.registry", gymnasium.registry)
    yield name
    del sys.modules[name]


def test_tasks_of_ones_own_are_played_by_reference(mine: str) -> None:
    good = f"{mine}:GOOD"
    assert environments([good, "MakeLine"], "Demo") == [(good, "Demo"), ("MakeLine", "Demo")]
    scene = sample_scene(good, "CountPlus", 3)
    assert score(good, scene, scene) == 0.0
    assert scene != sample_scene("MatchRegions", "CountPlus", 3), "a task has random numbers of its own"
    assert env_id(good, "All") == env_id(good, "All") == "magical_mj/Mine-TestAll-v0"
    with pytest.raises(TaskError, match="rename the task"):
        env_id(f"{mine}:AGAIN", "All")


@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("DEMO", "TaskSpec"),
        ("TAKEN", "MatchRegions"),
        ("OUTSIDE", "demo scene: robot"),
        ("NOT_ITS_OWN", "not a scene of MatchRegions"),
        ("TWO", "returned 2"),
        ("TEXT", "returned 'all'"),
        ("NO_RULES", "TypeError"),
        ("YES", "Mine.check"),
        ("WRONG_ERROR", r"ZeroDivisionError.*mine_.*, line \d+"),
        ("PURPLE", r"purple.*mine_.*, line \d+"),
        ("CHANCE", "different scenes for one seed"),
        ("NO_SCENE", "Mine.colour"),
        ("MOVED", "Colour .* overlap"),
        ("STUCK", "no room for Robot"),
        *((name, "in the demo scene of Mine, block 1 touches block 3: move them") for name in ("TOUCHING", "SHAPES")),
        ("AT_WALL", "in the demo scene of Mine, robot touches a wall"),
    ],
)
def test_tasks_that_cannot_be_played_are_refused(mine: str, name: str, word: str) -> None:
    sample_scene(f"{mine}:GOOD", "Demo", 0)
    with pytest.raises(TaskError, match=word):
        sample_scene(f"{mine}:{name}", "Demo", 0)


def test_later_scores_and_scenes_of_ones_own_are_checked_too(mine: str) -> None:
    env = Engine(f"{mine}:LATER", seed=0)
    env.reset()
    assert env.score() == 0.0
    env.step(2)
    with pytest.raises(TaskError, match="returned 2"):
        env.score()
    with pytest.raises(TaskError, match=r"seed \d+"):
        [sample_scene(f"{mine}:RARELY", "Colour", seed) for seed in range(100)]


def test_errors_in_the_code_of_ones_own_task_say_where(mine: str) -> None:
    """Also in code that runs later than the checks of a task."""
    where = r"ZeroDivisionError: .* \(.*mine_.*\.py, line \d+\)$"
    env = Engine(f"{mine}:FAILS", seed=0)
    env.reset()
    env.step(2)
    with pytest.raises(TaskError, match=f"^Mine.score failed: {where}"):
        env.score()
    spec = task_spec(f"{mine}:NO_PLAN")
    for now in (spec.demo, spec.demo.moved(robot=(0.0, 0.0, 0.0))):  # in the generator, and in the function
        with pytest.raises(TaskError, match=f"^Mine.plan failed: {where}"):
            spec.subgoals((spec.demo, now), Noise(np.random.default_rng(0), 0.0))
    with pytest.raises(TaskError, match=rf"^Mine-Colour cannot be drawn from seed \d+: {where}"):
        [sample_scene(f"{mine}:ERRS", "Colour", seed) for seed in range(100)]


def test_a_scene_that_does_not_fit_the_state_vector_ends_no_episode(mine: str) -> None:
    env = gymnasium.make(env_id(f"{mine}:CROWDED", "CountPlus", "State"))
    seeds = [seed for seed in range(8) if len(sample_scene(f"{mine}:CROWDED", "CountPlus", seed).blocks) > 10]
    assert 0 < len(seeds) < 8
    env.reset(seed=min(set(range(8)) - set(seeds)))
    env.step(4)
    before = env.unwrapped.get_state()
    with pytest.raises(InvalidSceneError, match="10 blocks"):
        env.reset(seed=seeds[0])
    assert env.unwrapped.get_state() == before
    env.step(1)


def test_rounding_makes_no_score_invalid(mine: str) -> None:
    with pytest.warns(UserWarning, match="solved at the start"):
        scene = sample_scene(f"{mine}:ROUNDED", "Demo", 0)
    assert 0.05 + 0.55 + 0.3 + 0.1 > 1
    assert score(f"{mine}:ROUNDED", scene, scene) == 1


def test_a_demo_scene_that_is_solved_at_the_start_is_warned_of(mine: str) -> None:
    with pytest.warns(UserWarning, match="of Mine is solved at the start: a policy that does nothing scores 1.0"):
        env = Engine(f"{mine}:SOLVED", seed=0)
    assert env.score() == 1.0


def test_plans_of_ones_own_are_checked(mine: str) -> None:
    returned = {"NOWHERE": "None", "PAIRS": r"\(0, ", **dict.fromkeys(("BEYOND", "NAN", "SOLID", "NUMBER"), "Subgoal")}
    for name, value in returned.items():
        spec = task_spec(f"{mine}:{name}")
        with pytest.raises(TaskError, match=f"Mine.plan .* returned {value}"):
            spec.subgoals((spec.demo, spec.demo), Noise(np.random.default_rng(0), 0.0))


def test_a_task_that_was_edited_and_reloaded_is_the_new_one(mine: str) -> None:
    good = f"{mine}:GOOD"
    assert Engine(good).horizon == task_spec("MatchRegions").steps
    file = Path(f"{mine}.py")
    file.write_text(MINE.replace('name="Mine"', 'name="Mine", steps=17'))
    gymnasium.make(env_id(good)).close()
    importlib.reload(sys.modules[mine])
    assert Engine(good).horizon == 17
    spec = gymnasium.make(env_id(good)).spec
    assert spec is not None
    assert spec.max_episode_steps == 17
    file.write_text(MINE.replace('name="Mine"', 'name="Mine", score=lambda initial, final, rules: 2.0'))
    importlib.reload(sys.modules[mine])
    with pytest.raises(TaskError, match="returned 2"):
        Engine(good)


def test_a_robot_that_belongs_in_a_region_stays_there(mine: str) -> None:
    for variant in ("Jitter", "Layout", "All"):
        for seed in range(5):
            scene = sample_scene(f"{mine}:INSIDE", variant, seed)
            assert scene.regions[0].contains(scene.robot)


@pytest.mark.parametrize(
    ("task", "word"),
    [
        ("no_such_module:SPEC", "No module"),
        ("magical_mj.tasks:NONE", "NONE"),
        ("magical_mj.tasks.find_dupe", "package.module:SPEC"),
        ("a b:SPEC", "a b:SPEC"),
        (["FindDupe"], "unknown"),
        (None, "None"),
        ("x" * 10_000, r"x\.\.\."),
        pytest.param(10**5000, "type int", id="many digits"),
    ],
)
def test_unknown_tasks_are_refused(task: Any, word: str) -> None:
    with pytest.raises(UnknownNameError, match=word):
        task_spec(task)


@pytest.mark.parametrize(
    "changes",
    [
        {"name": "Find-Dupe"},
        {"demo": None},
        {"steps": 0},
        {"released_steps": 1.5},
        *({"region_size": sizes} for sizes in ((0.0, 0.0), (0.8, 0.5), (0.5, float("nan")), 0.5, (0.5, 0.7))),
        {"layout": "no"},
        {"inner_margin": 0.25},
        {"score": None},
        {"plan": "drive"},
    ],
)
def test_specs_are_checked(changes: dict[str, Any]) -> None:
    (field,) = changes
    with pytest.raises(TaskError, match=field.removeprefix("released_")):
        replace(task_spec("FindDupe"), **changes)


def test_counts_need_layouts() -> None:
    with pytest.raises(TaskError, match="layout=False"):
        replace(task_spec("FindDupe"), layout=False)
