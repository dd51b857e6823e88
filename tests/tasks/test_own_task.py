"""Tasks in packages of their own: that of docs/adding-a-task.md, as a user uses it, and those of examples/outside."""

from __future__ import annotations

import importlib
import pickle
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from textwrap import dedent
from typing import Any

import gymnasium
import numpy as np
import pytest

import magical_mj
from magical_mj.envs.registration import env_id
from magical_mj.evaluation import Episode, EpisodeResult, rollouts
from magical_mj.evaluation.replay import replay
from magical_mj.tasks.find_dupe import SPEC as FIND_DUPE
from magical_mj.tasks.planning import Noise, scene_after
from magical_mj.tasks.registry import VARIANTS, environments, task_spec
from magical_mj.utils.errors import InvalidSceneError, SettingsError, StateError, TaskError
from magical_mj.variants import vary
from tests.helpers.commands import code_block, example, installed, python_beside

pytestmark = pytest.mark.xdist_group("own task")  # of one installation

PAGE = (Path(__file__).parents[2] / "docs" / "adding-a-task.md").read_text()
EXAMPLE = example("push_out")
TINY = "network.first_stride=4 network.first_channels=4 network.channels=4 network.hidden=8 "
TINY += "bc.batches=4 bc.batch_size=4 evaluations=0 checkpoints=1 demonstrations=1"


DOES = """
import shlex
from magical_mj.cli import main

def does(command):
    code = main(shlex.split(command))
    assert code == 0, f"{command}: {code}"

"""


