"""The environments in stable-worldmodel's `World`: `make integrations-test LIBRARY=stable-worldmodel` runs this."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from PIL import Image

import magical_mj
from magical_mj.actions import to_vector
from magical_mj.experts import GoalPicture
from magical_mj.utils.errors import InvalidSeedError, MissingExtraError, SettingsError, StateError, UnknownNameError

MISSING = "stable_worldmodel is missing: make integrations-test LIBRARY=stable-worldmodel"
needs_library = pytest.mark.skipif(find_spec("stable_worldmodel") is None, reason=MISSING)
pytestmark = pytest.mark.filterwarnings("default")  # the library's own are not ours to mend
TASK = "MatchRegions"


@pytest.mark.skipif(find_spec("stable_worldmodel") is not None, reason="stable-worldmodel is installed")
def test_without_stable_worldmodel_one_line_says_what_to_install() -> None:
    with pytest.raises(MissingExtraError, match="pip install stable-worldmodel"):
        import_module("magical_mj.integrations.world_model")


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Makes a `World` of one environment of ours with two copies."""
    monkeypatch.setenv("MAGICAL_MJ_RENDERER", "software")
    from stable_worldmodel import World

    from magical_mj.integrations.world_model import WorldEnv

    def made(task: str = TASK, variant: str = "Demo", *wrappers: Any, count: int = 2, **settings: Any) -> Any:
        settings = {"max_episode_steps": None, "action": "continuous", "image_shape": (64, 64), **settings}
        wrapped = [*wrappers, WorldEnv]
        return World(magical_mj.env_id(task, variant, "State"), count, pre_wrappers=wrapped, **settings)

    return made


def repeating(actions: dict[int, list[int]]) -> Any:
    """A policy that takes these actions: the scene's seed -> actions."""
    from stable_worldmodel.policy import BasePolicy

    class Repeating(BasePolicy):
        def get_action(self, obs: Any, **kwargs: Any) -> np.ndarray:
            steps = np.stack([obs["scene_seed"].ravel(), obs["steps"].ravel()], axis=1).astype(int).tolist()
            taken = [actions[seed][step] if step < len(actions[seed]) else 0 for seed, step in steps]
            return np.stack([to_vector(action) for action in taken])

    return Repeating()


@needs_library
def test_variations_are_ours_and_their_values_are_those_of_the_episode(world: Callable[..., Any]) -> None:
    from magical_mj.integrations.world_model import _nested

    one = world()
    with closing(one), closing(magical_mj.MagicalEnv(TASK, "Demo", "State")) as env:
        for names in (["camera"], ["camera.zoom", "slip"], ["scene"], ["all"]):
            one.reset(seed=5, options={"variation": names})
            observation, _ = env.reset(seed=6, options={"variation": names})  # of the second copy
            np.testing.assert_array_equal(one.infos["observation"][1, 0], observation)
            space = one.envs.variation_space
            shown = space.names() if names == ["all"] else names
            assert {f"variation.{name}" for name in shown} <= one.infos.keys()
            values = one.envs.envs[1].unwrapped.variation_space.value
            np.testing.assert_equal(values, env.variation)
        robot = np.array([0.3, 0.2, 1.0])
        for names, zoom in (([], 0.0), (["slip", "camera"], 0.2)):
            given = {"variation": names, "variation_values": {"scene.robot": robot, "camera.zoom": zoom}}
            one.reset(seed=5, options=given)
            drawn = env.variation_space.draw(names, 6) if names else {}
            env.reset(seed=6, options={"variation": _nested(drawn, given["variation_values"])})
            base = one.envs.envs[1].unwrapped.env.unwrapped
            assert base.scene.robot.pose == pytest.approx(robot)
            assert base.engine.draws == env.engine.draws
            assert base.engine.draws.get("camera", {}).get("zoom", 0.0) == zoom


