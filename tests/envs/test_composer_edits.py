"""Users' additions and changes in a composer environment take effect, or raise an error that names the attribute."""

from __future__ import annotations

import dataclasses
import pickle
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

pytest.importorskip("dm_control", reason="dm_control does not install with this Python or MuJoCo")

import mujoco
from dm_control import composer, mjcf
from dm_control.composer.observation import observable
from dm_control.composer.variation import MJCFVariator, distributions

import magical_mj
from magical_mj.actions import ACTIONS
from magical_mj.engine import Engine
from magical_mj.engine.export import mjcf_text
from magical_mj.scene import Dynamics, Robot, Scene
from magical_mj.utils.errors import InvalidSceneError, SettingsError, StateError
from tests.helpers.environments import EACH


class Prop(composer.Entity):
    """A prop: a ball on a joint, with an actuator, a tendon, a sensor and a camera."""

    def _build(self, name: str = "prop", joint: str = "slide") -> None:
        self._model = mjcf.RootElement(model=name)
        ball = self._model.worldbody.add("body", name="ball")
        ball.add("geom", name="ball", type="sphere", size=[0.05], mass=0.1)
        ball.add("camera", name="ego")
        if joint != "free":
            axis = ball.add("joint", name="robot_x", type=joint, axis=[1, 0, 0])
            self._model.actuator.add("motor", name="wheel", joint=axis)
            self._model.tendon.add("fixed", name="rotor").add("joint", joint=axis, coef=1)
            self._model.sensor.add("jointpos", name="robot_x", joint=axis)

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        return self._model


def far(env: magical_mj.Environment, prop: Prop, *, free: bool = False) -> None:
    """Attaches the prop far from the scene's objects."""
    frame = env.task.root_entity.attach(prop)
    frame.pos = (9, 9, 0)
    if free:
        frame.add("freejoint")


def check_episodes(env: magical_mj.Environment, task: str, variant: str, seeds: int = 4, steps: int = 8) -> None:
    """Episodes equal an engine's to the bit, and episodes from saved states equal the original continuation."""
    counts = set()
    for seed in range(seeds):
        env.reset(seed=seed)
        engine = Engine(task, variant, seed=seed)
        counts.add(len(engine.scene.blocks))
        assert env.initial_scene == env.scene == engine.initial_scene
        *_, observation = [
            (env.step(action).observation, engine.step(action))[0]
            for action in np.random.default_rng(seed).integers(len(ACTIONS), size=steps).tolist()
        ]
        assert env.scene == engine.scene, f"seed {seed}"
        assert env.score() == engine.score()
        np.testing.assert_array_equal(observation["state"], engine.state_vector())
        state = env.get_state()
        after = [env.step(4).observation["state"], env.get_state()]
        env.set_state(state)
        np.testing.assert_array_equal(env.step(4).observation["state"], after[0])
        assert env.get_state() == after[1]
    assert len(counts) > 1


@pytest.mark.parametrize(("joint", "first"), [("slide", True), ("free", False)])
def test_a_prop_far_away_changes_no_bit_of_any_episode(joint: str, *, first: bool) -> None:
    """If it is attached before the first reset, and if it is attached later."""
    env = magical_mj.load("MatchRegions", "CountPlus", seed=0, observations=("state",))
    if not first:
        env.reset(seed=3)
    far(env, Prop(joint=joint), free=joint == "free")
    check_episodes(env, "MatchRegions", "CountPlus")
    names = env.physics.named.data.qpos.axes.row.names
    assert sum(name.startswith("prop/") for name in names) == 1
    env.close()


SHIFTS = ("latency:2", "clutter:3,camera:3", "slip:4,light:2", "friction:3,texture:1", "sensor:3,palette:2")


@pytest.mark.slow
def test_every_task_is_the_same_in_every_interface_with_shifts_and_a_prop() -> None:
    for seed, (task, variant) in enumerate(EACH):
        name, shifts = magical_mj.env_id(task, variant, "State"), SHIFTS[seed % len(SHIFTS)]
        engine = Engine(task, variant, seed=seed, shifts=shifts)
        single, vector = gymnasium.make(name, shifts=shifts), magical_mj.make_vec(name, num_envs=2, shifts=shifts)
        env = magical_mj.load(task, variant, seed=seed, observations=("state",), shifts=shifts)
        far(env, Prop())
        env.reset()
        single.reset(seed=seed)
        vector.reset(seed=seed)
        for action in (10, 1, 13, 4, 7):
            engine.step(action)
            observations = [
                engine.state_vector(),
                single.step(action)[0],
                vector.step(np.array([action, action]))[0][0],
                env.step(action).observation["state"],
            ]
            assert len({observation.tobytes() for observation in observations}) == 1, (task, variant, shifts)
        assert engine.get_state() == single.unwrapped.get_state() == vector.call("get_state")[0]  # pyright: ignore[reportAttributeAccessIssue]
        assert (env.scene, env.score()) == (engine.scene, engine.score())
        for it in (single, vector, env):
            it.close()


