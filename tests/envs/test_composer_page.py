"""docs/composer.md: its code runs, and the statements in its tables are true."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("dm_control", reason="dm_control does not install with this Python or MuJoCo")

from dm_control import composer

import magical_mj
from magical_mj.engine import Engine
from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.utils.errors import SettingsError

PAGE = (Path(__file__).parents[2] / "docs" / "composer.md").read_text("utf-8")
CODE = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def rows(heading: str) -> list[list[str]]:
    """The cells of all tables below a heading, without header rows."""
    text = PAGE.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    lines = [line for line in text.splitlines() if line.startswith("|") and "---" not in line]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if "`" in line]


def test_code_runs_in_a_new_process_without_a_display(tmp_path: Path) -> None:
    chosen = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM")
    env = {name: value for name, value in os.environ.items() if name not in chosen}
    paths = [str(Path(magical_mj.__file__).parents[1]), env.get("PYTHONPATH", "")]
    env["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
    program = f"for code in {CODE!r}: exec(code, {{'__name__': '__main__'}})"
    command = [sys.executable, "-W", "ignore", "-c", program]
    result = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def test_the_page_lists_all_observations_with_their_shapes() -> None:
    env = magical_mj.load("FixColour", "All", seed=0, observations=("ego", "allo", "ego_stack", "allo_stack", "state"))
    arena = env.task.root_entity
    listed: dict[str, str] = {}
    for names, shape, _ in rows("Observations"):
        first, *more = re.findall(r"`([^`]+)`", names)
        prefix = first.rpartition(".")[0]
        listed |= {(f"{prefix}." if prefix and "." not in name else "") + name: shape for name in (first, *more)}
    for entity in (arena, arena.robot, arena.blocks[0]):
        entity.observables.enable_all()
    env.reset()
    spec = env.observation_spec()
    where = {"arena": arena, "arena.robot": arena.robot, "arena.blocks[0]": arena.blocks[0]}
    found = {name: spec[name] for name in env.task.task_observables}
    for prefix, entity in where.items():
        keys = entity.observables.dict_keys
        for name in entity.observables.as_dict(fully_qualified=False):
            found[f"{prefix}.observables.{name}"] = spec[getattr(keys, name)]
    assert set(found) == set(listed)
    for name, shape in listed.items():
        assert shape.startswith(str(found[name].shape)), name
        assert found[name].dtype.name in shape or ", " not in shape.replace(str(found[name].shape), ""), name


def test_names_are_those_of_the_model() -> None:
    env = magical_mj.load("FindDupe", seed=0, observations=())
    model = env.physics.model.ptr
    kinds = ("BODY", "JOINT", "GEOM", "CAMERA", "PAIR")
    objects = [getattr(mujoco.mjtObj, f"mjOBJ_{kind}") for kind in kinds[:-1]]
    names = {mujoco.mj_id2name(model, kind, k) for kind in objects for k in range(200)}
    names |= {model.pair(k).name for k in range(model.npair)}
    listed = re.findall(r"`([^`]+)`", " ".join(cell for row in rows("Names") for cell in row[1:]))
    assert len(listed) > 15
    assert set(listed) <= names


Change = Callable[[Any], object]
OWNED: dict[str, Change] = {
    "pos": lambda arena: arena.blocks[0].root_body.set_attributes(pos=(0.1, 0, 0)),
    "ref": lambda arena: arena.robot.joints[0].set_attributes(ref=0.5),
    "frictionloss": lambda arena: arena.blocks[0].joints[2].set_attributes(frictionloss=0.5),
    "ref of a finger": lambda arena: arena.robot.fingers[0].set_attributes(ref=0.1),
    "frictionloss of a tendon": lambda arena: arena.robot.mjcf_model.tendon.fixed[0].set_attributes(frictionloss=0.5),
    "friction": lambda arena: arena.mjcf_model.contact.pair[0].set_attributes(friction=(0.1, 0.1)),
    "rgba": lambda arena: arena.blocks[0].mjcf_model.find("geom", "block0_fill").set_attributes(rgba=[1] * 4),
    "rgba of a region": lambda arena: arena.mjcf_model.deformable.skin[0].set_attributes(rgba=(1, 0, 0, 1)),
    "timestep": lambda arena: arena.mjcf_model.option.set_attributes(timestep=0.005),
}
"""The attribute that the error names first -> a change."""


def test_changes_of_attributes_of_the_scene_are_refused_and_undone() -> None:
    scene = Scene(Robot(0, -0.5, 0), (Block("star", "red", 0, 0, 0),), (GoalRegion("blue", -0.9, 0.1, -0.3, 0.9),))
    env = magical_mj.load_scene(scene, observations=())
    env.reset()
    expected = env.get_state()
    for attribute, change in OWNED.items():
        change(env.task.root_entity)
        with pytest.raises(SettingsError, match="follows from") as error:
            env.reset()
        assert str(error.value).partition(" ")[0] == attribute.partition(" ")[0]
        env.reset()
        assert env.get_state() == expected


def test_an_arena_in_a_task_of_ones_own_has_the_benchmarks_physics() -> None:
    """The page's task, in two episodes."""
    (code,) = (code for code in CODE if "class Approach" in code)
    names: dict[str, Any] = {"__name__": "composer_page"}
    exec(code.partition("\nenv = ")[0], names)
    task = names["Approach"]()
    env = composer.Environment(task, random_state=3)
    scenes = set()
    for _ in range(2):
        env.reset()
        scene = task.root_entity.scene
        scenes.add(scene)
        engine = Engine.of_scene(scene)
        for action in (1, 10, 4, 13, 2, 5):
            timestep = env.step(action)
            engine.step(action)
            assert timestep.reward == -task.distance(env.physics)
        np.testing.assert_array_equal(env.physics.data.ptr.qpos, engine.data.qpos)
        np.testing.assert_array_equal(env.physics.data.ptr.qvel, engine.data.qvel)
    assert len(scenes) == 2


def test_noise_of_an_observable_stays_out_of_poses() -> None:
    env = magical_mj.load("MoveToCorner", seed=0, observations=())
    robot = env.task.root_entity.robot
    robot.observables.pose.configure(enabled=True, corruptor=lambda values, random_state: 2 * values)
    seen = env.reset().observation["robot/pose"]
    np.testing.assert_array_equal(seen, 2 * np.array(env.scene.robot.pose))
    np.testing.assert_array_equal(robot.get_pose(env.physics)[0][:2], env.scene.robot.pose[:2])


def test_changes_of_the_compiled_model_last_until_it_is_compiled_again() -> None:
    """Until the model is compiled again; with a shift that changes the model, until the next reset."""
    scenes = [magical_mj.sample_scene("MoveToCorner", "Shape", seed) for seed in range(6)]
    same = [scene for scene in scenes if scene.blocks[0].shape == scenes[0].blocks[0].shape]
    (other, *_) = (scene for scene in scenes if scene not in same)
    for shifts, kept in ((None, 0.7), ("camera:2", 0.4)):
        env = magical_mj.load("MoveToCorner", "Shape", seed=0, observations=(), shifts=shifts)
        env.reset(scene=same[0])
        wall = env.task.root_entity.mjcf_model.find("geom", "top_wall")
        assert env.physics.bind(wall).friction[0] == 0.4
        env.physics.bind(wall).friction[0] = 0.7
        env.reset(scene=same[-1])
        assert env.physics.bind(wall).friction[0] == kept
        env.reset(scene=other)
        assert env.physics.bind(wall).friction[0] == 0.4