class User:
    """Somebody who has installed the package, and works in a folder of their own."""

    def __init__(self, home: Path, site: Path) -> None:
        self.home, self.site = home, site
        home.mkdir()
        (home / "watcher.py").write_text("def act(observation):\n    return int(observation.sum()) % 18\n")

    def python(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run Python; whether it succeeds is for the test to say."""
        return python_beside(self.site, self.home, *arguments)

    def runs(self, code: str) -> str:
        """Run some Python, in which `does` runs `magical-mj`; it must succeed. What it printed."""
        done = self.python("-c", DOES + dedent(code))
        assert done.returncode == 0, done.stderr
        return done.stdout


@pytest.fixture(scope="module")
def user(tmp_path_factory: pytest.TempPathFactory) -> User:
    folder = tmp_path_factory.mktemp("user")
    project = shutil.copytree(EXAMPLE, folder / "with_demonstrations" / "push_out")
    (project / "push_out_demonstrations").mkdir()
    (project / "push_out_demonstrations" / "about.txt").touch()
    return User(folder / "home", installed(project, folder))


def test_the_page_shows_parts_of_the_example() -> None:
    example = (EXAMPLE / "push_out.py").read_text()
    assert all(part in example for part in code_block(PAGE, "python", "DEMO").split("\n\n\n"))
    assert code_block(PAGE, "toml", "[project.entry") in (EXAMPLE / "pyproject.toml").read_text()


def test_its_demonstrations_are_installed_with_it(user: User) -> None:
    assert (user.site / "push_out_demonstrations" / "about.txt").exists()
    assert (user.site / "push_out.py").exists()


def test_it_is_listed_and_played_by_its_name_and_by_its_reference(user: User) -> None:
    printed = user.runs(
        """
        import push_out  # before magical_mj, which announces it
        import gymnasium, magical_mj
        from magical_mj.tasks.registry import environments
        from magical_mj.scene import Scene

        assert len(magical_mj.ENVIRONMENTS) == 60
        assert environments("push_out:SPEC", "Demo") == [("PushOut", "Demo")]
        scene = magical_mj.sample_scene("push_out:SPEC", "All", 7)
        assert scene == magical_mj.sample_scene("PushOut", "All", 7)
        apart = scene.moved(blocks=[(-2, -2, 0)] * len(scene.blocks))
        assert magical_mj.score("PushOut", scene, scene) == 0 and magical_mj.score("PushOut", scene, apart) == 1

        for task in ("PushOut", "push_out:SPEC"):
            env = magical_mj.Engine(task, "All", seed=7)
            env.reset(seed=7)
            assert env.scene == scene and env.horizon == 120
            name = magical_mj.env_id(task, "All", "State")
            assert name == "magical_mj/PushOut-TestAll-State-v0"
            env = gymnasium.make(name)
            env.reset(seed=7)
            assert env.unwrapped.scene == scene
        env = gymnasium.make_vec(name, 1, vectorization_mode="async", vector_kwargs={"context": "spawn"})
        env.reset(seed=7)
        env.close()
        does("list")
        does("list --ids")
        """
    )
    assert re.findall(r"^PushOut +(\w+) +120 ", printed, re.MULTILINE) == list(VARIANTS)
    assert printed.split()[-2:] == ["magical_mj/PushOut-TestDynamics-v0", "magical_mj/PushOut-TestAll-v0"]


@pytest.mark.slow
def test_it_is_evaluated_and_reported(user: User) -> None:
    episodes = "--variants Demo --episodes 1 --preset State --jobs 1"
    user.runs(
        f"""
        does("evaluate --policy watcher:act,expert --tasks PushOut {episodes} --out own")
        does("evaluate --policy watcher:act --tasks push_out:SPEC,MoveToRegion {episodes} --out mixed")
        does("report own --published")
        does("report mixed --published")
        """
    )
    table = (user.home / "own" / "report" / "report.md").read_text()
    assert re.search(r"^\| expert \| 1\.00", table, re.MULTILINE)
    assert "PushOut" in table
    assert "without MoveToCorner" not in table
    assert "Mean score over PushOut, " in table
    assert "BC (ST)" not in table
    assert "it has none in these tasks" in table
    mixed = (user.home / "mixed" / "report" / "report.md").read_text()
    assert "which the means over tasks do not include: PushOut" in mixed
    assert "Mean score over all tasks, " in mixed
    assert "BC (ST)" in mixed
    assert mixed.index("**MoveToRegion**") < mixed.index("**PushOut**")
    assert (user.home / "mixed" / "report" / "heat_map.png").stat().st_size > 0


@pytest.mark.slow
def test_it_is_demonstrated_exported_and_learnt(user: User) -> None:
    folder = user.site / "push_out_demonstrations"
    settings = " ".join(f"--set {setting}" for setting in TINY.split())
    printed = user.runs(
        f"""
        from dataclasses import replace
        from pathlib import Path
        import mujoco
        from magical_mj import demos
        from magical_mj.learners import load_settings
        from magical_mj.learners.data import to_choose_from

        does("demos generate --tasks push_out:SPEC --count 1 --jobs 1 --out {folder}")
        does("demos verify {folder} --jobs 1")
        does("demos export {folder} --out folder.npz")
        does("demos export --tasks push_out:SPEC --out same.npz")  # by default those in the task's own folder
        assert Path("same.npz").read_bytes() == Path("folder.npz").read_bytes()

        (demo,) = demos.load("PushOut")
        demos.write(replace(demo, task="push_out:SPEC"), "before/PushOut-Demo-000.npz")  # before it was announced
        assert [demo.task for demo in demos.load("PushOut", "before")] == ["PushOut"]
        does("demos info before")

        does("train bc --tasks PushOut --quick --out run {settings}")
        does("evaluate --policy run --tasks PushOut --variants Demo --episodes 1 --jobs 1 --out learnt")
        does("demos generate --tasks push_out:SPEC --variants All --count 1 --jobs 1 --out {folder}")
        assert [demo.variant for demo in demos.load("PushOut")] == ["All", "Demo"]
        learnt = to_choose_from(load_settings("bc", "PushOut"), "PushOut")
        assert [demo.variant for demo in learnt] == ["Demo"]

        does("view PushOut All --out picture.png")
        does("export push_out:SPEC All --out models")
        model = mujoco.MjModel.from_xml_path("models/PushOut-All-0.xml")
        mujoco.mj_step(model, mujoco.MjData(model), 100)
        """
    )
    assert {path.name for path in folder.glob("*.npz")} == {"PushOut-Demo-000.npz", "PushOut-All-000.npz"}
    assert "1 of 1 replay to the same score" in printed
    assert "PushOut-Demo" in printed


def test_without_a_plan_everything_but_the_expert_works(user: User) -> None:
    (user.home / "planless.py").write_text(
        "from dataclasses import replace\nfrom push_out import SPEC as PUSH_OUT\n"
        'SPEC = replace(PUSH_OUT, name="Planless", plan=None)\n'
    )
    episodes = "--tasks planless:SPEC --variants Demo --episodes 1 --jobs 1"
    user.runs(
        f"""
        import contextlib, io
        from magical_mj import Engine, demos

        with contextlib.redirect_stderr(io.StringIO()) as said:
            assert main(shlex.split("evaluate --policy expert {episodes} --out stuck")) == 2
        assert "Planless has no plan, which an expert needs" in said.getvalue()
        does("evaluate --policy noop {episodes} --out planless")
        for task, known, name in (
            ("planless:SPEC", "planless:SPEC", "Planless"), ("push_out:SPEC", "PushOut", "PushOut")
        ):
            env = Engine(task, seed=0)
            recorder = demos.Recorder(env)
            recorder.step(1)
            path, _ = demos.keep(recorder.demonstration("human"), "played")
            assert path.name == name + "-Demo-human-000.npz"
            assert [demo.task for demo in demos.load(task, "played")] == [known]
        """
    )


def test_rules_can_be_exchanged_for_ones_own() -> None:
    code: dict[str, Any] = {}
    exec(compile(code_block(PAGE, "python", "from dataclasses"), "adding-a-task.md", "exec"), code)
    spec = code["SPEC"]
    for variant in ("Shape", "All"):  # in All after the dynamics were drawn
        assert all(vary(spec, variant, seed).dynamics.block_friction_force > 1.5 for seed in range(6))
    assert vary(spec, "Colour", 0).dynamics.block_friction_force == 1.5


@pytest.fixture
def outside(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(example("outside")), *sys.path])


@pytest.mark.usefixtures("outside")
@pytest.mark.parametrize("name", ["RED_LEFT", "VISIT_STAR", "PAIR_UP", "HUDDLE"])
def test_plans_lead_to_the_full_score_in_every_variant(name: str) -> None:
    task = f"outside:{name}"
    spec, noise = task_spec(task), Noise(np.random.default_rng(0), 1.0)
    assert spec.score(spec.demo, spec.demo, "paper") == 0
    for _, variant in environments(task, "all"):
        for seed in range(4):
            scene = magical_mj.sample_scene(task, variant, seed)
            after = scene_after(scene, spec.subgoals((scene, scene), noise))
            assert spec.score(scene, after, "paper") == 1
            assert spec.subgoals((scene, after), noise) == ()


@pytest.mark.usefixtures("outside")
@pytest.mark.parametrize(("name", "shape", "colour"), [("RED_LEFT", None, "red"), ("VISIT_STAR", "star", None)])
def test_names_that_count_are_never_exchanged(name: str, shape: str | None, colour: str | None) -> None:
    """The scene of every seed has exactly one block of that name, and no scene without it is accepted."""
    task = f"outside:{name}"
    for seed in range(10):
        blocks = magical_mj.sample_scene(task, "All", seed).blocks
        assert sum(block.shape == shape or block.colour == colour for block in blocks) == 1
    spec = task_spec(task)
    others = [block for block in spec.demo.blocks if block.shape != shape and block.colour != colour]
    with pytest.raises(InvalidSceneError, match="1 "):
        spec.check(magical_mj.Scene(spec.demo.robot, tuple(others)))


# Scores of whole episodes

ORDER = "in_order:SPEC"


class Again:
    """A policy that takes the actions of a demonstration."""

    def __init__(self, actions: list[int]) -> None:
        self.actions = actions

    def reset(self, _: Episode) -> None:
        self.left = iter(self.actions)

    def __call__(self, _: Any) -> int:
        return next(self.left, 0)


@pytest.fixture
def in_order(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module of the example."""
    monkeypatch.setattr(sys, "path", [str(example("in_order.py").parent), *sys.path])
    monkeypatch.delitem(sys.modules, "in_order", raising=False)
    yield importlib.import_module("in_order")
    sys.modules.pop("in_order", None)


def test_a_trajectory_is_scored_by_hand(in_order: Any) -> None:
    start = in_order.SPEC.demo
    red, green, blue = (start.moved(robot=(*region.centre, 0.0)) for region in start.regions)
    for scenes, score in (
        ([start], 0),
        ([start, red, green, blue], 1),
        ([start, red, green, blue, start], 1),
        ([start, blue, green, red], 1 / 3),
        ([start, green, red, red, green], 2 / 3),
    ):
        assert magical_mj.score_trajectory(ORDER, scenes) == pytest.approx(score)
    untouched = replace(FIND_DUPE, name="Untouched", trajectory=True, plan=None, score=lambda scenes, rules: float(
        all(scene.blocks[0] == scenes[0].blocks[0] for scene in scenes)
    ))  # fmt: skip
    there = untouched.demo
    away = there.moved(blocks=[(0.0, 0.0, 0.0), *(block.pose for block in there.blocks[1:])])
    assert untouched.checked_score((there, there), "paper") == 1
    assert untouched.checked_score((there, away, there), "paper") == 0


def test_a_trajectory_is_scored_alike_in_every_interface(in_order: Any) -> None:
    engine, twin = (magical_mj.Engine(ORDER, "Layout", seed=3) for _ in range(2))
    name, settings = env_id(ORDER, "Layout", "State"), {"score_every_step": True}
    single = gymnasium.make(name, **settings)
    vectors = [gymnasium.make_vec(name, 2, kind, **settings) for kind in ("sync", "vector_entry_point")]
    composer = magical_mj.load(ORDER, "Layout", seed=3, observations=["state"], reward="score")
    for env in (single, *vectors):
        env.reset(seed=3)
    composer.reset()
    expert, scores, timestep = magical_mj.experts.Expert(engine, ORDER, seed=0), [], None
    while not engine.over:
        action = expert()
        scores.append(engine.score())
        engine.step(action)
        *_, info = single.step(action)
        infos = [envs.step(np.array([action, 0]))[-1] for envs in vectors]
        timestep = composer.step(action)
        if engine.steps == 60:  # a state that a copy of the episode goes on from
            for other in (twin, single.unwrapped, composer, pickle.loads(pickle.dumps(single.unwrapped))):
                other.set_state(engine.get_state())
            assert single.unwrapped.clone().score() == engine.clone().score() == composer.clone().score() > 0
        if engine.steps > 60:
            twin.step(action)
            assert twin.get_state() == engine.get_state()
        assert engine.score() == magical_mj.score_trajectory(ORDER, engine.scored_scenes)
        assert {engine.score()} == {info["score"], *(each["score"][0] for each in infos), composer.score()}
    assert single.unwrapped.get_state() == composer.get_state() == vectors[1].call("get_state")[0]
    assert sorted(set(scores)) == pytest.approx([0, 1 / 3, 2 / 3, 1])
    assert timestep is not None
    assert info["eval_score"] == timestep.reward == twin.score() == 1.0
    for env in (single, *vectors):
        env.close()


def test_its_demonstrations_and_evaluations_are_played_again(in_order: Any) -> None:
    demo = magical_mj.demos.demonstrate(ORDER, "Demo", 0)
    assert (demo.score, demo.rescored(), demo.rescored(0)) == (1.0, 1.0, 0.0)
    assert magical_mj.demos.verify(demo).good
    for env in (gymnasium.make(env_id(ORDER, "Demo", "State")), magical_mj.make_vec(ORDER, 1, preset="State")):
        (result,) = rollouts(env, Again(demo.actions.tolist()), [Episode(ORDER, "Demo", demo.scene_seed)])
        assert result.score == 1.0
        env.close()
    check_replays(result)


def check_replays(result: EpisodeResult) -> None:
    """The result is confirmed, by other rules too; with its actions in the reverse order it is not."""
    for rules in (None, "released"):
        ((_, again, difference),) = replay([("", result)], rules=rules, jobs=1, trusted=[ORDER])
        assert (again.score, difference) == (1.0, None)
    ((_, _, difference),) = replay([("", replace(result, actions=result.actions[::-1]))], jobs=1, trusted=[ORDER])
    assert difference is not None
    assert "the score is 1, but its actions lead to" in difference


def test_calls_without_the_trajectory_name_the_task(in_order: Any) -> None:
    scene = in_order.SPEC.demo
    with pytest.raises(SettingsError, match=r"InOrder|in_order.*score_trajectory"):
        magical_mj.score(ORDER, scene, scene)
    with pytest.raises(SettingsError, match="a list or a tuple of scenes"):
        magical_mj.score_trajectory(ORDER, [])
    plain = magical_mj.load_scene(scene, observations=["state"])
    plain.reset()
    plain.step(1)
    state = plain.get_state()
    engine = magical_mj.Engine(ORDER, scene=scene)
    kept = engine.get_state()
    composer = magical_mj.load(ORDER, scene=scene, observations=["state"])
    composer.reset()
    single = magical_mj.MagicalEnv(ORDER, preset="State")
    single.reset(options={"scene": scene})
    refusals = (
        lambda: engine.set_state(state),
        lambda: composer.set_state(state),
        lambda: single.set_state(state),
        lambda: single.reset(options={"state": state}),
        lambda: engine.set_state(replace(kept, steps=1)),
    )
    for refused in refusals:
        with pytest.raises(StateError, match="lacks the scenes of earlier steps, and the score of in_order:SPEC"):
            refused()
    assert engine.get_state() == composer.get_state() == single.get_state() == kept
    with pytest.raises(SettingsError, match="use an engine of this task"):
        magical_mj.experts.Expert(magical_mj.Engine.of_scene(scene), ORDER)
    wrong = replace(FIND_DUPE, name="Wrong", trajectory=True)  # whose score takes two scenes
    with pytest.raises(TaskError, match=r"Wrong\.score failed"):
        wrong.checked_score((FIND_DUPE.demo, FIND_DUPE.demo), "paper")
    with pytest.raises(TaskError, match=r"Wrong\.trajectory must be a bool"):
        replace(FIND_DUPE, name="Wrong", trajectory=1)