def test_a_second_robot_and_a_raw_model_change_no_bit_either() -> None:
    """Names are looked up in their scopes, even if users' elements have the same names."""
    env = magical_mj.load("FindDupe", "All", seed=0, observations=("state",))
    far(env, Prop("robot"))
    env.task.root_entity.mjcf_model.attach(Prop("block").mjcf_model).pos = (-9, 9, 0)
    world = env.task.root_entity.mjcf_model
    world.deformable.add("skin", name="flag", vertex=[0] * 9, face=[0, 1, 2]).add(
        "bone", body="regions", bindpos=[0] * 3, bindquat=[1, 0, 0, 0], vertid=[0, 1, 2], vertweight=[1] * 3
    )
    check_episodes(env, "FindDupe", "All", seeds=2)
    assert env.physics.model.nu == 8
    env.close()


def test_parts_of_robot_and_blocks_stay_with_them() -> None:
    """Those of a block belong to its shape, and survive episodes without it."""
    env = magical_mj.load("MatchRegions", "CountPlus", seed=0, observations=("state",))
    arena = env.task.root_entity
    for tree in (arena.robot.mjcf_model, arena.blocks[1].mjcf_model):
        body = tree.worldbody.add("body", name="antenna", pos=(0, 0, 5))
        body.add("joint", name="antenna", axis=(0, 0, 1))
        body.add("geom", size=[0.01], mass=1e-9, contype=0, conaffinity=0)
    frame = mjcf.get_attachment_frame(arena.blocks[1].mjcf_model)
    frame.find_all("joint", immediate_children_only=True)[0].damping = 0.001
    arena.mjcf_model.find("contact", "block1_foot").margin = 0.002
    shape, seen = env.initial_scene.blocks[1].shape, set[bool]()
    for seed in range(4):
        env.reset(seed=seed)
        engine = Engine("MatchRegions", "CountPlus", seed=seed)
        for action in (1, 4, 10, 13):
            env.step(action)
            engine.step(action)
        moved, expected = (
            np.array([scene.robot.pose, *(it.pose for it in scene.blocks)]) for scene in (env.scene, engine.scene)
        )
        np.testing.assert_allclose(moved, expected, atol=1e-5)
        names, same = env.physics.named.data.qpos.axes.row.names, engine.scene.blocks[1].shape == shape
        assert "robot/antenna" in names
        assert ("block1/antenna" in names) == same
        assert (env.physics.model.pair("block1_foot").margin[0] == 0.002) == same
        seen.add(same)
    assert seen == {True, False}
    env.close()


def test_saved_states_do_not_depend_on_earlier_episodes() -> None:
    """The order of MuJoCo's vectors depends on the scene and the users' additions, not on earlier episodes."""
    used, fresh = (magical_mj.load("FindDupe", "All", seed=2, observations=()) for _ in range(2))
    for env in (used, fresh):
        far(env, Prop())
    for seed in (5, 6, 2):
        used.reset(seed=seed)
    fresh.reset(seed=2)
    for env in (used, fresh):
        env.step(1)
    assert used.get_state() == fresh.get_state()


def test_a_name_that_the_scene_needs_is_refused_when_it_needs_it() -> None:
    env = magical_mj.load("MatchRegions", "CountPlus", seed=0, observations=())
    counts = {seed: len(magical_mj.sample_scene("MatchRegions", "CountPlus", seed).blocks) for seed in range(8)}
    most = max(counts, key=counts.__getitem__)
    env.reset(seed=min(counts, key=counts.__getitem__))
    far(env, Prop(f"block{counts[most] - 1}"))
    with pytest.raises(SettingsError, match="reserved"):
        env.reset(seed=most)


def assign(element: Any, **attributes: Any) -> None:
    """A function that changes an element."""
    element.set_attributes(**attributes)


