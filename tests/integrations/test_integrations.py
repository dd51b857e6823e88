"""TorchRL and vla-eval, by themselves, where they are installed: ``pip install torchrl vla-eval``."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
import torch
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
def gym_env() -> Any:
    return pytest.importorskip("torchrl.envs").GymEnv


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("FindDupe-TestAll-LoRes4E", {}),
        ("MoveToRegion-Demo-LoResFingers", {}),
        ("MoveToRegion-Demo-State", {"from_pixels": True, "pixels_only": False}),
        ("MoveToRegion-Demo-State", {"action": "continuous"}),
    ],
)
def test_torchrl_finds_nothing_wrong(gym_env: Any, name: str, options: dict[str, Any]) -> None:
    from torchrl.envs import check_env_specs

    env = gym_env(f"magical_mj/{name}-v0", **options)
    check_env_specs(env)
    assert ("pixels" in env.reset()) == ("from_pixels" in options)
    env.close()


def test_torchrl_seeds_are_ours_and_the_info_is_read(gym_env: Any) -> None:
    from torchrl.data import Unbounded
    from torchrl.envs import default_info_dict_reader

    env = gym_env("magical_mj/FixColour-Demo-State-v0")
    env.set_info_dict_reader(default_info_dict_reader(["eval_score"], [Unbounded((), dtype=torch.float64)]))
    env.set_seed(3)
    rollout = env.rollout(100)
    ours = magical_mj.MagicalEnv("FixColour", "Demo", "State")
    np.testing.assert_array_equal(rollout["observation"][0].numpy(), ours.reset(seed=3)[0])
    assert len(rollout) == 60
    assert bool(rollout["next", "truncated"][-1])
    assert float(rollout["next", "eval_score"][-1]) == env._env.unwrapped.score()
    env.close()
    ours.close()


@pytest.mark.slow
def test_torchrl_workers(gym_env: Any) -> None:
    env = gym_env("magical_mj:magical_mj/FixColour-Demo-State-v0", num_envs=2)
    assert env.rollout(3)["observation"].shape == (2, 3, len(magical_mj.observations.STATE_NAMES))
    env.close()


# vla-eval


@pytest.fixture
def benchmark() -> Any:
    pytest.importorskip("vla_eval")
    return import_module("magical_mj.integrations.vla_eval").MagicalBenchmark


@pytest.mark.skipif(find_spec("vla_eval") is not None, reason="vla-eval is installed")
def test_without_vla_eval_one_line_says_what_to_install() -> None:
    with pytest.raises(MissingExtraError, match="pip install vla-eval"):
        import_module("magical_mj.integrations.vla_eval")


def test_vla_eval_plays_the_official_scenes(benchmark: Any) -> None:
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
    assert observation["task_description"] == intent.sentence[0].lower() + intent.sentence[1:-1]
    assert made.get_metadata()["max_steps"] == made._env.horizon
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
    for wrong in (np.array([0, np.nan, 0]), np.zeros(7), np.zeros((8, 3))):
        with pytest.raises(InvalidActionError, match="three finite numbers"):
            made.step({"actions": wrong})
    made.cleanup()
