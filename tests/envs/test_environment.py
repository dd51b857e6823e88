"""The dm_env environments: the protocol, horizons, determinism, round trips and clear errors."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import dm_env
import numpy as np
import pytest
from absl.testing import absltest
from dm_env import test_utils

import magical_mj
from magical_mj.scene import Block, Dynamics, GoalRegion, Robot, Scene
from magical_mj.scene.actions import ACTIONS, Action, Drive
from magical_mj.scene.state_vector import STATE_NAMES
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import InvalidSceneError

PAIRS = pytest.mark.parametrize(("task", "variant"), magical_mj.ENVIRONMENTS)
FORWARD = Action(drive=Drive.FORWARD).number


def poses(scene: Scene) -> np.ndarray:
    return np.array([scene.robot.pose, *(block.pose for block in scene.blocks)])


@PAIRS
def test_dm_env_protocol(task: str, variant: str) -> None:
    """dm_env's own test cases, with an action sequence that goes past the horizon."""

    class Case(test_utils.EnvironmentTestMixin, absltest.TestCase):
        def make_object_under_test(self) -> dm_env.Environment:
            return magical_mj.load(task, variant, seed=1, observations=("ego", "state"), image_size=16)

        def make_action_sequence(self) -> Iterator[int]:
            return iter(np.arange(task_spec(task).horizon() + 5) % len(ACTIONS))

    result = absltest.unittest.TestResult()
    absltest.unittest.defaultTestLoader.loadTestsFromTestCase(Case).run(result)
    assert result.testsRun == 4
    assert not result.errors + result.failures, "\n".join(text for _, text in result.errors + result.failures)


@PAIRS
def test_scene_survives_the_simulator(task: str, variant: str) -> None:
    scene = magical_mj.sample_scene(task, variant, 5)
    env = magical_mj.load(task, variant, seed=5, observations=())
    for _ in range(2):
        env.reset(seed=5)
        now = env.scene
        np.testing.assert_allclose(poses(now), poses(scene), atol=1e-6)
        np.testing.assert_allclose(now.robot.fingers, scene.robot.fingers, atol=1e-6)
        assert now.regions == scene.regions
        assert now.dynamics == scene.dynamics
        assert [(b.shape, b.colour) for b in now.blocks] == [(b.shape, b.colour) for b in scene.blocks]
        assert env.initial_scene == scene
        env.reset(seed=6)


@PAIRS
def test_nothing_moves_when_nothing_acts(task: str, variant: str) -> None:
    env = magical_mj.load(task, variant, seed=11, observations=())
    env.reset()
    start, fingers = poses(env.scene), env.scene.robot.fingers
    for _ in range(min(100, task_spec(task).horizon() - 1)):
        env.step(0)
    assert np.abs(poses(env.scene) - start).max() < 1e-4
    assert np.abs(np.subtract(env.scene.robot.fingers, fingers)).max() < 1e-4


@pytest.mark.parametrize("task", magical_mj.TASKS)
@pytest.mark.parametrize("rules", ["paper", "released"])
def test_horizon_is_exact_over_three_episodes(task: str, rules: str) -> None:
    env = magical_mj.load(task, seed=0, observations=(), rules=rules, reward="score")
    horizon = task_spec(task).horizon(rules)
    assert env.horizon == horizon
    for _ in range(3):
        assert env.reset().first()
        for step in range(1, horizon + 1):
            now = env.step(FORWARD)
            assert now.last() == (step == horizon)
            assert now.discount == 1.0
        assert now.reward == env.score() == magical_mj.score(task, env.initial_scene, env.scene, rules=rules)


def test_reward_is_zero_by_default() -> None:
    env = magical_mj.load("MoveToRegion", seed=0, observations=())
    env.reset()
    rewards = [env.step(FORWARD).reward for _ in range(40)]
    assert rewards == [0.0] * 40


@PAIRS
def test_seeds_give_the_sampled_scenes(task: str, variant: str) -> None:
    env = magical_mj.load(task, variant, seed=7, observations=())
    env.reset()
    assert env.initial_scene == magical_mj.sample_scene(task, variant, 7)
    env.reset()
    twin = magical_mj.load(task, variant, seed=7, observations=())
    twin.reset()
    twin.reset()
    assert env.initial_scene == twin.initial_scene
    env.reset(seed=2**80)
    assert env.initial_scene == magical_mj.sample_scene(task, variant, 2**80)


DIGEST_PROGRAM = """
import hashlib, numpy, magical_mj
digest = hashlib.sha256()
for task, variant in [("FindDupe", "All"), ("ClusterShape", "CountPlus"), ("MoveToCorner", "Jitter")]:
    env = magical_mj.load(task, variant, seed=3, observations=("ego", "allo", "state"), reward="score")
    now = env.reset()
    for action in numpy.random.default_rng(0).integers(18, size=env.horizon):
        now = env.step(action)
        for name, value in now.observation.items():
            digest.update(name.encode() + value.tobytes())
    digest.update(repr((now.reward, env.scene)).encode())
print(digest.hexdigest())
"""


def test_processes_agree_bit_for_bit() -> None:
    """Same seed and actions: the same scenes, pictures, states and scores in every process."""
    outputs = [
        subprocess.run([sys.executable, "-c", DIGEST_PROGRAM], capture_output=True, text=True, check=True)
        for _ in range(2)
    ]
    assert outputs[0].stdout == outputs[1].stdout != ""
    assert outputs[0].stderr == ""  # nor is anything said when the interpreter exits


