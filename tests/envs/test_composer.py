"""The dm_env environment: composer's interface (hooks, delays, an MJCF tree) with an engine's physics, to the bit."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Iterator
from contextlib import nullcontext
from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("dm_control", reason="dm_control does not install with this Python or MuJoCo")

import dm_env
from absl.testing import absltest
from dm_control import composer, mjcf
from dm_control.rl.control import PhysicsError
from dm_env import test_utils

import magical_mj
from magical_mj.actions import ACTIONS
from magical_mj.engine import Engine, State
from magical_mj.engine.simulation import different_numbers
from magical_mj.envs.composer.entities import Arena
from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import (
    ClosedError,
    InvalidActionError,
    InvalidSceneError,
    SettingsError,
    StateError,
    UnknownNameError,
)
from tests.helpers.environments import EACH

BALL = '<mujoco model="ball"><worldbody><geom type="sphere" size=".05" pos="9 9 0"/></worldbody></mujoco>'
ARRAYS = ("qpos", "qvel", "act", "qacc_warmstart", "xpos", "xmat", "tree_asleep", "efc_force")


def test_trajectories_states_and_scores_equal_an_engines_in_every_task() -> None:
    for seed, (task, variant) in enumerate(EACH):
        env, engine = magical_mj.load(task, variant, seed=seed, observations=()), Engine(task, variant, seed=seed)
        env.reset()
        for action in np.random.default_rng(seed).integers(len(ACTIONS), size=30).tolist():
            env.step(action)
            engine.step(action)
        for name in ARRAYS:
            expected, actual = getattr(engine.data, name), getattr(env.physics.data.ptr, name)
            np.testing.assert_array_equal(actual, expected, err_msg=f"{task}-{variant} {name}")
        assert env.get_state() == engine.get_state()
        assert (env.scene, env.score()) == (engine.scene, engine.score())
        env.close()


def test_later_episodes_and_pictures_equal_an_engines_too() -> None:
    """Both if the model is rewritten, for equal blocks, and if it is compiled, for other blocks."""
    env, engine = magical_mj.load("FindDupe", seed=0, observations=("ego", "allo", "state")), Engine("FindDupe")
    demo = magical_mj.sample_scene("FindDupe", "Demo", 0)
    for scene in (
        demo,
        magical_mj.sample_scene("FindDupe", "Jitter", 1),
        magical_mj.sample_scene("FindDupe", "All", 4),
    ):
        env.reset(scene=scene)
        engine.reset(scene=scene)
        for action in (10, 4, 13):
            observation = env.step(action).observation
            engine.step(action)
        np.testing.assert_array_equal(observation["state"], engine.state_vector())
        np.testing.assert_array_equal(observation["ego"], engine.render("ego", 96))
        np.testing.assert_array_equal(observation["allo"], engine.render("allo", 96))
        assert env.get_state() == engine.get_state()
    np.testing.assert_array_equal(env.render("scene", 64), engine.render("scene", 64))


@pytest.mark.parametrize("shifts", [None, "camera:3,latency:2,clutter:2"])
def test_dm_env_protocol(shifts: str | None) -> None:
    """dm_env's own tests, with an action sequence longer than the horizon, and with shifts, a prop and a stack."""

    class Case(test_utils.EnvironmentTestMixin, absltest.TestCase):
        def make_object_under_test(self) -> dm_env.Environment:
            names = ("ego", "state") if shifts is None else ("ego_stack", "state")
            env = magical_mj.load("MoveToRegion", "All", seed=1, observations=names, image_size=16, shifts=shifts)
            if shifts is not None:
                env.task.root_entity.attach(composer.ModelWrapperEntity(mjcf.from_xml_string(BALL))).add("freejoint")
            return env

        def make_action_sequence(self) -> Iterator[int]:
            return iter(np.arange(task_spec("MoveToRegion").horizon() + 5) % len(ACTIONS))

    result = absltest.unittest.TestResult()
    absltest.unittest.defaultTestLoader.loadTestsFromTestCase(Case).run(result)
    assert result.testsRun == 4
    assert not result.errors + result.failures, "\n".join(text for _, text in result.errors + result.failures)


