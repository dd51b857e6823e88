"""What users of composer may do to an environment: hooks, and changes of its MJCF tree."""

from __future__ import annotations

import numpy as np

import magical_mj
from magical_mj.scene import Block, Robot, Scene
from magical_mj.scene.actions import Action, Drive
from magical_mj.scene.state_vector import STATE_NAMES


def test_composer_hooks_of_users_run() -> None:
    """Substep hooks still see every substep, and the physics does not change by it."""
    env, twin = (magical_mj.load("MatchRegions", seed=0, observations=("state",)) for _ in range(2))
    calls = []
    env.add_extra_hook("before_substep", lambda physics, action, random_state: calls.append(physics.time()))
    env.add_extra_hook("initialize_episode", lambda physics, random_state: calls.append("episode"))
    for one in (env, twin):
        one.reset()
        seen = one.step(Action(drive=Drive.FORWARD))
    assert calls[0] == "episode"
    assert len(calls) == 1 + env.task.physics_steps_per_control_step
    for there, expected in zip(env.scene.blocks, twin.scene.blocks, strict=True):
        np.testing.assert_allclose(there.pose, expected.pose, atol=1e-9)
    np.testing.assert_allclose(env.scene.robot.pose, twin.scene.robot.pose, atol=1e-9)
    assert seen.observation["state"].shape == (len(STATE_NAMES),)


def test_changes_to_the_mjcf_tree_are_compiled() -> None:
    """Whoever edits the composer entity's MJCF before an episode gets what they wrote."""
    env = magical_mj.load_scene(Scene(Robot(0, 0, 0), (Block("square", "red", 0.5, 0.5, 0),)), observations=())

    def add_site(random_state: object) -> None:
        del random_state
        root = env.task.root_entity.mjcf_model
        if root.find("site", "mark") is None:
            root.worldbody.add("site", name="mark", pos=(0.1, 0.2, 0))

    env.add_extra_hook("initialize_episode_mjcf", add_site)
    env.reset()
    np.testing.assert_allclose(env.physics.named.data.site_xpos["mark"], [0.1, 0.2, 0])
