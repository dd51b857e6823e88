"""The observations of composer environments, compared with those of engines and Gymnasium environments."""

from __future__ import annotations

import math
import pickle
from typing import Any

import gymnasium
import numpy as np
import pytest

pytest.importorskip("dm_control", reason="dm_control does not install with this Python or MuJoCo")

from dm_control import composer, mjcf
from dm_control.composer.observation import observable
from dm_control.composer.variation import distributions, noises

import magical_mj
from magical_mj.engine import Engine
from magical_mj.observations import STATE_NAMES
from magical_mj.scene import Block, Robot, Scene
from magical_mj.utils.errors import InvalidSceneError, SettingsError, StateError

OBSERVED = ("block0/pose", "block0/velocity", "robot/pose", "robot/velocity", "robot/fingers")


def twins(task: str, variant: str, name: str = "ego_stack", **options: Any) -> tuple[magical_mj.Environment, Any]:
    """A composer environment that observes a stack of frames, and the equivalent Gymnasium environment."""
    preset = {"ego_stack": "LoRes4E", "allo_stack": "LoRes4A"}[name]
    env = magical_mj.load(task, variant, seed=0, observations=(name,), **options)
    return env, gymnasium.make(magical_mj.env_id(task, variant, preset), **options).unwrapped


@pytest.mark.parametrize(
    ("task", "variant", "name", "options"),
    [
        ("FindDupe", "All", "ego_stack", {}),
        ("MoveToRegion", "Layout", "ego_stack", {"shifts": {"camera": 3, "latency": 2}}),
        ("FixColour", "All", "allo_stack", {"shifts": "texture:2,sensor:3", "image_size": 32, "rules": "released"}),
    ],
)
def test_the_stack_is_the_papers_observation(task: str, variant: str, name: str, options: dict[str, Any]) -> None:
    """Equal bytes in two whole episodes with different blocks."""
    env, twin = twins(task, variant, name, **options)
    rng = np.random.default_rng(0)
    for seed in (0, 3):
        step, (picture, _), truncated = env.reset(seed=seed), twin.reset(seed=seed), False
        while True:
            np.testing.assert_array_equal(step.observation[name], picture)
            assert step.last() == truncated
            if truncated:
                break
            action = rng.integers(18)
            step, (picture, _, _, truncated, _) = env.step(action), twin.step(action)
    assert env.observation_spec()[name].validate(step.observation[name]) is not None


def test_stacks_are_part_of_states_and_copies() -> None:
    env, twin = twins("FixColour", "All", image_size=16)
    env.reset(seed=1)
    twin.reset(seed=1)
    for action in (1, 4, 10, 13, 1):
        env.step(action)
        twin.step(action)
    state, gym_state = env.get_state(), twin.get_state()
    assert state == gym_state
    assert set(state.frames) == set(gym_state.frames)
    copies = [env.clone(), pickle.loads(pickle.dumps(env))]
    after, expected = env.step(7).observation["ego_stack"], twin.step(7)[0]
    for other in copies:
        np.testing.assert_array_equal(other.step(7).observation["ego_stack"], after)
    np.testing.assert_array_equal(after, expected)
    for saved in (state, gym_state):  # from both interfaces, restored in another episode
        env.reset(seed=2)
        env.step(5)
        np.testing.assert_array_equal(env.reset(state=saved).observation["ego_stack"], saved.frames["ego4"])
        env.set_state(saved)
        np.testing.assert_array_equal(env.step(7).observation["ego_stack"], expected)
    engine = Engine("FixColour", "All", seed=1)
    engine.step(1)
    env.reset(state=engine.get_state())  # has no frames: the current frame fills the stack
    twin.reset(options={"state": engine.get_state()})
    np.testing.assert_array_equal(env.step(7).observation["ego_stack"], twin.step(7)[0])


def test_stacks_are_complete_however_composer_evaluates_them() -> None:
    """With a delay, a buffer, a long update interval, or when only the test evaluates it."""
    env, twin = twins("MoveToRegion", "Demo", image_size=16)
    per_action = env.task.physics_steps_per_control_step
    for options in (
        {"delay": per_action, "buffer_size": 1, "update_interval": per_action},
        {"update_interval": 3 * per_action},
        {"corruptor": lambda stack, random_state: np.zeros_like(stack)},
    ):
        observed = env.task.observables["ego_stack"]
        observed.configure(**{"delay": None, "update_interval": 1, "corruptor": None, **options})
        env.reset()
        pictures = [twin.reset(options={"scene": env.initial_scene})[0]]
        for number in range(1, 8):
            seen = env.step(number).observation["ego_stack"]
            pictures.append(twin.step(number)[0])
            if "delay" in options:
                np.testing.assert_array_equal(seen, pictures[number - 1])
            elif "update_interval" in options:
                np.testing.assert_array_equal(seen, pictures[number - number % 3])
            else:
                assert not seen.any()
        observed.corruptor = None
        np.testing.assert_array_equal(observed(env.physics), pictures[-1])
        np.testing.assert_array_equal(env.get_state().frames["ego4"], pictures[-1])


