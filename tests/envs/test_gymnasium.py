"""The Gymnasium environments: checkers, ids, presets, seeding, errors, and scores when a wrapper ends episodes."""

from __future__ import annotations

import dataclasses
import json
import pickle
import re
import subprocess
import sys
import warnings
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

import magical_mj
from magical_mj.envs.presets import PRESETS
from magical_mj.evaluation import Episode, rollouts
from magical_mj.observations import SEGMENTATIONS, VIEWS
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import (
    EvaluationError,
    InvalidActionError,
    InvalidSceneError,
    InvalidSeedError,
    SettingsError,
    StateError,
    UnknownNameError,
)
from magical_mj.wrappers import ScoreAtTheEnd

IDS = [magical_mj.env_id(*pair, preset) for pair in magical_mj.ENVIRONMENTS for preset in PRESETS]
PRESET_IDS = [magical_mj.env_id("FindDupe", "All", preset) for preset in PRESETS]


CHECKED = [(magical_mj.env_id(task), "") for task in magical_mj.TASKS]
CHECKED += [(magical_mj.env_id("FindDupe", "All", preset), "camera:3,sensor:3,latency:2,words:5") for preset in PRESETS]


@pytest.mark.parametrize(("name", "shifts"), CHECKED)
def test_gymnasium_checker_has_no_complaint(name: str, shifts: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(name, render_mode="rgb_array", shifts=shifts)
        check_env(env.unwrapped)
        env.close()


def test_stable_baselines_checker_has_no_complaint() -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(gymnasium.make("magical_mj/FindDupe-Demo-LoResCHW4E-v0").unwrapped)


def test_ids_round_trip() -> None:
    for name in IDS:
        spec = gymnasium.spec(name)
        assert EnvSpec.from_json(spec.to_json()) == spec, name
        assert pickle.loads(pickle.dumps(spec)) == spec, name


def registered() -> set[str]:
    """The registered ids, but for those with x-magical's bodies."""
    own = (name for name in gymnasium.registry if name.startswith("magical_mj/"))
    return {name for name in own if "-Allo-" not in name and "-Ego-" not in name}


def test_ids_are_the_60_with_every_preset() -> None:
    ours = {id_ for id_ in registered() if gymnasium.spec(id_).kwargs["task"] in magical_mj.TASKS}  # not other tests'
    assert ours == set(IDS)
    assert len(ours) == 60 * len(PRESETS)
    assert "magical_mj/FindDupe-TestShape-LoRes4E-v0" in ours
    magical_mj.envs.registration.register_all()  # a second call changes nothing
    assert registered() >= ours


def test_module_import_prefix_works_in_a_bare_process() -> None:
    program = (
        "import gymnasium; env = gymnasium.make('magical_mj:magical_mj/MoveToRegion-Demo-State-v0'); "
        "print(env.reset(seed=0)[0].shape[0] > 100)"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "True"


SHAPES = {
    "": {"ego": (384, 384, 3), "allo": (384, 384, 3)},
    "LoRes4E": (96, 96, 12),
    "LoRes4A": (96, 96, 12),
    "LoRes3EA": (96, 96, 12),
    "LoResStack": {"ego": (96, 96, 12), "allo": (96, 96, 12)},
    "LoResFingers": {"ego": (96, 96, 3), "allo": (96, 96, 3)},
    "LoResCHW4E": (12, 96, 96),
    "LoResSeg4E": (96, 96, 4),
    "LoResSeg4A": (96, 96, 4),
}


def stacked(preset: str, frames_so_far: list[dict[str, np.ndarray]]) -> np.ndarray | dict[str, np.ndarray]:
    """The expected content of each preset, independent of the package's definition."""
    ego, allo = ([frame[view] for frame in frames_so_far] for view in ("ego", "allo"))
    if preset in ("", "LoResFingers"):
        return {"ego": ego[-1], "allo": allo[-1]}
    if preset == "LoResStack":
        return {"ego": np.concatenate(ego[-4:], axis=2), "allo": np.concatenate(allo[-4:], axis=2)}
    if "Seg" in preset:
        view = "ego-segmentation" if preset == "LoResSeg4E" else "allo-segmentation"
        return np.stack([frame[view] for frame in frames_so_far[-4:]], axis=2)
    frames = {"LoRes4A": allo[-4:], "LoRes3EA": [allo[-1], *ego[-3:]]}.get(preset, ego[-4:])
    picture = np.concatenate(frames, axis=2)
    return picture.transpose(2, 0, 1) if preset == "LoResCHW4E" else picture


@pytest.mark.parametrize("preset", SHAPES)
def test_frames_are_stacked_oldest_first(preset: str) -> None:
    """Compares stacks with the frames that an engine draws."""
    env = gymnasium.make(magical_mj.env_id("MatchRegions", "Demo", preset))
    engine, size = magical_mj.Engine("MatchRegions", seed=0), 384 if preset == "" else 96

    def drawn() -> dict[str, np.ndarray]:
        return {view: engine.render(view, size) for view in (*VIEWS, *SEGMENTATIONS)}

    frames_so_far = [drawn()]
    observation, _ = env.reset(seed=0)
    for action in (1, 4, 4, 10, 13, 0):
        expected = stacked(preset, [frames_so_far[0]] * 3 + frames_so_far)
        if isinstance(expected, dict):
            for view, picture in expected.items():
                np.testing.assert_array_equal(observation[view], picture)
                assert picture.shape == SHAPES[preset][view]
        else:
            np.testing.assert_array_equal(observation, expected)
            assert expected.shape == SHAPES[preset]
        observation = env.step(action)[0]
        engine.step(action)
        frames_so_far.append(drawn())


def test_fingers_are_those_of_the_scene() -> None:
    env = gymnasium.make("magical_mj/FixColour-Demo-LoResFingers-v0").unwrapped
    observation, _ = env.reset(seed=0)
    for action in (0, 9, 9, 9, 0):
        np.testing.assert_allclose(observation["fingers"], env.scene.robot.fingers, atol=1e-6)
        open_by = float(np.ptp(observation["fingers"]))
        observation = env.step(action)[0]
        assert env.observation_space.contains(observation)
    assert open_by < np.ptp(observation["fingers"])  # first closed, now opening
    env.close()


def test_fingers_are_seen_in_scenes_that_the_state_vector_cannot_hold() -> None:
    scene = magical_mj.sample_scene("ClusterColour", "Demo", 0)
    spread = [
        replace(scene.blocks[place % len(scene.blocks)], x=-0.75 + 0.3 * (place % 6), y=0.75 - 0.3 * (place // 6))
        for place in range(12)
    ]
    env = gymnasium.make("magical_mj/ClusterColour-Demo-LoResFingers-v0").unwrapped
    observation, _ = env.reset(
        options={"scene": replace(scene, robot=magical_mj.Robot(0, -0.5, 0), blocks=tuple(spread))}
    )
    np.testing.assert_allclose(observation["fingers"], env.scene.robot.fingers, atol=1e-6)


@pytest.mark.parametrize("task", magical_mj.TASKS)
def test_episodes_are_truncated_at_the_horizon(task: str) -> None:
    env = gymnasium.make(magical_mj.env_id(task, "Demo", "State"))
    _, info = env.reset(seed=0)
    keys = info.keys()
    assert (info["eval_score"], info["is_success"]) == (0.0, False)
    horizon = task_spec(task).horizon()
    initial = env.unwrapped.scene
    for step in range(1, horizon + 1):
        _, reward, terminated, truncated, info = env.step(1)
        assert (terminated, truncated) == (False, step == horizon)
        assert type(truncated) is bool
        assert type(reward) is float
        assert reward == 0.0
        assert info.keys() == keys
        if step < horizon:
            assert info["eval_score"] == 0.0
    assert env.unwrapped.initial_scene == magical_mj.sample_scene(task, "Demo", 0)
    assert info["eval_score"] == env.unwrapped.score() == magical_mj.score(task, initial, env.unwrapped.scene)
    with pytest.raises(ResetNeeded, match="reset"):
        env.step(1)


def test_seeds_and_options_pin_the_scene() -> None:
    env = gymnasium.make("magical_mj/FindDupe-TestAll-State-v0").unwrapped
    for seed in (7, 2**70):
        env.reset(seed=seed)
        assert env.scene.digest() == magical_mj.sample_scene("FindDupe", "All", seed).digest()

    def scenes_after_seven() -> list[magical_mj.Scene]:
        env.reset(seed=7)
        env.step(1)
        return [env.unwrapped.scene for _ in range(2) if env.reset()]

    scenes = scenes_after_seven()
    assert scenes[0] != scenes[1]
    assert scenes_after_seven() == scenes  # the seed determines the episodes of later resets without a seed
    wanted = magical_mj.sample_scene("FindDupe", "Shape", 3)
    for scene in (wanted, wanted.to_json()):
        env.reset(options={"scene": scene})
        assert env.scene.digest() == wanted.digest()


def test_bad_input_is_explained() -> None:
    with pytest.raises(UnknownNameError, match="LoRes4E"):
        gymnasium.make("magical_mj/FindDupe-Demo-v0", preset="LoRes5E")
    with pytest.raises(ValueError, match="image_size"):
        gymnasium.make("magical_mj/FindDupe-Demo-v0", image_size=0)
    env = gymnasium.make("magical_mj/FindDupe-Demo-State-v0").unwrapped
    with pytest.raises(ResetNeeded):
        env.step(0)
    with pytest.raises(InvalidSceneError, match="JSON"):
        env.reset(options={"scene": "{not json"})
    with pytest.raises(InvalidSceneError, match=r"not a magical_mj\.Scene"):
        env.reset(options={"scene": 3})
    env.reset(seed=0)
    with pytest.raises(InvalidActionError):
        env.step(18)


CLUSTER = "magical_mj/ClusterShape-Demo-State-v0"  # the initial scene scores 0.25


def played(env: gymnasium.Env[Any, Any], most: int = 400) -> list[tuple[float, bool, dict[str, Any]]]:
    """Reward, truncation and info of each step of an episode without motion."""
    env.reset(seed=0)
    steps = []
    for _ in range(most):
        _, reward, terminated, truncated, info = env.step(0)
        assert not terminated
        steps.append((float(reward), truncated, info))
        if truncated:
            break
    return steps


@pytest.mark.parametrize("rules", ["paper", "released"])
@pytest.mark.parametrize("task", magical_mj.TASKS)
def test_the_spec_names_the_horizon(task: str, rules: Any) -> None:
    name = magical_mj.env_id(task, "Demo", "State")
    horizon = task_spec(task).horizon(rules)
    env = gymnasium.make(name, rules=rules)
    assert env.spec.max_episode_steps == horizon
    assert gymnasium.spec(name).max_episode_steps == task_spec(task).horizon()
    again = gymnasium.make(env.spec)
    assert again.spec == env.spec
    assert [truncated for _, truncated, _ in played(again)] == [False] * (horizon - 1) + [True]


@pytest.mark.parametrize("limit", [1, 10, 320, -1, None])
def test_the_score_is_right_wherever_the_episode_ends(limit: int | None) -> None:
    for reward, last_reward in (("none", 0.0), ("score", 0.25)):
        env = gymnasium.make(CLUSTER, max_episode_steps=limit, reward=reward)
        steps = played(env)
        assert len(steps) == (limit if limit in (1, 10) else 320) == env.spec.max_episode_steps
        assert [step[0] for step in steps] == [0.0] * (len(steps) - 1) + [last_reward]
        assert [float(info["eval_score"]) for *_, info in steps] == [0.0] * (len(steps) - 1) + [0.25]
        assert not any(info["is_success"] for *_, info in steps)


def test_limits_beyond_the_horizon_are_refused() -> None:
    with pytest.raises(SettingsError, match="max_episode_steps=1000 is more than the 320 steps"):
        gymnasium.make(CLUSTER, max_episode_steps=1000)
    with pytest.raises(SettingsError, match="more than the 240 steps"):
        gymnasium.make(CLUSTER, max_episode_steps=300, rules="released")
    for wrong in (0, 1.5, "a"):
        with pytest.raises(SettingsError, match="integer of at least 1"):
            magical_mj.MagicalEnv("ClusterShape", limit=wrong)


def test_the_score_behind_wrappers_of_ones_own() -> None:
    env = ScoreAtTheEnd(wrappers.TimeLimit(gymnasium.make(CLUSTER), 7))
    steps = played(env)
    assert [float(info["eval_score"]) for *_, info in steps] == [0.0] * 6 + [0.25]
    vector = gymnasium.make_vec(CLUSTER, num_envs=2, max_episode_steps=5)
    vector.reset(seed=0)
    infos = [vector.step(np.zeros(2, int))[-1] for _ in range(5)]
    assert [info["eval_score"].tolist() for info in infos] == [[0.0, 0.0]] * 4 + [[0.25, 0.25]]


class Impatient(gymnasium.Wrapper[Any, Any, Any, Any]):
    """A user's wrapper that ends episodes after seven steps."""

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        *step, truncated, info = super().step(action)
        return *step, truncated or self.get_wrapper_attr("engine").steps == 7, info  # type: ignore[return-value]


def test_rewards_that_were_paid_and_changed_by_wrappers_stay() -> None:
    """Ten times the score if the environment ends the episode, the score itself if another wrapper does."""
    for end, steps, paid in (
        (lambda env: env, 320, 2.5),
        (lambda env: wrappers.TimeLimit(env, 7), 7, 2.5),
        (Impatient, 7, 0.25),
    ):
        tenfold = wrappers.TransformReward(gymnasium.make(CLUSTER, reward="score"), lambda reward: 10 * float(reward))
        played_steps = played(ScoreAtTheEnd(end(tenfold)))
        assert len(played_steps) == steps
        assert (played_steps[-1][0], played_steps[-1][2]["eval_score"]) == (paid, 0.25)


def test_episodes_without_a_score_cause_one_warning() -> None:
    """The environment cannot see the wrapper. The reset after the third such episode warns."""
    region = "magical_mj/MoveToRegion-Demo-State-v0"
    cut, scored = (
        wrappers.TimeLimit(gymnasium.make(region), 39),
        ScoreAtTheEnd(wrappers.TimeLimit(gymnasium.make(region), 39)),
    )
    own = gymnasium.make(region, max_episode_steps=39)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        for env in (scored, own, gymnasium.make(region), cut):
            for _ in range(5):
                info = played(env)[-1][2]
                messages = [str(warning.message) for warning in warned]
                assert info["eval_score"] == (0.0 if env is cut else env.unwrapped.score())
            assert bool(messages) == (env is cut)
    assert len(warned) == 1
    assert (
        "reset after 39 of 40 steps. If a wrapper such as TimeLimit ends them, their eval_score is 0.0" in messages[0]
    )
    for length, episodes in ((20, 3), (3, 14), (1, 40)):  # at least three, with 40 steps together
        env = wrappers.TimeLimit(gymnasium.make(region), length)
        for _ in range(episodes):
            played(env)
        with pytest.warns(UserWarning, match=rf"the last {episodes} episodes were reset after {length} of 40 steps"):
            env.reset()
    for step in (30, 30, 30, 30):  # as a tree search does, from states
        own.reset(seed=0)
        state = own.unwrapped.get_state()
        for _ in range(step):
            own.step(1)
        own.reset(options={"state": state})


def test_evaluations_refuse_wrappers_that_end_episodes() -> None:
    single = wrappers.TimeLimit(gymnasium.make("magical_mj/MoveToRegion-Demo-State-v0"), 30)
    vector = gymnasium.vector.SyncVectorEnv([lambda: single])
    for env in (single, vector):
        with pytest.raises(EvaluationError, match="a wrapper ended the episode after 30 of 40 steps"):
            list(rollouts(env, lambda _: 1, [Episode("MoveToRegion", "Demo", 0)]))
    for kind in ("sync", "vector_entry_point"):
        env = gymnasium.make_vec("magical_mj/MoveToRegion-Demo-State-v0", 2, kind, max_episode_steps=30)
        (result,) = rollouts(env, lambda _: 1, [Episode("MoveToRegion", "Demo", 0)])
        assert result.steps == 30
        env.close()


def test_other_packages_environments_have_no_score() -> None:
    with pytest.raises(SettingsError, match="wraps only environments of magical_mj"):
        ScoreAtTheEnd(gymnasium.make("CartPole-v1"))


def test_the_score_at_every_step() -> None:
    env = gymnasium.make("magical_mj/MoveToRegion-Demo-State-v0", score_every_step=True)
    _, info = env.reset(seed=0)
    assert info["score"] == 0.0
    for step in range(40):
        info = env.step(1)[-1]
        assert info["score"] == env.unwrapped.score()
        assert info["eval_score"] == (info["score"] if step == 39 else 0.0)
    assert info["is_success"] == (info["score"] == 1.0)


def test_infos_have_types_that_other_libraries_read() -> None:
    """TorchRL reads the score's `dtype`; LeRobot needs arrays of bools from vector environments; loggers write JSON."""
    env = gymnasium.make("magical_mj/MoveToRegion-Demo-State-v0", score_every_step=True, instruction=True)
    for info in (env.reset(seed=0)[1], env.step(0)[-1]):
        assert info["eval_score"].dtype == np.float64
        assert json.loads(json.dumps(info)) == info
    vector = gymnasium.make_vec("magical_mj/MoveToRegion-Demo-State-v0", num_envs=2)
    infos = vector.reset(seed=0)[1]
    assert [infos[name].dtype for name in ("eval_score", "is_success")] == [np.float64, np.bool_]


def test_unknown_options_are_ignored_with_a_warning() -> None:
    env = gymnasium.make("magical_mj/FindDupe-TestAll-State-v0").unwrapped
    with pytest.warns(
        UserWarning, match=re.escape("""the options 'other', 'task_id'; known options: "scene" and "state\"""")
    ):
        env.reset(seed=3, options={"other": 3, "task_id": 1})
    assert env.scene.digest() == magical_mj.sample_scene("FindDupe", "All", 3).digest()
    for wrong in ("scene", 3, ["scene"]):
        with pytest.raises(SettingsError, match="options must be a dict"):
            env.reset(options=wrong)
    env.reset(options={})


def test_a_reset_after_a_seeded_one_starts_in_the_same_scene() -> None:
    """Only without a step in between. So `set_seed(7)` starts in the scene of seed 7 if a library resets twice."""
    env = gymnasium.make("magical_mj/FindDupe-TestAll-State-v0").unwrapped
    wanted = magical_mj.sample_scene("FindDupe", "All", 7)
    env.reset(seed=7)
    env.reset()
    assert env.initial_scene == wanted
    env.reset()
    assert env.initial_scene != wanted
    env.reset(seed=7)
    env.step(0)
    env.reset()
    assert env.initial_scene != wanted


@pytest.mark.parametrize("size", [1, 40, 385])
def test_rendered_views(size: int) -> None:
    pictures = {}
    for view in ("ego", "allo", "both"):
        env = gymnasium.make(
            "magical_mj/FixColour-Demo-State-v0", render_mode="rgb_array", render_view=view, render_size=size
        )
        env.reset(seed=0)
        pictures[view] = env.render()
        first = env.unwrapped.engine.render("ego" if view == "both" else view, size)
        np.testing.assert_array_equal(pictures[view][:, :size], first)
    assert pictures["both"].shape == (size, 2 * size, 3)
    np.testing.assert_array_equal(pictures["both"], np.hstack([pictures["ego"], pictures["allo"]]))


def test_unknown_views_and_sizes_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="ego, allo, scene, both"):
        gymnasium.make(CLUSTER, render_view="top")
    with pytest.raises(SettingsError, match=r"render_size must be an integer in 1\.\."):
        gymnasium.make(CLUSTER, render_size=0)


def _pictures(observation: Any) -> list[np.ndarray]:
    return list(observation.values()) if isinstance(observation, dict) else [observation]


@pytest.mark.parametrize("preset", ["", "LoRes4E", "LoRes3EA", "LoResStack", "LoResCHW4E", "State"])
def test_writing_into_an_observation_changes_no_later_one(preset: str) -> None:
    env, twin = (gymnasium.make(magical_mj.env_id("FindDupe", "All", preset), image_size=16) for _ in range(2))
    observation, untouched = env.reset(seed=0)[0], twin.reset(seed=0)[0]
    for action in (1, 4, 10, 1):
        for picture in _pictures(observation):
            picture[:] = 0
        observation, untouched = env.step(action)[0], twin.step(action)[0]
        for spoilt, expected in zip(_pictures(observation), _pictures(untouched), strict=True):
            np.testing.assert_array_equal(spoilt, expected)


def test_a_reset_that_is_refused_changes_nothing() -> None:
    env, twin = (magical_mj.MagicalEnv("MoveToRegion", "Layout", "State") for _ in range(2))
    env.reset(seed=1)
    while not env.step(0)[3]:
        pass
    ended = env.get_state()
    for each in (env, twin):
        each.reset(seed=2)
        each.step(1)
    before = env.get_state()
    refused: list[tuple[dict[str, Any], type[Exception]]] = [
        ({"options": {"state": ended}}, StateError),
        ({"seed": -1}, InvalidSeedError),
        ({"seed": True}, InvalidSeedError),
        ({"seed": 5, "options": {"scene": "no scene"}}, InvalidSceneError),
        ({"seed": 5, "options": {"state": 3}}, StateError),
    ]
    for arguments, error in refused:
        with pytest.raises(error):
            env.reset(**arguments)
        assert env.get_state() == before
    for each in (env, twin):
        each.reset()
    assert env.scene == twin.scene
    with pytest.raises(StateError):
        env.set_state(dataclasses.replace(ended, steps=3, simulation=np.full_like(ended.simulation, np.nan)))
    with pytest.raises(ResetNeeded):  # the damaged state has ended the episode
        env.step(0)
