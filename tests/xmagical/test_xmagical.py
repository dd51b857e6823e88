"""The suite xmagical: ids, spaces, rewards, original seeds, and deviations from measurements of the original."""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import xmagical as measured  # type: ignore[import-not-found] - tools/research/xmagical.py
from gymnasium.utils.env_checker import check_env

import magical_mj
from magical_mj.cli.film import in_words
from magical_mj.demos.archive import to_npz
from magical_mj.exports.folders import to_xirl
from magical_mj.exports.robomimic import to_robomimic
from magical_mj.scene.bodies import BODIES, Body, body_named
from magical_mj.scene.geometry import check_scene
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import (
    DemonstrationError,
    InvalidActionError,
    InvalidSceneError,
    InvalidSeedError,
    MagicalError,
    SettingsError,
    UntrustedNameError,
)
from magical_mj.xmagical.envs import XMagicalEnv
from magical_mj.xmagical.sweep_to_top import DEMO, original_scene, state_vector
from tests.helpers.commands import Shell

IDS = sorted(name for name in gymnasium.registry if name.startswith("magical_mj/SweepToTop-"))
LONG = "magical_mj/SweepToTop-Longstick-State-Allo-TestLayout-v0"
PROBES: dict[str, Any] = json.loads(measured.PROBES.read_text())
BODY_NAMES = tuple(BODIES)


def test_there_are_96_ids_and_all_pass_gymnasiums_checker() -> None:
    assert len(IDS) == 96
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(render|alternative namespace).*")
        for id_ in IDS:
            small = {} if "State" in id_ else {"image_size": 24}
            env = gymnasium.make(id_, renderer="software", **small)
            check_env(env.unwrapped, skip_render_check=True)
            observation, _ = env.reset(seed=3)
            assert observation in env.observation_space
            assert env.spec is not None
            assert env.spec.max_episode_steps == (50 if "Longstick" in id_ else 100)
            env.close()


def test_an_episode_is_truncated_and_every_step_is_rewarded_by_the_score() -> None:
    env = gymnasium.make(LONG.replace("TestLayout", "Demo"))
    env.reset(seed=0)
    forward, rewards = np.array([1.0, 0.0], np.float32), []
    for step in range(50):
        _, reward, terminated, truncated, info = env.step(forward)
        rewards.append(float(reward))
        assert not terminated
        assert truncated == (step == 49)
        assert info["eval_score"] == (1.0 if truncated else 0.0)
        assert reward == info["in_zone"].mean()
    assert sum(rewards) == 37  # the original's
    assert rewards.index(1.0) == 13


@pytest.mark.parametrize("body", BODY_NAMES)
def test_motion_rest_and_pushes_are_those_of_the_original(body: str) -> None:
    robot: list[Any] = [measured.turn_rates(PROBES, body), measured.resting(body), *measured.free_motion(PROBES, body)]
    debris, _ = measured.pushes(PROBES, body)
    for deviation in (*robot, debris, *measured.sequences(PROBES, body)):
        assert deviation.position <= deviation.bounds[0], deviation
        assert deviation.angle <= deviation.bounds[1], deviation


def test_scores_rewards_draws_and_states_are_those_of_the_original() -> None:
    assert max(measured.scores(PROBES)) < 1e-6
    assert measured.drawn(PROBES) == 0
    for name, static in PROBES["static"].items():
        np.testing.assert_allclose(state_vector(measured.start(name.lower()).scene), static["state"], atol=1e-6)


def test_original_seeds_draw_on_from_reset_to_reset() -> None:
    env = XMagicalEnv("longstick", "Layout", seeds="original")
    rng = np.random.RandomState(5)
    for seed in (5, None, None):
        env.reset(seed=seed)
        assert env.initial_scene == original_scene("Layout", rng, "longstick")
    state = env.get_state()
    env.step([0.5, 0.01])
    env.set_state(state)
    assert env.get_state() == state


def test_dense_reward_and_the_released_bounds() -> None:
    env = XMagicalEnv("shortstick", reward="dense", rules="released")
    env.reset(seed=0)
    assert env.step([0.0, 0.0])[1] == -1.0
    assert env.observation_space.high.max() == 1.0  # type: ignore[attr-defined]