def test_entities_observe_the_present_scene_in_every_episode() -> None:
    """For changing numbers and shapes of blocks, and with a user's joint."""
    env = magical_mj.load("FixColour", "All", seed=0, observations=("state",))
    arena = env.task.root_entity
    assert isinstance(arena, composer.Arena)
    prop = mjcf.RootElement(model="prop")
    prop.worldbody.add("geom", size=(0.1,), pos=(3, 3, 0))
    arena.add_free_entity(composer.ModelWrapperEntity(prop))
    names = {f"{entity.mjcf_model.model}/{name}" for entity in arena.iter_entities() for name in names_of(entity)}
    assert not set(env.reset().observation) & names  # disabled by default
    counts, indices = set(), {name: index for index, name in enumerate(STATE_NAMES)}
    for seed in (0, 1, 5):
        env.reset(seed=seed)
        for entity in arena.iter_entities():
            entity.observables.enable_all()
            entity.observables.set_options({name: {"enabled": False} for name in names_of(entity) if "camera" in name})
        env.reset(seed=seed)
        for action in (1, 1, 4, 13):
            seen = env.step(action).observation
        scene, vector = env.scene, seen["state"]
        counts.add(len(scene.blocks))
        assert tuple(seen["robot/pose"]) == scene.robot.pose
        assert tuple(seen["robot/fingers"]) == scene.robot.fingers
        np.testing.assert_array_equal(seen["robot/velocity"].astype(np.float32), vector[3:6])
        rows = seen["robot/egocentric_blocks"]
        assert rows[:, 0].tolist() == [vector[indices[f"block{k}.present"]] for k in range(10)]
        assert not rows[len(scene.blocks) :].any()
        for k, block in enumerate(scene.blocks):
            assert tuple(seen[f"block{k}/pose"]) == block.pose
            velocity = indices[f"block{k}.x_velocity"]
            np.testing.assert_array_equal(
                seen[f"block{k}/velocity"].astype(np.float32), vector[velocity : velocity + 3]
            )
            right, ahead, turned = seen[f"block{k}/egocentric_pose"]
            np.testing.assert_array_equal(rows[k], (1, right, ahead, turned))
            x, y, angle = scene.robot.pose  # to the world frame
            place = complex(x, y) + complex(right, ahead) * complex(math.cos(angle), math.sin(angle))
            assert place == pytest.approx(complex(block.x, block.y))
            assert math.remainder(turned + angle - block.angle, 2 * math.pi) == pytest.approx(0, abs=1e-9)
        assert f"block{len(scene.blocks)}/pose" not in seen
        np.testing.assert_array_equal(seen["regions"].ravel(), vector[indices["region0.present"] :])
    assert len(counts) > 1


def names_of(entity: composer.Entity) -> list[str]:
    return list(entity.observables.as_dict(fully_qualified=False))


def test_enabled_observables_stay_enabled_for_their_entity() -> None:
    """With its options, for each shape of the block, and after episodes without it; users' observables as well."""
    scenes = [magical_mj.sample_scene("FixColour", "All", seed) for seed in (1, 5, 2)]
    assert [[block.shape for block in scene.blocks] for scene in scenes] == [
        ["circle", "circle", "pentagon"],
        ["pentagon", "square"],
        ["pentagon", "pentagon", "star"],
    ]
    env = magical_mj.load("FixColour", "All", scene=scenes[0], observations=())
    blocks = env.task.root_entity.blocks
    blocks[0].observables.pose.configure(enabled=True, buffer_size=2)
    blocks[2].observables.add_observable(
        "twice", observable.Generic(lambda physics: 2 * blocks[2].observables.pose(physics))
    )
    for scene in scenes:
        seen = env.reset(scene=scene).observation
        assert seen["block0/pose"].shape == env.observation_spec()["block0/pose"].shape == (2, 3)
        assert tuple(seen["block0/pose"][1]) == scene.blocks[0].pose
        assert set(seen) == {"block0/pose"} | ({"block2/twice"} if len(scene.blocks) == 3 else set())
        assert len(scene.blocks) < 3 or tuple(seen["block2/twice"] / 2) == scene.blocks[2].pose


def test_copies_observe_the_same() -> None:
    """Otherwise an error names the observable that cannot be copied."""
    scenes = [magical_mj.sample_scene("FixColour", "All", seed) for seed in (1, 5)]
    env = magical_mj.load("FixColour", "All", scene=scenes[0], observations=("state",))
    arena = env.task.root_entity
    arena.robot.observables.contacts.enabled = True
    arena.blocks[1].observables.pose.configure(enabled=True, corruptor=noises.Additive(distributions.Normal(scale=0.1)))
    arena.observables.top_camera.configure(enabled=True, height=8, width=12)
    env.task.observables["state"].enabled = False
    env.reset()
    twins = [env.clone(), pickle.loads(pickle.dumps(env))]
    expected = env.step(1).observation
    assert expected["top_camera"].shape == (8, 12, 3)
    for twin in twins:
        seen = twin.step(1).observation
        assert seen.keys() == expected.keys()
        for name, values in expected.items():
            np.testing.assert_array_equal(seen[name], values, err_msg=name)
    arena.blocks[2].observables.contact.enabled = True
    env.reset(scene=scenes[1])
    with pytest.raises(StateError, match="'block2/contact' of a block that is not in this episode"):
        env.clone()


