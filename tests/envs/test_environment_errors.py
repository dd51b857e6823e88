"""What the dm_env environments refuse, and the clear errors for it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from dm_control.rl.control import PhysicsError
from gymnasium.error import ResetNeeded

import magical_mj
from magical_mj.scene import Block, Robot, Scene
from magical_mj.scene.actions import Action, Drive, Gripper, Turn
from magical_mj.utils.errors import (
    ClosedError,
    InvalidActionError,
    InvalidSceneError,
    SettingsError,
    StateError,
    UnknownNameError,
)


@pytest.mark.parametrize("action", [18, -1, 1.5, None, "1", np.array([1]), np.float64(2), True])
def test_bad_actions_are_refused_and_harmless(action: object) -> None:
    env = magical_mj.load("MoveToRegion", observations=())
    env.reset()
    before = env.scene
    with pytest.raises(InvalidActionError, match=r"integers 0\.\.17"):
        env.step(action)
    assert env.scene == before


@pytest.mark.parametrize("action", [np.int64(4), np.array(4), Action(Gripper.OPEN, Turn.LEFT, Drive.FORWARD)])
def test_actions_of_every_integer_kind(action: object) -> None:
    env, twin = (magical_mj.load("MoveToRegion", observations=()) for _ in range(2))
    for one, what in ((env, action), (twin, 4)):
        one.reset()
        one.step(what)
    assert env.scene == twin.scene


def test_bad_arguments_name_the_remedy() -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'FindDupe'"):
        magical_mj.load("FindDup")
    with pytest.raises(UnknownNameError, match="Did you mean 'Layout'"):
        magical_mj.load("FindDupe", "Layot")
    with pytest.raises(UnknownNameError, match="Jitter"):
        magical_mj.load("MoveToCorner", "Layout")
    with pytest.raises(UnknownNameError, match="ego"):
        magical_mj.load("FindDupe", observations=("egg",))
    for given in ("ego", "state", None, 3):
        with pytest.raises(SettingsError, match="a list or a tuple of names"):
            magical_mj.load("FindDupe", observations=given)
    with pytest.raises(UnknownNameError, match="released"):
        magical_mj.load("FindDupe", rules="old")
    with pytest.raises(UnknownNameError, match="score"):
        magical_mj.load("FindDupe", reward="dense")
    for size in (0, -3, 1.5, 10**6):
        with pytest.raises(ValueError, match="image_size"):
            magical_mj.load("FindDupe", image_size=size)
    for seed in (-1, 1.5, "7", -(10**5000)):
        with pytest.raises(ValueError, match="seed"):
            magical_mj.load("FindDupe", seed=seed)


def test_illegal_scenes_are_refused() -> None:
    demo = magical_mj.sample_scene("FindDupe", "Demo", 0)
    outside = demo.moved(robot=(1.5, 0, 0))
    overlapping = demo.moved(robot=demo.blocks[0].pose)
    for scene, message in ((outside, "walls"), (overlapping, "overlap")):
        with pytest.raises(InvalidSceneError, match=message):
            magical_mj.load("FindDupe", scene=scene)
        with pytest.raises(InvalidSceneError, match=message):
            magical_mj.load_scene(scene)
    with pytest.raises(InvalidSceneError):
        magical_mj.load("FindDupe", scene=magical_mj.sample_scene("MakeLine", "Demo", 0))
    crowd = Scene(Robot(0, 0, 0), tuple(Block("circle", "red", 0.8, -0.9 + 0.25 * k, 0) for k in range(7)))
    crowd = Scene(crowd.robot, crowd.blocks + tuple(Block("circle", "red", -0.8, b.y, 0) for b in crowd.blocks))
    with pytest.raises(InvalidSceneError, match="holds 10 blocks"):
        magical_mj.load_scene(crowd, observations=("state",))
    magical_mj.load_scene(crowd, observations=()).reset()


def test_what_is_no_name_is_no_name() -> None:
    for wrong in (["FindDupe"], None, 3, {"FindDupe"}, np.array(["a", "b"])):
        with pytest.raises(UnknownNameError, match="unknown task"):
            magical_mj.load(wrong)
        with pytest.raises(UnknownNameError, match="unknown variant"):
            magical_mj.load("FindDupe", wrong)
        with pytest.raises(UnknownNameError, match="unknown observation"):
            magical_mj.load("FindDupe", observations=(wrong,))
        with pytest.raises(UnknownNameError, match="unknown reward"):
            magical_mj.load("FindDupe", reward=wrong)
        with pytest.raises(UnknownNameError, match="unknown set of rules"):
            magical_mj.load("FindDupe", rules=wrong)
        with pytest.raises(UnknownNameError, match="unknown preset"):
            magical_mj.MagicalEnv("FindDupe", preset=wrong)
        with pytest.raises(UnknownNameError, match="unknown view"):
            magical_mj.load("FindDupe", observations=()).render(wrong)
        with pytest.raises(InvalidSceneError, match=r"is not a magical_mj\.Scene; Scene\.from_json"):
            magical_mj.load_scene(wrong, seed=-1)


def test_closed_environments_say_so() -> None:
    env = magical_mj.load("MoveToRegion", observations=())
    env.reset()
    env.close()
    env.close()
    uses = (env.reset, lambda: env.step(0), lambda: env.scene, env.score, env.render, env.get_state, env.clone)
    uses += (lambda: env.physics, lambda: magical_mj.export_mjcf(env, "never.xml"))
    for use in uses:
        with pytest.raises(ClosedError, match="load another one"):
            use()


def test_after_a_model_that_does_not_compile_the_environment_is_closed() -> None:
    env = magical_mj.load("MoveToRegion", observations=())
    tree = env.task.root_entity.mjcf_model
    env.add_extra_hook("initialize_episode_mjcf", lambda _: tree.worldbody.add("geom", type="mesh", mesh="none"))
    env.task.next_scene = env.initial_scene  # whose tree that is
    with pytest.raises(ValueError, match="mesh 'none' not found"):
        env.reset()
    with pytest.raises(ClosedError, match="could not be compiled"):
        _ = env.scene
    env.close()


@pytest.mark.parametrize("out", [np.zeros((16, 16, 3), np.uint8), np.zeros((32, 32, 3)), [[0]], b"bytes"])
def test_pictures_are_written_to_arrays_that_fit(out: Any) -> None:
    with pytest.raises(SettingsError, match=r"out must be .*of shape \(32, 32, 3\), uint8"):
        magical_mj.load("MoveToRegion", observations=()).render(size=32, out=out)


def test_pictures_are_not_written_to_what_is_read_only() -> None:
    out = np.zeros((32, 32, 3), np.uint8)
    out.flags.writeable = False
    with pytest.raises(SettingsError, match="read-only"):
        magical_mj.load("MoveToRegion", observations=()).render(size=32, out=out)


def test_an_episode_starts_from_one_thing() -> None:
    env = magical_mj.load("MoveToRegion", observations=())
    with pytest.raises(SettingsError, match="not from seed and scene"):
        env.reset(seed=1, scene=env.initial_scene)


def test_heaps_in_which_some_bodies_sleep_are_restored_or_refused() -> None:
    """MuJoCo stops at some of them; then the world is as it was before."""
    env = magical_mj.load("ClusterShape", seed=0, observations=())
    env.reset()
    env.step(0)
    state, rng, refused = env.get_state(), np.random.default_rng(0), []
    positions, trees = env.physics.model.nq, env.physics.model.ntree
    for _ in range(300):
        heap = state.simulation.copy()
        heap[1 : 1 + positions] = rng.uniform(-0.3, 0.3, positions)  # after the time
        heap[-trees:] = np.where(rng.random(trees) < 0.5, np.arange(trees), -1)
        before = env.get_state()
        try:
            env.set_state(replace(state, simulation=heap))
        except StateError as error:
            refused.append(str(error))
        else:
            continue
        assert env.get_state() == before
    assert 0 < len(refused) < 300
    assert all("MuJoCo cannot continue from it" in problem for problem in refused)


def test_an_unstable_simulation_can_be_left() -> None:
    env = magical_mj.load("ClusterShape", seed=0, observations=())
    env.reset()
    env.step(4)
    state = env.get_state()
    env.physics.data.qvel[:] = 1e30
    with pytest.raises(PhysicsError):
        env.step(4)
    env.set_state(state)
    assert env.get_state() == state
    assert env.step(4).mid()


@pytest.mark.parametrize("hooked", [False, True])
def test_an_unstable_simulation_ends_the_episode(hooked: bool) -> None:
    env: Any = gymnasium.make("magical_mj/ClusterShape-Demo-State-v0").unwrapped
    if hooked:
        env.dm_env.add_extra_hook("before_substep", lambda *_: None)
    env.reset(seed=0)
    env.step(4)
    env.dm_env.physics.data.qvel[:] = 1e30
    with pytest.raises(PhysicsError):
        env.step(4)
    with pytest.raises(ResetNeeded):
        env.step(4)
    assert env.dm_env.step(4).first()