def test_worlds_on_all_cores_step_as_single_ones() -> None:
    envs = gymnasium.make_vec(LONG, num_envs=3, vectorization_mode="vector_entry_point")
    single = gymnasium.make(LONG)
    observations, _ = envs.reset(seed=7)
    alone, _ = single.reset(seed=8)
    np.testing.assert_array_equal(observations[1], alone)
    actions = np.array([[0.3, 0.01], [0.8, -0.05], [-0.5, 1.0]], np.float32)
    for _ in range(3):
        observations, rewards, *_ = envs.step(actions)
        alone, reward, *_ = single.step(actions[1])
        np.testing.assert_array_equal(observations[1], alone)
        assert rewards[1] == reward


@pytest.mark.parametrize("action", [[0.1, 0.2, 0.3], [np.nan, 0.0], 1.5, None, "forward", [[0.1, 0.2]]])
def test_actions_of_a_wrong_kind_are_refused(action: Any) -> None:
    env = XMagicalEnv("mediumstick")
    env.reset(seed=0)
    with pytest.raises(InvalidActionError, match="2 finite numbers"):
        env.step(action)


@pytest.mark.parametrize("seed", [-1, 2**32, 1.5])
def test_seeds_that_the_original_cannot_have_are_refused(seed: Any) -> None:
    env = XMagicalEnv(seeds="original")
    with pytest.raises(InvalidSeedError, match="seeds"):
        env.reset(seed=seed)


def test_commands_that_cannot_store_speeds_refuse_the_expert() -> None:
    with pytest.raises(MagicalError, match="acts by speeds"):
        magical_mj.evaluate("expert", tasks="SweepToTop", variants="Demo", episodes=1)


def test_every_body_starts_in_legal_scenes_of_every_environment() -> None:
    """Where the demo's poses leave no room for a longer body, it starts in the same pose nearby for all seeds."""
    for task, variant in magical_mj.ENVIRONMENTS:
        for body in BODIES:
            scenes = [magical_mj.sample_scene(task, variant, seed, body=body) for seed in range(2)]
            for scene in scenes:
                check_scene(scene)
            demo = task_spec(task).demo
            if variant in ("Demo", "Colour", "Shape", "Dynamics"):
                assert scenes[0].robot == scenes[1].robot
                assert math.dist(scenes[0].robot.pose[:2], demo.robot.pose[:2]) < (0.7 if body == "longstick" else 0.01)
                assert [block.pose for block in scenes[0].blocks] == [block.pose for block in demo.blocks]


@pytest.mark.parametrize(
    ("task", "body", "variant"), [("MatchRegions", "longstick", "Demo"), ("ClusterShape", "gripper", "All")]
)
def test_all_tasks_have_ids_with_bodies_whose_actions_are_speeds(task: str, body: str, variant: str) -> None:
    test = "Demo" if variant == "Demo" else f"Test{variant}"
    name = f"magical_mj/{task}-{body.capitalize()}-State-Allo-{test}-v0"
    env, dense = gymnasium.make(name), gymnasium.make(name, reward="dense")
    check_env(env.unwrapped, skip_render_check=True)
    envs = gymnasium.make_vec(name, num_envs=2, vectorization_mode="vector_entry_point")
    observation, _ = env.reset(seed=4)
    dense.reset(seed=4)
    np.testing.assert_array_equal(envs.reset(seed=3)[0][1], observation)
    scene = magical_mj.sample_scene(task, variant, 4, body)
    assert env.unwrapped.initial_scene == scene  # type: ignore[attr-defined]
    engine = magical_mj.Engine(task, variant, scene=scene, body=body, speeds=True)
    action = np.array([0.4, 0.01, 0.2][: 3 if body == "gripper" else 2], np.float32)
    for _ in range(20):
        left = engine.remaining()
        engine.step(action)
        observation, reward, *_ = env.step(action)
        assert reward == engine.score()  # at every step, as x-magical's
        assert dense.step(action)[1] == pytest.approx(left - engine.remaining())
    np.testing.assert_array_equal(observation, engine.state_vector())
    pixels = gymnasium.make(name.replace("State-Allo", "Pixels-Ego"), image_size=48, renderer="software")
    assert pixels.reset(seed=4)[0].shape == (48, 48, 3)