OWNED = {
    "pair friction": (lambda arena: assign(arena.mjcf_model.contact.pair[0], friction=[9] * 5), "Scene.dynamics"),
    "in place": (lambda arena: arena.mjcf_model.contact.pair[0].friction.__setitem__(0, 9), "Scene.dynamics"),
    "tendon": (lambda arena: assign(arena.robot.mjcf_model.tendon.fixed[0], frictionloss=9), "Scene.dynamics"),
    "colour": (
        lambda arena: assign(arena.blocks[0].mjcf_model.find("geom", "block0_fill"), rgba=[1, 1, 1, 1]),
        "the colours in the scene",
    ),
    "pose": (lambda arena: assign(mjcf.get_attachment_frame(arena.robot.mjcf_model), pos=[0, 0, 0]), "the poses"),
    "region": (lambda arena: assign(arena.mjcf_model.deformable.skin[0], rgba=[1, 1, 1, 1]), "the colours"),
    "timestep": (lambda arena: assign(arena.mjcf_model.option, timestep=0.005), "ten substeps"),
    "detached": (lambda arena: arena.blocks[0].detach(), "do not remove"),
    "removed": (lambda arena: arena.mjcf_model.deformable.skin[0].remove(), "do not remove"),
}


@pytest.mark.parametrize("what", sorted(OWNED))
def test_changes_of_what_the_scene_owns_are_refused(what: str) -> None:
    change, owner = OWNED[what]
    env = magical_mj.load("FixColour" if what in ("colour", "detached") else "MoveToRegion", seed=0, observations=())
    if what != "pair friction":  # a pair is changed before the first reset
        env.reset(seed=0)
    scene = env.initial_scene
    before = env.task.root_entity.mjcf_model.to_xml_string()
    change(env.task.root_entity)
    with pytest.raises(SettingsError, match=owner):
        env.reset(seed=0)
    if owner != "do not remove":
        env.reset(seed=0)
        assert env.task.root_entity.mjcf_model.to_xml_string() == before
        assert env.scene == scene


def test_a_variation_of_what_the_scene_owns_is_refused_and_the_way_around_works() -> None:
    env = magical_mj.load("FindDupe", seed=0, observations=(), recompile_mjcf_every_episode=True)
    variator, fill = MJCFVariator(), env.task.root_entity.blocks[0].mjcf_model.find("geom", "block0_fill")
    variator.bind_attributes(fill, rgba=distributions.Uniform([0, 0, 0, 1], [1, 1, 1, 1]))
    env.add_extra_hook("initialize_episode_mjcf", variator.apply_variations)
    with pytest.raises(SettingsError, match="geom_rgba in an initialize_episode hook"):
        env.reset()
    env = magical_mj.load("FindDupe", seed=0, observations=())
    env.add_extra_hook("initialize_episode", lambda physics, _: physics.bind(fill_of(env)).__setattr__("rgba", PINK))
    for _ in range(2):
        env.reset()
        np.testing.assert_allclose(env.physics.named.model.geom_rgba["block0/block0_fill"], PINK)
    dynamics = dataclasses.replace(env.initial_scene, dynamics=Dynamics(drive_force=2.0))
    env.reset(scene=dynamics)
    expected = Engine.of_scene(dynamics).model.pair("wheel").friction[0]
    assert env.physics.model.pair("wheel").friction[0] == expected


PINK = [1, 0.5, 0.5, 1]


def fill_of(env: magical_mj.Environment) -> Any:
    """The geom with the block's fill colour."""
    return env.task.root_entity.blocks[0].mjcf_model.find("geom", "block0_fill")


def test_other_changes_of_the_tree_count_from_the_next_reset_and_stay() -> None:
    env = magical_mj.load("FindDupe", "CountPlus", seed=0, observations=())
    env.reset(seed=0)
    arena = env.task.root_entity
    face, wall = arena.robot.mjcf_model.find("geom", "robot_fill"), arena.mjcf_model.find("geom", "top_wall")
    face.rgba = [1, 0, 0, 1]
    wall.size[1] = 0.7  # in place: dm_control does not notice it
    arena.mjcf_model.option.gravity = [0, 0, -1]
    for seed in (0, 0, 1, 2):
        env.reset(seed=seed)
        np.testing.assert_allclose(env.physics.named.model.geom_rgba["robot/robot_fill"], [1, 0, 0, 1])
        assert env.physics.named.model.geom_size["top_wall", 1] == 0.7
        assert env.physics.model.opt.gravity[2] == -1
    model = env.physics.model.ptr
    env.reset(seed=2)
    assert env.physics.model.ptr is model, "compiled again without a reason"