def test_interleaved_environments_draw_what_each_draws_alone() -> None:
    def make(task: str, size: int) -> magical_mj.Environment:
        return magical_mj.load(task, "All", seed=2, image_size=size)

    choices = [("FindDupe", 96), ("MoveToRegion", 64), ("FixColour", 96), ("ClusterColour", 200)]
    actions = np.random.default_rng(1).integers(18, size=12)
    alone = []
    for task, size in choices:
        env = make(task, size)
        alone.append([env.reset().observation, *(env.step(action).observation for action in actions)])
        env.close()
    envs = [make(task, size) for task, size in choices]
    together = [[env.reset().observation] for env in envs]
    for action in actions:
        for env, seen in zip(envs, together, strict=True):
            seen.append(env.step(action).observation)
    for one, other in zip(alone, together, strict=True):
        for before, after in zip(one, other, strict=True):
            for view in ("ego", "allo"):
                np.testing.assert_array_equal(before[view], after[view])


def test_pictures_do_not_depend_on_what_was_drawn_before() -> None:
    """A reused model draws and moves exactly as a freshly loaded one."""
    scene = magical_mj.sample_scene("FixColour", "All", 1)
    used = magical_mj.load("FixColour", "All", seed=0)
    for seed in (3, 4, 5):
        used.reset(seed=seed)
        used.step(10)
    fresh = magical_mj.load("FixColour", "All", scene=scene)
    first, second = used.reset(seed=1), fresh.reset()
    for action in np.random.default_rng(3).integers(18, size=30):
        for view in ("ego", "allo"):
            np.testing.assert_array_equal(first.observation[view], second.observation[view])
        assert used.scene == fresh.scene
        first, second = used.step(action), fresh.step(action)


def test_observations_are_fresh_and_as_specified() -> None:
    env = magical_mj.load("MakeLine", seed=0, observations=("allo", "state"), image_size=32)
    spec = env.observation_spec()
    assert list(spec) == ["allo", "state"]
    assert spec["allo"].shape == (32, 32, 3)
    first = env.reset().observation
    kept = {name: value.copy() for name, value in first.items()}
    later = env.step(FORWARD).observation
    for name, value in first.items():
        np.testing.assert_array_equal(value, kept[name])
        assert later[name] is not value
        spec[name].validate(value)


def test_state_vector_by_name() -> None:
    scene = Scene(
        Robot(0.5, -0.5, 0.25),
        (Block("star", "blue", -0.3, 0.4, 1.0),),
        (GoalRegion("green", -0.9, -0.8, -0.3, -0.1),),
    )
    env = magical_mj.load_scene(scene, observations=("state",))
    state = dict(zip(STATE_NAMES, env.reset().observation["state"], strict=True))
    expected = {
        "robot.x": 0.5,
        "robot.y": -0.5,
        "robot.angle": 0.25,
        "robot.left_finger": np.pi / 8,
        "robot.right_finger": -np.pi / 8,
        "block0.present": 1,
        "block0.x": -0.3,
        "block0.y": 0.4,
        "block0.angle": 1,
        "block0.star": 1,
        "block0.blue": 1,
        "region0.present": 1,
        "region0.green": 1,
        "region0.x_min": -0.9,
        "region0.y_min": -0.8,
        "region0.x_max": -0.3,
        "region0.y_max": -0.1,
    }
    assert {name for name, value in state.items() if value} == set(expected)
    for name, value in expected.items():
        assert state[name] == pytest.approx(value, abs=1e-6), name
    for _ in range(8):
        state = dict(zip(STATE_NAMES, env.step(FORWARD).observation["state"], strict=True))
    heading = np.array([-np.sin(0.25), np.cos(0.25)])
    velocity = np.array([state["robot.x_velocity"], state["robot.y_velocity"]])
    np.testing.assert_allclose(velocity, 0.8 * heading, atol=0.01)


def test_load_scene_has_no_end_and_no_score() -> None:
    env = magical_mj.load_scene(Scene(Robot(0, 0, 0)), observations=())
    env.reset()
    assert not any(env.step(action).last() for action in np.arange(400) % 18)
    assert env.horizon is None
    with pytest.raises(InvalidSceneError, match="no score"):
        env.score()


def test_dynamics_reach_the_simulation() -> None:
    """Weaker motors are slower off the mark, and slippery blocks slide further."""

    def reached(dynamics: Dynamics) -> float:
        env = magical_mj.load_scene(Scene(Robot(0, -0.5, 0), dynamics=dynamics), observations=())
        env.reset()
        for _ in range(2):
            env.step(FORWARD)
        return env.scene.robot.y

    assert reached(Dynamics(drive_force=2.2)) < reached(Dynamics()) - 0.01 < reached(Dynamics(drive_force=3.5)) - 0.02


def test_an_episode_that_is_over_stays_over_if_the_next_cannot_start() -> None:
    env = magical_mj.load("MoveToRegion", seed=0, observations=())
    env.reset()
    while not env.step(0).last():
        pass
    problems = [RuntimeError("no episode today")]

    def fail_once(_: object, random_state: object) -> None:
        if problems:
            raise problems.pop()

    env.add_extra_hook("initialize_episode", fail_once)
    with pytest.raises(RuntimeError, match="no episode today"):
        env.step(0)
    assert env.step(0).first()


RESETS = """
from pathlib import Path
import magical_mj

envs = [magical_mj.load(task, variant, seed=0) for task, variant in magical_mj.ENVIRONMENTS]

def used_after(resets: int) -> int:
    for number in range(resets):
        envs[number % len(envs)].reset()
    return int(Path("/proc/self/status").read_text().split("VmRSS:")[1].split()[0])

before = used_after(600)  # until the allocator has what it needs
print(used_after(600) - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="only Linux says here how much memory is used")
def test_memory_is_flat_over_hundreds_of_resets() -> None:
    """In a process of its own, whose memory other tests have not cut into pieces; in kB."""
    done = subprocess.run([sys.executable, "-c", RESETS], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 5_000
