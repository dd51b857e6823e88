"""The Gymnasium environments: checkers, ids, presets, vector environments, seeding and errors."""

from __future__ import annotations

import pickle
import subprocess
import sys
import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

import magical_mj
from magical_mj.envs.presets import PRESETS
from magical_mj.scene.state_vector import SEGMENTATIONS, VIEWS
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import InvalidActionError, InvalidSceneError, UnknownNameError

IDS = [magical_mj.env_id(*pair, preset) for pair in magical_mj.ENVIRONMENTS for preset in PRESETS]
PRESET_IDS = [magical_mj.env_id("FindDupe", "All", preset) for preset in PRESETS]


@pytest.mark.parametrize("name", [magical_mj.env_id(task) for task in magical_mj.TASKS] + PRESET_IDS)
def test_gymnasium_checker_has_no_complaint(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(name, render_mode="rgb_array")
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


def test_ids_are_the_60_with_every_preset() -> None:
    ours = {name for name in gymnasium.registry if name.startswith("magical_mj/") and "/xmagical/" not in name}
    assert ours == set(IDS)
    assert len(ours) == 60 * len(PRESETS)
    assert "magical_mj/FindDupe-TestShape-LoRes4E-v0" in ours
    magical_mj.envs.registration.register_all()  # once more changes nothing
    assert {name for name in gymnasium.registry if name.startswith("magical_mj/") and "/xmagical/" not in name} == ours


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
    """What a preset should give, said in another way than the package does."""
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
    """Against the single frames that an engine draws."""
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
    assert open_by < np.ptp(observation["fingers"])  # closed, then opening
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
    assert info == {"eval_score": 0.0, "is_success": False}
    horizon = task_spec(task).horizon()
    initial = env.unwrapped.scene
    for step in range(1, horizon + 1):
        _, reward, terminated, truncated, info = env.step(1)
        assert (terminated, truncated) == (False, step == horizon)
        assert type(truncated) is bool
        assert type(reward) is float
        assert reward == 0.0
        assert set(info) == {"eval_score", "is_success"}
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
    assert scenes_after_seven() == scenes  # the unseeded episodes follow from the seed
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
    with pytest.raises(InvalidSceneError, match="scene"):
        env.reset(options={"scene": 3})
    env.reset(seed=0)
    with pytest.raises(InvalidActionError):
        env.step(18)