@pytest.mark.parametrize("reward", ["none", "score"])
def test_episodes_end_at_the_horizon_and_the_next_scenes_are_drawn(reward: str) -> None:
    envs = [magical_mj.load("MoveToRegion", "Layout", seed=7, observations=(), reward=reward) for _ in range(2)]
    scenes = []
    for env in envs:
        scenes.append([])
        for _ in range(3):
            timestep = env.step(0)
            scenes[-1].append(env.initial_scene)
            assert timestep.first()
            steps = [env.step(1) for _ in range(env.horizon)]
            assert [step.last() for step in steps] == [False] * (env.horizon - 1) + [True]
            assert steps[-1].reward == (env.score() if reward == "score" else 0.0)
            assert steps[-1].discount == 1.0
    assert scenes[0] == scenes[1]
    assert scenes[0][0] == magical_mj.sample_scene("MoveToRegion", "Layout", 7)
    assert len(set(scenes[0])) == 3


def test_the_tree_is_one_of_entities_and_compiles_to_the_engines_model() -> None:
    scene = magical_mj.sample_scene("MatchRegions", "All", 0)
    env = magical_mj.load_scene(scene, observations=())
    arena = env.task.root_entity
    assert [entity.mjcf_model.model for entity in arena.iter_entities()] == [
        "magical_mj",
        "robot",
        *(f"block{index}" for index in range(len(scene.blocks))),
    ]
    model, ours = mjcf.Physics.from_mjcf_model(arena.mjcf_model).model.ptr, Engine.of_scene(scene).model
    for name in ("body_pos", "geom_size", "dof_invweight0", "pair_friction", "tendon_frictionloss", "skin_vert"):
        np.testing.assert_array_equal(getattr(model, name), getattr(ours, name), err_msg=name)
    frame = mjcf.get_attachment_frame(arena.blocks[1].mjcf_model)
    (joint,) = (child for child in frame.all_children() if getattr(child, "name", None) == "block1_x")
    env.reset()
    np.testing.assert_allclose(env.physics.bind(joint).qpos, scene.blocks[1].x)
    assert env.physics.named.data.qpos["robot/robot_x/"] == scene.robot.x
    with pytest.raises(SettingsError, match="whatever the seed"):
        env.reset(seed=1)


def test_additions_to_the_trees_stay_after_resets() -> None:
    env = magical_mj.load("FindDupe", "CountPlus", seed=0, observations=())
    arena = env.task.root_entity
    arena.mjcf_model.worldbody.add("site", name="mark", pos=(0.1, 0.2, 0))
    arena.robot.mjcf_model.worldbody.add("site", name="nose", pos=(0, 0.1, 0))
    counts = set()
    for seed in range(4):
        env.reset(seed=seed)
        counts.add(len(env.scene.blocks))
        np.testing.assert_allclose(env.physics.named.data.site_xpos["mark"], [0.1, 0.2, 0])
        assert np.linalg.norm(env.physics.named.data.site_xpos["robot/nose"][:2] - env.scene.robot.pose[:2]) < 0.1001
    assert len(counts) > 1


def test_trees_are_changed_in_every_episode_if_they_are_compiled_in_every_episode() -> None:
    sizes: list[float] = []

    def resize(random_state: np.random.RandomState) -> None:
        wall = env.task.root_entity.mjcf_model.find("geom", "top_wall")
        wall.size = [3, random_state.uniform(0.5, 1.5), 1]
        sizes.append(wall.size[1])

    quick = magical_mj.load("MoveToRegion", seed=0, observations=())
    with pytest.raises(SettingsError, match="recompile_mjcf_every_episode"):
        quick.add_extra_hook("initialize_episode_mjcf", resize)
    env = magical_mj.load("MoveToRegion", seed=0, observations=(), recompile_mjcf_every_episode=True)
    env.add_extra_hook("initialize_episode_mjcf", resize)
    for _ in range(3):
        env.reset()
        assert env.physics.named.model.geom_size["top_wall", 1] == sizes[-1]
    assert len(set(sizes)) == 3