def test_the_tree_is_that_of_the_present_episode() -> None:
    env = magical_mj.load("FindDupe", "All", seed=0, observations=())
    arena = env.task.root_entity
    for seed in (0, 0, 4, 9):
        scene = magical_mj.sample_scene("FindDupe", "All", seed)
        for start in (scene, scene.moved(robot=(0.5, 0.5, 1))):
            env.reset(scene=start)
            model = mujoco.MjModel.from_xml_string(arena.mjcf_model.to_xml_string(), arena.mjcf_model.get_assets())
            ours = Engine.of_scene(start).model
            for name in ("body_pos", "geom_rgba", "pair_friction", "tendon_frictionloss", "skin_vert", "skin_rgba"):
                np.testing.assert_allclose(getattr(model, name), getattr(ours, name), rtol=1e-6, err_msg=name)
            assert tuple(mjcf.get_attachment_frame(arena.robot.mjcf_model).pos[:2]) == start.robot.pose[:2]


def test_the_arena_and_the_robots_body_are_those_that_were_loaded() -> None:
    env = magical_mj.load_scene(Scene(Robot(0, 0, 0)), observations=())
    for scene in (Scene(Robot(0, 0, 0, body="longstick")), Scene(Robot(0, 0, 0), half_width=2)):
        with pytest.raises(InvalidSceneError, match="load another environment"):
            env.reset(scene=scene)
    assert env.reset().first()


def test_timesteps_are_fixed() -> None:
    env = magical_mj.load("FindDupe", seed=0, observations=())
    task = env.task
    for change in (
        lambda: task.set_timesteps(0.25, 0.0125),
        lambda: setattr(task, "control_timestep", 0.25),
        lambda: setattr(task, "physics_timestep", 0.005),
    ):
        with pytest.raises(SettingsError, match="cannot be changed"):
            change()
    env.reset()
    assert (task.physics_steps_per_control_step, task.control_timestep, task.physics_timestep) == (10, 0.125, 0.0125)
    env.physics.model.opt.timestep = 0.005
    with pytest.raises(SettingsError, match="cannot be changed"):
        env.reset()
    env.reset()
    env.step(1)
    assert env.physics.time() == pytest.approx(env.control_timestep())


class Watcher(Prop):
    """An entity that counts substeps."""

    def _build(self, name: str = "watcher", joint: str = "slide") -> None:
        super()._build(name, joint)
        self.times: list[float] = []

    def after_substep(self, physics: Any, random_state: Any) -> None:
        self.times.append(physics.time())


@pytest.mark.parametrize("by", ["hook", "entity"])
def test_substeps_are_seen_by_whom_they_concern(by: str) -> None:
    env, twin = (magical_mj.load("MoveToRegion", "All", seed=0, observations=("state",)) for _ in range(2))
    env.reset(seed=3)
    times: list[float] = []
    with pytest.raises(SettingsError, match="before reset"):
        env.add_extra_hook("after_substep", lambda physics, _: times.append(physics.time()))
    while not env.step(0).last():
        pass
    if by == "hook":
        env.add_extra_hook("after_substep", lambda physics, _: times.append(physics.time()))
    else:
        watcher = Watcher()
        times = watcher.times
        far(env, watcher)
    env.reset(seed=0)
    twin.reset(seed=0)
    for action in (1, 10, 5):
        seen = [it.step(action).observation["state"] for it in (env, twin)]
        np.testing.assert_array_equal(*seen)
    np.testing.assert_allclose(times, 0.0125 * np.arange(1, 31), atol=1e-12)


def test_observables_may_be_added_and_enabled_at_any_time() -> None:
    env = magical_mj.load("FindDupe", seed=0, observations=("state",))
    env.reset()
    env.task.root_entity.observables.add_observable("clock", observable.Generic(lambda physics: physics.time()))
    env.task.task_observables["half"] = observable.Generic(lambda physics: physics.time() / 2)
    env.task.task_observables["half"].enabled = True
    assert set(env.reset().observation) == {"state", "clock", "half"}
    assert env.step(0).observation["half"] == pytest.approx(env.step(0).observation["clock"] / 4)
    env.task.observables["clock"].enabled = False
    assert set(env.reset().observation) == {"state", "half"}


