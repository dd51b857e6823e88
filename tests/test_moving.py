"""Every line of the tables in docs/moving.md is run: each has a function here, by its first column."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from stable_baselines3 import PPO

import magical_mj
from magical_mj import demos
from magical_mj.assets.robot import speed_signal
from magical_mj.cli import main
from magical_mj.exports.folders import to_xirl
from magical_mj.scene import Scene
from magical_mj.utils.errors import SettingsError, UnknownNameError
from magical_mj.xmagical.sweep_to_top import DEMO, original_scene, state_vector
from tests.demos.test_original import episode, packed

PAGE = (Path(__file__).parents[1] / "docs" / "moving.md").read_text("utf-8")
SWEEP = "magical_mj/SweepToTop-Longstick-State-Allo-TestLayout-v0"
REGION = "magical_mj/MoveToRegion-Demo-State-v0"
PICTURES = "magical_mj/MoveToRegion-Demo-LoRes4E-v0"


def rows(origin: str) -> list[str]:
    """The first column of the table of an origin, without Markdown's quotes."""
    table = PAGE.partition(f"\n## From {origin}\n")[2].partition("\n## ")[0]
    cells = re.findall(r"^\| (.*?) \| .* \|$", table, re.MULTILINE)
    return [cell.replace("`", "") for cell in cells if cell != "---"][1:]