def test_contacts_are_the_robots() -> None:
    """Contacts between blocks are not reported. Also with a body without fingers."""
    for body in ("gripper", "longstick"):
        line = [Block("square", "red", 0, y, 0) for y in (0.0, 0.3)]
        env = magical_mj.load_scene(Scene(Robot(0, -0.6, 0, body=body), (*line, Block("star", "blue", 0.8, 0.8, 0))))
        robot, blocks = env.task.root_entity.robot, env.task.root_entity.blocks
        assert ("fingers" in names_of(robot)) == (body == "gripper")
        observed = robot.observables.contacts
        assert not observed(env.physics).any()
        env.reset()
        while env.scene.blocks[1].y < 0.31:  # the first block pushes the second one
            assert not observed(env.physics)[1:].any()
            env.step(10)
        assert observed(env.physics).tolist() == [1] + 9 * [0]
        assert [block.observables.contact(env.physics) for block in blocks] == [1, 0, 0]
        for _ in range(4):
            env.step(2)
        assert not observed(env.physics).any()


def test_composers_options_apply() -> None:
    """Noise, delay, buffer and aggregator give the values that composer defines."""
    env, plain = (magical_mj.load("MoveToCorner", seed=0, observations=()) for _ in range(2))
    pose = env.task.root_entity.robot.observables.pose
    delay = 2 * env.task.physics_steps_per_control_step
    pose.configure(enabled=True, delay=delay, corruptor=noises.Additive(np.array([0.0, 0.5, 0.0])))
    fingers = env.task.root_entity.robot.observables.fingers
    fingers.configure(enabled=True, buffer_size=3, aggregator="mean", update_interval=delay // 2)
    plain.reset()
    seen, true, bent = [env.reset().observation], [plain.scene.robot.pose], [plain.scene.robot.fingers]
    for action in (1, 10, 13, 4, 1, 2):
        seen.append(env.step(action).observation)
        plain.step(action)
        true.append(plain.scene.robot.pose)
        bent.append(plain.scene.robot.fingers)
    assert env.get_state() == plain.get_state()
    for number in range(2, 7):
        np.testing.assert_array_equal(seen[number]["robot/pose"] - true[number - 2], (0.0, 0.5, 0.0))
        np.testing.assert_allclose(seen[number]["robot/fingers"], np.mean(bent[number - 2 : number + 1], axis=0))


def test_too_many_blocks_are_refused_where_observables_have_fixed_shapes() -> None:
    crowd = tuple(Block("circle", "red", 0.3 * (k % 4) - 0.4, 0.3 * (k // 4), 0) for k in range(11))
    env = magical_mj.load_scene(Scene(Robot(0, -0.6, 0), crowd), observations=())
    env.task.root_entity.robot.observables.contacts.enabled = True
    with pytest.raises(InvalidSceneError, match="have 10 rows, and this scene has 11"):
        env.reset()


def test_poses_and_velocities_are_read_and_written_as_of_other_entities() -> None:
    env = magical_mj.load("MoveToCorner", seed=0, observations=())
    block, robot = env.task.root_entity.blocks[0], env.task.root_entity.robot
    env.reset()
    for _ in range(5):
        env.step(1)
    before = env.scene.robot
    env.step(1)
    (x, y, z), quaternion = robot.get_pose(env.physics)
    assert (x, y, z) == (env.scene.robot.x, env.scene.robot.y, 0)
    np.testing.assert_allclose(quaternion, env.physics.bind(robot.root_body).xquat, atol=1e-12)
    linear, angular = robot.get_velocity(env.physics)
    np.testing.assert_allclose(linear / 8, (x - before.x, y - before.y, 0), atol=1e-3)
    assert angular[2] == pytest.approx(0, abs=1e-3)
    block.set_pose(env.physics, (0.5, -0.5, 0), (math.cos(0.2), 0, 0, math.sin(0.2)))
    assert env.scene.blocks[0].pose == pytest.approx((0.5, -0.5, 0.4))
    block.set_velocity(env.physics, (0.0, 2.0, 0), (0, 0, 1))
    env.step(0)
    assert env.scene.blocks[0].y > -0.45  # the block is awake and has moved
    block.shift_pose(env.physics, position=(-0.1, 0, 0))
    assert env.scene.blocks[0].x == pytest.approx(0.4, abs=0.02)
    for wrong in ({"position": (0, 0, 1)}, {"quaternion": (0.7, 0.7, 0, 0)}):
        with pytest.raises(SettingsError, match="block0 moves in the plane"):
            block.set_pose(env.physics, **wrong)
    with pytest.raises(SettingsError, match="block0 moves in the plane"):
        block.set_velocity(env.physics, (0, 0, 1))