@pytest.mark.parametrize(
    "wrong", [{"body": "gripper"}, {"task": "FindDupe"}, {"variant": "All"}, {"shifts": "body:gripper"}]
)
def test_arguments_that_contradict_the_id_are_refused(wrong: dict[str, str]) -> None:
    id_, said = "magical_mj/MatchRegions-Longstick-State-Allo-Demo-v0", f"has {next(iter(wrong))}=|has body='longstick'"
    with pytest.raises(SettingsError, match=said):
        gymnasium.make(id_, **wrong)
    with pytest.raises(SettingsError, match=said):
        gymnasium.make_vec(id_, 1, "sync", **wrong)
    with pytest.raises(SettingsError, match=f"{said}|more than the 100 steps of an episode of FindDupe"):
        gymnasium.make_vec(id_, 1, "vector_entry_point", **wrong)
    with pytest.raises(
        SettingsError, match="has preset='State', and not 'LoRes4E': take the id of another environment"
    ):
        gymnasium.make("magical_mj/MatchRegions-Demo-State-v0", preset="LoRes4E")
    with pytest.raises(SettingsError, match="has body='longstick', and not 'gripper'"):
        magical_mj.make_vec(id_, 1, body="gripper")
    with pytest.raises(SettingsError, match="has variant='Demo', and not 'All'"):
        magical_mj.make_vec("magical_mj/MatchRegions-Demo-State-v0", 1, variant="All")
    gymnasium.make("magical_mj/MatchRegions-Demo-v0", preset="State", body="longstick", action="speeds").close()


def test_speeds_are_actions_of_any_environment_without_shifts_of_actions() -> None:
    env = gymnasium.make("magical_mj/MatchRegions-Demo-State-v0", body="longstick", action="speeds", shifts="camera:1")
    env.reset(seed=0)
    before = env.unwrapped.scene.robot  # type: ignore[attr-defined]
    for _ in range(8):
        env.step(np.array([0.1, 0.0], np.float32))  # slower than any of the 18
    after = env.unwrapped.scene.robot  # type: ignore[attr-defined]
    assert math.dist(before.pose[:2], after.pose[:2]) == pytest.approx(0.1, abs=0.02)
    with pytest.raises(SettingsError, match="'latency' changes the 18 actions"):
        gymnasium.make("magical_mj/MatchRegions-Demo-State-v0", action="speeds", shifts="latency:1")


def test_videos_words_and_archives_take_speeds(tmp_path: Path) -> None:
    (demo, *_) = magical_mj.demos.load("SweepToTop", body="longstick")
    assert demo.acts.shape == demo.actions.shape[:1]
    assert in_words(np.array([0.5, -0.1])) == "speed 0.50, turn -0.10"
    to_npz([demo], tmp_path / "one.npz", preset="State")
    with np.load(tmp_path / "one.npz") as archive:
        assert archive["actions"].shape == (np.count_nonzero(demo.acts), 2)
    (other, *_) = magical_mj.demos.load("SweepToTop")
    with pytest.raises(DemonstrationError, match="several bodies"):
        to_npz([demo, other], tmp_path / "both.npz", preset="State")
    with pytest.raises(DemonstrationError, match="speeds"):
        to_robomimic([demo], tmp_path / "one.hdf5")


def test_bodies_that_the_expert_cannot_use_are_refused_where_it_acts(shell: Shell) -> None:
    engine = magical_mj.Engine("FindDupe", body="longstick", seed=0)
    engine.step(1)
    message = "the expert cannot solve FindDupe with the body 'longstick'.* use gripper, shortstick"
    for refused in (
        lambda: magical_mj.demos.demonstrate("FindDupe", "Demo", 0, body="longstick"),
        lambda: magical_mj.demos.load("FindDupe", body="longstick"),
        lambda: magical_mj.experts.Expert(engine, "FindDupe"),
        lambda: magical_mj.evaluate("expert", tasks="FindDupe", variants="Demo", episodes=1, body="longstick"),
        lambda: magical_mj.evaluate("expert", tasks="FindDupe", variants="Demo", episodes=1, shifts="body:longstick"),
    ):
        with pytest.raises(SettingsError, match=message):
            refused()
    assert "the expert cannot solve FindDupe with" in shell.fails(
        2, "demos", "generate", "--tasks", "FindDupe", "--body", "longstick", "--out", "made"
    )
    frame = magical_mj.evaluate("noop", tasks="FindDupe", variants="Demo", episodes=1, body="longstick", jobs=1)
    assert frame["score"].item() == 0.0
    with pytest.raises(InvalidSceneError, match="gripper, shortstick"):
        magical_mj.Engine("SweepToTop", body="snake")
    engine = magical_mj.Engine("SweepToTop", body="shortstick", seed=0)
    with pytest.raises(InvalidSceneError, match="make another environment with body='gripper'"):
        engine.reset(scene=DEMO)


WEDGE = Body(((0.05, 0.2), (-0.05, 0.2), (-0.2, -0.1), (0.2, -0.1)), inertia=0.01)