def test_hooks_run_and_change_nothing_by_themselves() -> None:
    env, twin = (magical_mj.load("FindDupe", "All", seed=0, observations=()) for _ in range(2))
    calls: list[str] = []
    for name in ("initialize_episode", "before_step", "before_substep", "after_substep", "after_step"):
        env.add_extra_hook(name, lambda *_, name=name: calls.append(name))
    for seed in (0, 3):  # with other structures
        env.reset(seed=seed)
        twin.reset(seed=seed)
        for action in (1, 10):
            env.step(action)
            twin.step(action)
        assert env.get_state() == twin.get_state()
    step = ["before_step", *["before_substep", "after_substep"] * env.task.physics_steps_per_control_step, "after_step"]
    assert len(step) == 22
    assert calls == ["initialize_episode", *step, *step] * 2


def test_a_copy_of_the_physics_is_in_the_same_episode() -> None:
    """To observe it, for example in a search, changes nothing: the steps so far still count."""
    env = magical_mj.load("MoveToRegion", seed=0, observations=("state",))
    env.reset()
    for _ in range(3):
        env.step(1)
    env.task.observables["state"].observation_callable(env.physics.copy())()
    assert not env.task.should_terminate_episode(env.physics.copy())
    assert env.get_state().steps == 3
    assert sum(1 for _ in iter(lambda: env.step(1).last(), True)) == env.horizon - 4


def test_observables_have_buffers_and_delays() -> None:
    env = magical_mj.load("MoveToRegion", seed=0, observations=("state",))
    an_action = env.task.physics_steps_per_control_step
    env.task.observables["state"].configure(buffer_size=3, update_interval=an_action, delay=an_action)
    env.reset()
    buffers = [env.step(1).observation["state"] for _ in range(6)]
    assert buffers[0].shape[0] == 3
    for before, after in pairwise(buffers[2:]):
        np.testing.assert_array_equal(after[:2], before[1:])
    assert (buffers[-1][-1] != env.task.task_observables["state"](env.physics)).any()


def test_a_variation_of_the_users_own() -> None:
    """As usual in composer: a hook draws with the environment's generator and writes into the compiled model."""
    env = magical_mj.load("FindDupe", seed=0, observations=())
    drawn: list[float] = []

    def slippery(physics: mjcf.Physics, random_state: np.random.RandomState) -> None:
        drawn.append(random_state.uniform(0.5, 2))
        physics.named.model.pair_friction["block0_foot", :2] *= drawn[-1]

    usual = Engine("FindDupe", seed=0).model.pair("block0_foot").friction[0]
    env.add_extra_hook("initialize_episode", slippery)
    for _ in range(3):
        env.reset(scene=env.initial_scene)
        assert env.physics.named.model.pair_friction["block0_foot", 0] == pytest.approx(drawn[-1] * usual)


def test_an_adapter_may_seed_the_generator_before_the_first_reset() -> None:
    scenes = []
    for _ in range(2):
        env = magical_mj.load("MoveToRegion", "Layout", observations=())
        env.random_state.seed(3)
        env.reset()
        scenes.append(env.initial_scene)
    assert scenes[0] == scenes[1]


@pytest.mark.parametrize("fails", [False, True])
def test_an_episode_with_the_blocks_of_loading_after_another_has_its_own_model(fails: bool) -> None:
    env = magical_mj.load("FixColour", "All", seed=3, observations=())
    failures = [fails]

    def fail_once(*_: object) -> None:
        if failures[0]:
            failures[0] = False
            raise RuntimeError("a hook that fails")

    env.add_extra_hook("initialize_episode", fail_once)
    with pytest.raises(RuntimeError) if fails else nullcontext():
        env.reset(seed=5)
    for seed in (3, 7):
        env.reset(seed=seed)
        engine = Engine("FixColour", "All", seed=seed)
        for action in (1, 10, 4):
            env.step(action)
            engine.step(action)
        assert env.get_state() == engine.get_state()
        assert not different_numbers(env.physics.model.ptr, engine.model)