@needs_library
def test_a_recording_of_experts_is_read_back_and_continued(
    world: Callable[..., Any], tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    """The frames, scores and goals are ours, and recorded episodes go on from any step; Lance stores float32."""
    from stable_worldmodel.data import LanceDataset

    shown = {seed: magical_mj.demos.demonstrate(TASK, "Jitter", seed).actions for seed in (3, 4)}
    actions = {seed: [*numbers, *[0] * 120][:120] for seed, numbers in shown.items()}
    recorder = world(TASK, "Jitter", GoalPicture)
    recorder.set_policy(repeating(actions))
    recorder.collect(tmp_path / "set.lance", episodes=2, seed=3, progress=False)
    assert recorder.evaluate(episodes=2, seed=3)["success_rate"] == 100.0
    data = LanceDataset(str(tmp_path / "set.lance"))
    frames = data.load_episode(1)
    with closing(gymnasium.make(f"magical_mj/{TASK}-TestJitter-State-v0", render_mode="rgb_array")) as env:
        goal = GoalPicture(env).reset(seed=4)[1]["goal"]
        for number, action in enumerate(actions[4]):
            observation, _, _, _, info = env.step(action)
            np.testing.assert_array_equal(np.asarray(frames["observation"][number]), observation)
            if number in (0, 60, 119):
                picture = Image.fromarray(env.render()).resize((64, 64), Image.Resampling.BILINEAR)
                kept = np.asarray(frames["pixels"][number]).transpose(1, 2, 0)
                assert np.abs(kept.astype(float) - np.asarray(picture)).mean() < 3.0  # Lance stores JPEG
        resized = Image.fromarray(goal).resize((64, 64), Image.Resampling.BILINEAR)
        recorder.reset(seed=3)
        np.testing.assert_array_equal(recorder.infos["goal"][1, 0], np.asarray(resized))
        assert float(np.asarray(frames["eval_score"][-1]).item()) == info["eval_score"] == 1.0
        final = observation
    values = {name: {"value": name} for name in ("scene_seed", "steps", "simulation")}
    callables = [{"method": "restore", "args": values}]
    places = {"dataset": data, "episodes_idx": [0, 1], "start_steps": [50, 70], "goal_offset": 20}
    continued = recorder.evaluate(**places, eval_budget=120, callables=callables)
    assert continued["success_rate"] == 100.0
    record_property("compared", "recorded experts in MatchRegions' Jitter, continued from steps 50 and 70")
    record_property("result", "1.00, the experts' score")
    np.testing.assert_allclose(recorder.infos["observation"][1, 0], final, atol=1e-3)
    recorder.close()


@needs_library
def test_success_is_the_full_score_at_the_horizon(world: Callable[..., Any]) -> None:
    idle = world("MoveToRegion", "Demo")
    idle.set_policy(repeating({seed: [0] * 40 for seed in range(4)}))
    assert idle.evaluate(episodes=3, seed=0)["success_rate"] == 0.0
    idle.close()
    counts = world(TASK, "CountPlus")  # with other numbers of blocks in each episode
    counts.set_policy(repeating({seed: [0] * 120 for seed in range(6)}))
    counts.evaluate(episodes=5, seed=0)
    counts.close()


@needs_library
def test_wrong_inputs_of_worlds_are_explained(world: Callable[..., Any]) -> None:
    from magical_mj.integrations.world_model import WorldEnv

    with pytest.raises(SettingsError, match="WorldEnv needs an environment of magical_mj"):
        WorldEnv(gymnasium.make("CartPole-v1"))
    with pytest.raises(SettingsError, match="max_episode_steps=100 is more than the 40 steps"):
        world("MoveToRegion", max_episode_steps=100)
    one = world()
    with pytest.raises(UnknownNameError, match=r"unknown factor 'camera\.zom'"):
        one.reset(options={"variation": ["camera.zom"]})
    with pytest.raises(UnknownNameError, match="unknown key of a variation 'camra'"):
        one.reset(options={"variation_values": {"camra.zoom": 0.1}})
    with pytest.raises(SettingsError, match="variation_space: camera"):
        one.reset(options={"variation_values": {"camera.zoom": 100.0}})
    with pytest.raises(SettingsError, match="must be a dict such as"):
        one.reset(options={"variation_values": ["camera"]})
    one.reset(seed=0)
    other = WorldEnv(magical_mj.MagicalEnv("MoveToRegion"))
    with pytest.raises(StateError, match="not a state of the scene of seed 0"):
        other.restore(0, 3, one.infos["simulation"][0, 0])
    other.reset(options={"scene": magical_mj.sample_scene("MoveToRegion", "Demo", 0)})
    with pytest.raises(InvalidSeedError):
        other.restore(**{name: other.step(0)[4][name] for name in ("scene_seed", "steps", "simulation")})
    one.close()