def test_a_body_of_ones_own_pushes_and_scenes_from_files_import_nothing() -> None:
    name = f"{__name__}:WEDGE"
    text = DEMO.to_json().replace('"fingers"', '"body":"thieves.tools:BODY","fingers"')
    with pytest.raises(UntrustedNameError):
        magical_mj.Scene.from_json(text)
    engine = magical_mj.Engine("SweepToTop", body=name, seed=0)
    assert body_named(name) is WEDGE
    for _ in range(15):
        engine.step([1.0, 0.0])
    assert engine.scene.blocks[1].y > 0.3
    assert engine.render("allo", 48).shape == (48, 48, 3)
    for outline in (
        ((0.0, 0.2), (0.2, -0.1), (-0.2, -0.1)),
        ((0.0, 0.2), (0.0, 0.1)),
        ((0, 0), (1, 0), (0.2, 0.1), (0, 1)),
        ((1, 1, 0), (-1, 1, 0), (-1, -1, 0), (1, -1, 0)),
        ((1, 1), (-1,), (-1, -1), (1, -1)),
    ):
        with pytest.raises(InvalidSceneError, match="convex polygon"):
            Body(outline)  # type: ignore[arg-type]


@pytest.mark.parametrize("body", BODY_NAMES)
def test_scenes_with_bodies_survive_json_export_and_both_doors(body: str, tmp_path: Path) -> None:
    scene = magical_mj.sample_scene("SweepToTop", "All", 3, body)
    assert magical_mj.Scene.from_json(scene.to_json()) == scene
    engine = magical_mj.Engine("SweepToTop", "All", scene=scene, body=body)
    from magical_mj.engine.export import export_mjcf

    export_mjcf(engine, tmp_path / "model.xml")
    for action in ([0.8, 0.0], [0.5, 0.03], [-0.8, -1.0]):
        engine.step([*action, 1.0][: 3 if body == "gripper" else 2])
    assert math.isfinite(engine.scene.robot.x)


def test_learners_refuse_other_bodies_and_speeds() -> None:
    torch = pytest.importorskip("torch")
    del torch
    from magical_mj.learners.config import load_settings
    from magical_mj.learners.data import _episode

    demo = magical_mj.demos.load("SweepToTop", body="longstick")[0]
    with pytest.raises(SettingsError, match="are speeds"):
        load_settings("bc", "SweepToTop")
    with pytest.raises(DemonstrationError, match="by the body 'longstick'"):
        _episode("SweepToTop", demo, load_settings("bc", "FindDupe"), False)


def test_xirl_reads_folders_by_split_body_and_video(tmp_path: Path) -> None:
    demos = magical_mj.demos.load("SweepToTop", body="longstick")[:2]
    to_xirl(demos, tmp_path / "out")
    frames = sorted(path.relative_to(tmp_path / "out").parts for path in tmp_path.rglob("*.png"))
    assert {parts[:3] for parts in frames} == {(split, "longstick", "0") for split in ("train", "valid")}
    assert len(frames) == sum(len(demo.qpos) for demo in demos)
    with pytest.raises(DemonstrationError, match="one demonstration by the longstick"):
        to_xirl(demos[:1], tmp_path / "other")


def test_demonstrations_of_a_body_play_again_to_the_same_states() -> None:
    demo = magical_mj.demos.demonstrate("SweepToTop", "Layout", 4, body="longstick")
    assert demo.score == 1.0
    assert magical_mj.demos.verify(demo).exact
    observations, actions = magical_mj.demos.transitions([demo], "State")
    assert observations.shape == (len(actions), 16)  # type: ignore[union-attr]
    assert actions.shape[1] == 2


@pytest.mark.parametrize("seeds", ["protocol", "original"])
def test_variations_of_its_scenes_are_given_and_read_back(seeds: str) -> None:
    """Its zone extends beyond the walls, and has a solid border."""
    env = XMagicalEnv("longstick", "Layout", seeds=seeds)  # type: ignore[arg-type]
    space = env.variation_space
    env.reset(options={"variation": space.default})
    assert env.scene.blocks == magical_mj.sample_scene("SweepToTop", "Demo", 0, "longstick").blocks
    env.reset(seed=3)
    scene, variation = env.initial_scene, env.variation
    assert variation in space
    env.reset(options={"variation": ["scene"]})
    assert env.initial_scene != scene
    env.reset(seed=4, options={"variation": variation})
    assert env.initial_scene == scene
    assert {region.border for region in scene.regions} == {"solid"}
    for wrong in ("variation", 3):
        with pytest.raises(SettingsError, match="options must be a dict"):
            env.reset(options=wrong)  # type: ignore[arg-type]
    env.close()