def test_states_go_from_here_to_engines_and_back() -> None:
    env, engine = magical_mj.load("FindDupe", "All", seed=2, observations=("state",)), Engine("FindDupe", "All", seed=9)
    env.reset()
    for action in (1, 10, 4, 13):
        env.step(action)
    state = env.get_state()
    engine.reset(state=state)
    env.reset(seed=5)
    first = env.reset(state=state)
    np.testing.assert_array_equal(first.observation["state"], engine.state_vector())
    assert first.first()
    for action in (1, 10, 4, 13):
        env.step(action)
        engine.step(action)
    assert env.get_state() == engine.get_state()
    while not env.step(1).last():
        pass
    over = env.get_state()
    with pytest.raises(StateError, match="ended"):
        env.reset(state=over)
    env.set_state(state)
    assert env.step(1).mid()
    env.set_state(over)
    assert env.step(1).first()
    with pytest.raises(InvalidSceneError):
        env.set_state(Engine("MakeLine", seed=0).get_state())
    good = env.get_state()
    with pytest.raises(StateError):
        env.set_state(State(good.scene, 0, good.simulation[:-1]))
    assert env.get_state() == good


def test_wrong_arguments_of_load_are_refused() -> None:
    for arguments in ({"observations": ("egg",)}, {"reward": "thick"}, {"rules": "old"}, {"variant": "Layot"}):
        with pytest.raises(UnknownNameError):
            magical_mj.load("FindDupe", **arguments)
    for arguments in ({"observations": "ego"}, {"observations": None}, {"image_size": 0}):
        with pytest.raises(SettingsError):
            magical_mj.load("FindDupe", **arguments)
    with pytest.raises(InvalidSceneError):
        magical_mj.load_scene(3)  # type: ignore[arg-type]
    env = magical_mj.load("MoveToRegion", seed=0, observations=())
    env.reset()
    with pytest.raises(InvalidActionError):
        env.step(18)
    with pytest.raises(SettingsError, match="not seed and scene"):
        env.reset(seed=1, scene=env.initial_scene)
    env.physics.data.qvel[:] = 1e30
    with pytest.raises(PhysicsError):
        env.step(4)
    assert env.step(4).first()
    env.close()
    env.close()
    for use in (env.reset, lambda: env.step(0), lambda: env.scene, env.render, env.get_state):
        with pytest.raises(ClosedError):
            use()


def test_an_episode_that_is_over_stays_over_if_the_next_cannot_start() -> None:
    env = magical_mj.load("MoveToRegion", seed=0, observations=())
    problems = [RuntimeError("no episode today")]

    def fail_once(*_: object) -> None:
        if problems:
            raise problems.pop()

    env.add_extra_hook("initialize_episode", fail_once)
    with pytest.raises(RuntimeError, match="no episode today"):
        env.step(0)
    assert env.step(0).first()


def test_arenas_show_one_scene_after_another() -> None:
    """After other scenes, an arena has the same tree as a new arena."""
    scenes = [magical_mj.sample_scene("MatchRegions", "All", seed) for seed in range(2)]
    scenes += [Scene(Robot(0, 0, 0)), Scene(Robot(0, 0.5, 1), (Block("star", "red", 0, 0, 0),)), scenes[0]]
    scenes.append(Scene(Robot(0, 0, 0), regions=(GoalRegion("red", -0.5, -0.5, 0.5, 0.5),)))
    scenes += [Engine("FindDupe", "All", seed=seed, shifts="clutter:3").scene for seed in (0, 3)]  # with pebbles
    used, new = Arena(scenes[0]), {scene: Arena(scene).mjcf_model.to_xml_string() for scene in scenes}
    for scene in scenes:
        used.show(scene)
        assert used.mjcf_model.to_xml_string() == new[scene]
    assert isinstance(used, composer.Entity)


def test_copies_continue_in_exactly_the_same_way() -> None:
    shifts = "clutter:3,latency:2,words:4"
    with magical_mj.load("FixColour", "All", seed=3, observations=("state",), shifts=shifts) as env:
        for seed in (0, 5, 3):
            env.reset(seed=seed)
        env.step(5)
        twins = env.clone(), pickle.loads(pickle.dumps(env)), copy.deepcopy(env)
        assert all((it.get_state(), it.instruction) == (env.get_state(), env.instruction) for it in twins)
        after = env.step(7).observation["state"]
        assert all(np.array_equal(twin.step(7).observation["state"], after) for twin in twins)
        env.reset()
        for twin in twins:
            twin.reset()
            assert (twin.seed, twin.scene) == (env.seed, env.scene)