def made(name: str, **settings: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(name, renderer="software", **settings)


def old(name: str, **settings: Any) -> Any:
    """The environment of an old argument, which warns."""
    ours = "image_size" if "res_hw" in settings else "reward"
    with pytest.warns(FutureWarning, match=f"is deprecated: give {ours}="):
        return made(name, **settings).unwrapped


def whole(env: gymnasium.Env[Any, Any], action: Any = 1) -> tuple[float, dict[str, Any], int]:
    """The return, the last info and the number of steps of an episode in which nothing is terminated."""
    env.reset(seed=7)
    total, steps, over = 0.0, 0, False
    info: dict[str, Any] = {}
    while not over:
        _, reward, terminated, over, info = env.step(action)
        assert not terminated
        total, steps = total + float(reward), steps + 1
    return total, info, steps


def shape(name: str, **settings: Any) -> tuple[int, ...]:
    return np.shape(made(name, **settings).reset(seed=0)[0])


def scored(name: str, action: Any) -> None:
    env: Any = made(name).unwrapped
    env.reset(seed=0)
    env.step(action)
    with pytest.warns(FutureWarning, match=r"call score\(\)"):
        assert env.score_on_end_of_traj() == env.score()


def seeded(name: str, scene: Scene, **settings: Any) -> None:
    env: Any = made(name, **settings).unwrapped
    env.reset(seed=7)
    assert env.initial_scene == scene


def observations() -> None:
    assert shape(PICTURES) == (96, 96, 12)
    assert shape(PICTURES.replace("4E", "CHW4E")) == (12, 96, 96)
    views = made("magical_mj/MoveToRegion-Demo-v0").reset(seed=0)[0]
    assert {view: (part.shape, part.dtype) for view, part in views.items()} == dict.fromkeys(
        ("ego", "allo"), ((384, 384, 3), np.uint8)
    )
    assert made(REGION).action_space == gymnasium.spaces.Discrete(18)


def imported(out: Path) -> None:
    demo = demos.load("MoveToRegion")[0]
    path = packed(out / "demo-a.pkl.gz", episode("MoveToRegion", demo.actions, score=1.0))
    assert demos.from_original(path).score == demos.from_original(path).demonstration.score == 1.0
    assert main(["demos", "import", str(path), "--out", str(out / "in")]) == 0


def exported(out: Path, *arguments: str) -> None:
    main(["demos", "export", *arguments, "--out", str(out / "set")])
    assert (out / "set").exists()


def xirl(out: Path) -> None:
    demos_of_body = demos.load("SweepToTop", body="longstick", set="graded")
    to_xirl(demos_of_body[:2], out / "xirl")
    assert (out / "xirl" / "train" / "longstick" / "0" / "50.png").exists()


def evaluated(out: Path) -> None:
    PPO("MlpPolicy", made(REGION), n_steps=8, batch_size=8).save(out / "model.zip")
    played: dict[str, Any] = {"tasks": "MoveToRegion", "variants": "Demo", "jobs": 1}
    assert len(magical_mj.evaluate(str(out / "model.zip"), episodes=2, **played)) == 2


def moved() -> None:
    env: Any = made(SWEEP).unwrapped
    env.reset(options={"scene": env.scene.moved(robot=(0.1, -0.7, 0.0))})
    assert env.scene.robot.pose == (0.1, -0.7, 0.0)
    env.set_state(env.get_state())


def transitions() -> None:
    env, training, _ = magical_mj.datasets.make_env_and_datasets("magical_mj/MoveToRegion-Demo-State-v0")
    assert training.keys() == {"observations", "next_observations", "actions", "terminals", "truncations"}
    assert env.observation_space.contains(training["observations"][0])


FORWARD = np.array([0.5, 0.0], np.float32)
ORIGINAL: dict[str, Callable[[Path], Any]] = {
    "import gym, magical; magical.register_envs()": lambda _: REGION in gymnasium.registry,
    "FindDupe-TestShape-LoRes4E-v0 and all other ids": lambda _: all(
        f"magical_mj/{task}-{'Demo' if variant == 'Demo' else f'Test{variant}'}{preset}-v0" in gymnasium.registry
        for task, variant in magical_mj.ENVIRONMENTS
        for preset in ("", "-LoRes4E", "-LoRes4A", "-LoRes3EA", "-LoResStack", "-LoResCHW4E")
    ),
    "env.seed(7); obs = env.reset()": lambda _: seeded(REGION, magical_mj.sample_scene("MoveToRegion", "Demo", 7)),
    "obs, reward, done, info = env.step(action)": lambda _: whole(made(REGION))[2] == 40,
    'info["eval_score"] at the last step': lambda _: {"eval_score", "is_success"} <= whole(made(REGION))[1].keys(),
    "env.score_on_end_of_traj()": lambda _: scored(REGION, 1),
    "gym.make(id, debug_reward=True)": lambda _: old(REGION, debug_reward=True).reward == "dense",
    "gym.make(id, res_hw=(128, 128))": lambda _: (
        old(PICTURES, res_hw=(128, 128)).observation_space.shape == (128, 128, 12)
    ),
    "observations, and the 18 actions": lambda _: observations(),
    "magical.EvaluationProtocol, 100 rollouts": lambda _: (
        magical_mj.evaluate("noop", tasks="MoveToRegion", variants="Demo", episodes=2, jobs=1)["seed"].tolist()
        == [0, 1]
    ),
    "magical.try_download_demos(...), magical.load_demos(paths)": lambda _: len(demos.load("FindDupe")) == 25,
    "the released demonstrations, demo-*.pkl.gz": imported,
    "python -m magical --env-name FindDupe-Demo-v0": lambda _: main(["play", "--help"]) == 0,
    'env.render(mode="human")': lambda _: made(REGION, render_mode="rgb_array").render_mode == "rgb_array",
    "Cluster* of 240 steps with the code's scores": lambda _: (
        [magical_mj.Engine("ClusterShape", seed=0, rules=rules).horizon for rules in ("paper", "released")]
        == [320, 240]
    ),
}
X_MAGICAL: dict[str, Callable[[Path], Any]] = {
    "import xmagical; xmagical.register_envs()": lambda _: SWEEP in gymnasium.registry,
    "SweepToTop-Longstick-State-Allo-TestLayout-v0 and all other ids": lambda _: (
        sum(name.startswith("magical_mj/SweepToTop-") for name in gymnasium.registry) == 96
    ),
    "gym.make(id, use_dense_reward=True)": lambda _: old(SWEEP, use_dense_reward=True).rewards == "dense",
    "gym.make(id, res_hw=(112, 112))": lambda _: (
        old(SWEEP.replace("State", "Pixels"), res_hw=(112, 112)).observation_space.shape == (112, 112, 3)
    ),
    "env.score_on_end_of_traj()": lambda _: scored(SWEEP, FORWARD),
    "env.seed(7); obs = env.reset()": lambda _: seeded(
        SWEEP, original_scene("Layout", np.random.RandomState(7), "longstick"), seeds="original"
    ),
    "actions, the state vector, pictures of 384 x 384": lambda _: (
        speed_signal(FORWARD, None, np.zeros(4))[0] == 0.5
        and [len(state_vector(DEMO)), shape(SWEEP)] == [17, (16,)]
        and shape(SWEEP.replace("State", "Pixels")) == (384, 384, 3)
    ),
    "setting poses by hand": lambda _: moved(),
    "XIRL's folders train/BODY/VIDEO/FRAME.png": xirl,
    "MatchRegions and others with these bodies": lambda _: (
        len(
            [
                name
                for name in gymnasium.registry
                if re.match(r"magical_mj/(?!Sweep)\w+-\w+-(State|Pixels)-(Allo|Ego)-", name)
            ]
        )
        == len(magical_mj.ENVIRONMENTS) * 4 * 4
    ),
}
EIRLI: dict[str, Callable[[Path], Any]] = {
    'task_name="MatchRegions-Demo-v0", magical_preproc="LoResCHW4E"': lambda _: (
        "magical_mj/MatchRegions-Demo-LoResCHW4E-v0" in gymnasium.registry
    ),
    'saved_trajectories.splice_in_preproc_name(env_name, "LoRes4E")': lambda _: (
        magical_mj.env_id("MatchRegions", "Demo", "LoRes4E") == "magical_mj/MatchRegions-Demo-LoRes4E-v0"
    ),
    "saved_trajectories.load_demos(pickle_paths)": lambda _: len(demos.load("MatchRegions")) == 25,
    'preprocess_demos_with_wrapper(trajectories, env_name, "LoRes4E")': lambda _: (
        np.shape(demos.observations(demos.load("MoveToRegion")[0], "LoRes4E")) == (41, 96, 96, 12)
    ),
    "load_data(...): obs, next_obs, acts, dones": lambda _: transitions(),
    "make_vec_env(env_name, n_envs=2, parallel=True)": lambda _: magical_mj.make_vec(REGION, 2).num_envs == 2,
    "SB3EvaluationProtocol(policy, ...).do_eval()": evaluated,
    "data sets for WebDataset": lambda out: exported(
        out, "--tasks", "MoveToRegion", "--to", "webdataset", "--preset", "State"
    ),
}
TABLES = {"the original": ORIGINAL, "x-magical": X_MAGICAL, "EIRLI": EIRLI}


@pytest.mark.parametrize("origin", TABLES)
def test_every_line_has_a_check(origin: str) -> None:
    assert rows(origin) == list(TABLES[origin])


@pytest.mark.parametrize(("origin", "row"), [(origin, row) for origin, table in TABLES.items() for row in table])
def test_a_line_holds(origin: str, row: str, tmp_path: Path) -> None:
    assert TABLES[origin][row](tmp_path) in (True, None)


def test_old_and_unknown_arguments_say_what_to_give() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # no warning without effect
        assert made(REGION, debug_reward=False, use_dense_reward=False).unwrapped.reward == "none"  # type: ignore[attr-defined]
    envs = magical_mj.make_vec
    with pytest.warns(FutureWarning, match="use_dense_reward is deprecated: give reward='dense'"):
        assert envs(REGION, 1, use_dense_reward=True).envs[0].reward == "dense"
    for name in (REGION, SWEEP, "magical_mj/MatchRegions-Longstick-State-Allo-Demo-v0"):
        with pytest.raises(
            UnknownNameError, match=r"unexpected keyword argument 'use_dense_rewrd'\. Did you mean 'reward'"
        ):
            made(name, use_dense_rewrd=True)
        with pytest.raises(SettingsError, match="use_dense_reward is the old name of reward: give only reward"):
            made(name, use_dense_reward=True, reward="dense")
    for load, first in (
        (magical_mj.load, "FindDupe"),
        (magical_mj.load_scene, magical_mj.sample_scene("FindDupe", "Demo", 0)),
    ):
        with pytest.raises(UnknownNameError, match=r"unexpected keyword argument 'rendrer'\. Did you mean 'rend"):
            load(first, rendrer="software")
    with pytest.warns(FutureWarning, match="use_dense_reward is deprecated: give reward='dense'"):
        magical_mj.load(task="FindDupe", use_dense_reward=True).close()
    for sides in ((96, 48), 96, "96"):
        with pytest.raises(SettingsError, match=r"res_hw is \(height, width\), and pictures here are square"):
            made(PICTURES, res_hw=sides)