def test_a_users_hooks_at_compilation_need_compilations() -> None:
    class Varying(Prop):
        def initialize_episode_mjcf(self, random_state: np.random.RandomState) -> None:
            self._model.find("geom", "ball").size = [random_state.uniform(0.04, 0.06)]

    env = magical_mj.load("FindDupe", seed=0, observations=())
    far(env, Varying())
    with pytest.raises(SettingsError, match="recompile_mjcf_every_episode=True"):
        env.reset()
    env = magical_mj.load("FindDupe", seed=0, observations=(), recompile_mjcf_every_episode=True)
    far(env, Varying())
    sizes = set()
    for _ in range(3):
        env.reset()
        sizes.add(env.physics.named.model.geom_size["prop/ball", 0])
    assert len(sizes - {0.05}) == 3


def noise(values: np.ndarray, random_state: np.random.RandomState) -> np.ndarray:
    """A corruptor."""
    return values + random_state.uniform(size=values.shape).astype(values.dtype)


def test_copies_have_corruptors_and_aggregators() -> None:
    env = magical_mj.load("MoveToRegion", "All", seed=3, observations=("state",))
    env.task.observables["state"].configure(corruptor=noise, aggregator=np.max)
    env.reset()
    env.step(5)
    twins = [env.clone(), pickle.loads(pickle.dumps(env))]
    seen = [[it.step(4).observation["state"], it.step(7).observation["state"]] for it in (env, *twins)]
    assert seen[0] == seen[1] == seen[2]
    assert seen[0][0].shape == ()
    env.task.observables["state"].corruptor = lambda values, random_state: values
    with pytest.raises(StateError, match="'state' cannot be pickled"):
        pickle.dumps(env)


CHANGES = {
    "a hook before_step": lambda env: env.add_extra_hook("before_step", lambda physics, action, random_state: None),
    "buffer or delay of the observable 'state'": lambda env: setattr(env.task.observables["state"], "delay", 1),
    "the observable 'mine'": lambda env: env.task.task_observables.update(mine=observable.Generic(lambda physics: 1)),
    "the removed observable 'state'": lambda env: env.task.task_observables.pop("state"),
    "the MJCF tree": lambda env: far(env, Prop()),
    "physics.model.geom_rgba": lambda env: env.physics.named.model.geom_rgba.__setitem__("top_wall", PINK),
    "the attribute 'bonus'": lambda env: setattr(env.task, "bonus", 3),
    "the class Mine": lambda env: setattr(env, "__class__", type("Mine", (magical_mj.Environment,), {})),
}


@pytest.mark.parametrize("what", sorted(CHANGES))
def test_a_clone_names_changes_that_it_cannot_copy(what: str) -> None:
    with magical_mj.load("MoveToRegion", seed=0, observations=("state",)) as env:
        env.reset()
        CHANGES[what](env)
        for copy in (env.clone, lambda: pickle.dumps(env)):
            with pytest.raises(StateError, match=what):
                copy()


def test_exports_are_the_same_from_every_interface(tmp_path: Path) -> None:
    engine = Engine("FindDupe", "All", seed=3)
    engine.step(5)
    number = iter(range(100))

    def text(source: Any, index: int = 0) -> str:
        return magical_mj.export_mjcf(source, tmp_path / f"{next(number)}.xml", index=index).read_text()

    name = "magical_mj/FindDupe-TestAll-LoRes4E-v0"
    single, env = gymnasium.make(name, renderer="software"), magical_mj.load("FindDupe", "All", seed=3)
    single.reset(seed=3)
    single.step(5)
    env.reset(seed=3)
    env.step(5)
    sources = [single, gymnasium.wrappers.ClipReward(single, 0, 1), env]
    assert env.to_engine().get_state() == engine.get_state()
    for source in sources:
        assert text(source) == mjcf_text(engine)
    for mode in ("sync", "vector_entry_point"):
        envs = gymnasium.make_vec(name, num_envs=2, vectorization_mode=mode, renderer="software")
        envs.reset(seed=[9, 3])  # pyright: ignore[reportArgumentType]
        envs.step(np.array([5, 5]))
        assert text(envs, 1) == mjcf_text(engine) != text(envs, 0)
        with pytest.raises(SettingsError, match="0 to 1"):
            text(envs, 2)
        envs.close()
    for other in (3, gymnasium.make("CartPole-v1"), gymnasium.make_vec("CartPole-v1", num_envs=2)):
        with pytest.raises(InvalidSceneError, match="environment"):
            text(other)
    far(env, Prop())
    for _ in range(2):  # before the prop is compiled, and after
        with pytest.raises(SettingsError, match="export_with_assets"):
            text(env)
        env.reset()
