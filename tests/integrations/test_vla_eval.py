"""vla-eval: the environments as its benchmark, played through its model servers."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

import magical_mj
from magical_mj.actions import to_vector
from magical_mj.shifts import SHIFTS
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import (
    InvalidActionError,
    InvalidSceneError,
    MissingExtraError,
    SettingsError,
    UnknownNameError,
)
from tests.shifts import test_received as received

pytestmark = pytest.mark.filterwarnings("default")  # theirs are not ours to mend


@pytest.fixture
def benchmark() -> Any:
    pytest.importorskip("vla_eval", reason="vla_eval is missing: make integrations-test LIBRARY=vla-eval")
    return import_module("magical_mj.integrations.vla_eval").MagicalBenchmark


@pytest.mark.skipif(find_spec("vla_eval") is not None, reason="vla-eval is installed")
def test_without_vla_eval_one_line_says_what_to_install() -> None:
    with pytest.raises(MissingExtraError, match="pip install vla-eval"):
        import_module("magical_mj.integrations.vla_eval")


def test_vla_eval_plays_the_official_scenes(benchmark: Any, record_property: Callable[[str, object], None]) -> None:
    """A model server that answers with the expert's actions has the full score; one seed off, it would not."""
    import vla_eval
    from vla_eval.model_servers.predict import PredictModelServer

    expert = {seed: magical_mj.demos.demonstrate("FixColour", "Layout", seed).actions for seed in (0, 1)}

    class Server(PredictModelServer):
        async def on_episode_start(self, config: Any, ctx: Any) -> None:
            await super().on_episode_start(config, ctx)
            self.seed = config["task"]["episode_idx"]

        def predict(self, obs: Any, ctx: Any) -> Any:
            assert obs["images"]["ego"].shape == (96, 96, 3)
            assert obs["task_description"]
            return {"actions": to_vector(expert[self.seed][ctx.step])}

        def get_action_spec(self) -> Any:
            return benchmark("FixColour").get_action_spec()

        def get_observation_spec(self) -> Any:
            return benchmark("FixColour").get_observation_spec()

    config = {
        "benchmarks": [
            {
                "benchmark": "magical_mj.integrations.vla_eval:MagicalBenchmark",
                "episodes_per_task": 2,
                "params": {"tasks": "FixColour", "variants": "Layout"},
            }
        ]
    }
    (result,) = vla_eval.evaluate(Server(), config, docker=False, no_save=True)
    assert [task["task"] for task in result["tasks"]] == ["FixColour-Layout"]
    assert [episode["steps"] for episode in result["tasks"][0]["episodes"]] == [60, 60]
    assert (result["mean_score"], result["mean_success"]) == (1.0, 1.0)
    record_property("compared", "a model server with the expert's actions, in FixColour's Layout")
    record_property("result", f"{result['mean_score']:.2f}, the expert's score")


@pytest.mark.parametrize("axis", SHIFTS)
def test_shifts_reach_vla_eval(axis: str, benchmark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAGICAL_MJ_RENDERER", "software")
    made = benchmark(received.TASK, views="ego,allo", shifts=f"{axis}:5")
    task = {"task": received.TASK, "variant": "Demo", "episode_idx": received.SEED}
    pictures, sentences, seen = [], set(), made.reset(task)
    for action in received.ACTIONS:
        observation = made.make_obs(seen, task)
        pictures.append(received.newest(observation["images"]))
        sentences.add(observation["task_description"])
        seen = made.step({"actions": to_vector(action)}).obs
    made.cleanup()
    assert (pictures, sentences) == received.by_engine(f"{axis}:5")


def test_bodies_in_vla_eval(benchmark: Any) -> None:
    made = benchmark("MoveToRegion", body="shortstick")
    made.reset({"task": "MoveToRegion", "variant": "Demo", "episode_idx": 0})
    assert made._env.scene.robot.body == "shortstick"
    made.cleanup()
    with pytest.raises(InvalidSceneError, match="unknown body 'snake'"):
        benchmark("MoveToRegion", body="snake")
    with pytest.raises(SettingsError, match="MoveToCorner cannot have the shift 'pose'"):
        benchmark("MoveToCorner", shifts="pose:1")


def test_vla_eval_plays_the_same_scenes_without_the_shifts(benchmark: Any) -> None:
    made = benchmark("FixColour", "Layout", shifts="clutter:3,words:5", control=True)
    tasks = made.get_tasks()
    assert [task["name"] for task in tasks] == ["FixColour-Layout", "FixColour-Layout-unshifted"]
    assert len({task["suite"] for task in tasks}) == 2
    scenes, sentences = [], []
    for task in tasks:
        observation = made.make_obs(made.reset({**task, "episode_idx": 4}), task)
        sentences.append(observation["task_description"])
        scenes.append(made._env.initial_scene)
    assert scenes[0] == magical_mj.Engine("FixColour", "Layout", seed=4, shifts="clutter:3,words:5").initial_scene
    assert scenes[1] == magical_mj.sample_scene("FixColour", "Layout", 4) != scenes[0]
    assert sentences[1] == task_spec("FixColour").instruction != sentences[0]
    made.cleanup()
    with pytest.raises(SettingsError, match="a control is played without the shifts: give shifts"):
        benchmark("FixColour", control=True)


def test_vla_eval_delivers_the_sentences_of_intents(benchmark: Any) -> None:
    intent = magical_mj.intents.parse("in(colour=red, region) & untouched(others)")
    made = benchmark(f"intent:{intent}", "Layout")
    (task,) = made.get_tasks()
    observation = made.make_obs(made.reset({**task, "episode_idx": 2}), task)
    assert observation["task_description"] == intent.sentence
    assert made.get_metadata()["max_steps"] == made._env.horizon
    made.cleanup()


def test_vla_eval_gives_demonstrations_and_another_sentence(benchmark: Any) -> None:
    made = benchmark("intent:dev/2", "Layout", demonstrations=1, wrong_instruction=True)
    (task,) = made.get_tasks()
    assert task["suite"] == "dev"
    started = made.make_obs(made.reset({**task, "episode_idx": 0}), task)
    (shown,) = started["demonstrations"]
    steps, size = len(shown["actions"]), started["images"]["ego"].shape
    assert shown["images"]["ego"].shape == (steps, *size)
    assert started["task_description"] not in ("", made._env.instruction)
    later = made.make_obs(made.step({"actions": shown["actions"][0]}).obs, task)
    assert "demonstrations" not in later
    assert later["task_description"] == started["task_description"]
    made.cleanup()


def test_vla_eval_wrong_inputs(benchmark: Any) -> None:
    with pytest.raises(UnknownNameError, match="FixColour"):
        benchmark("FixColor")
    with pytest.raises(UnknownNameError, match="allo"):
        benchmark("FixColour", views="wrist")
    made = benchmark("FixColour")
    with pytest.raises(ResetNeeded):
        made.step({"actions": np.zeros(3)})
    made.reset({"task": "FixColour", "variant": "Demo", "episode_idx": 0})
    for last in (np.array([1.0, 1.0, -1.0]), np.array([[1.0, 1.0, -1.0]])):  # models also answer with a batch of one
        assert made.get_hold_action({"actions": last})["actions"].tolist() == [0.0, 0.0, -1.0]
    assert made.get_hold_action(None)["actions"].tolist() == [0.0, 0.0, 0.0]
    for wrong in (np.array([0, np.nan, 0]), np.zeros(7), np.zeros((8, 3))):
        with pytest.raises(InvalidActionError, match="three finite numbers"):
            made.step({"actions": wrong})
    made.cleanup()
