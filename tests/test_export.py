"""Exported MJCF: plain MuJoCo loads it and moves exactly as the environment does."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import magical_mj
from magical_mj.assets.contacts import SUBSTEPS
from magical_mj.assets.robot import control_signal
from magical_mj.errors import InvalidSceneError


def plain(path: Path) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_path(str(path))
    return model, mujoco.MjData(model)


def step(model: mujoco.MjModel, data: mujoco.MjData, action: int) -> None:
    data.ctrl[:] = control_signal(action)
    mujoco.mj_step(model, data, SUBSTEPS)


@pytest.mark.parametrize(("task", "variant"), [pair for pair in magical_mj.ENVIRONMENTS if pair[1] in ("Demo", "All")])
def test_plain_mujoco_moves_as_the_environment(task: str, variant: str, tmp_path: Path) -> None:
    env = magical_mj.load(task, variant, seed=3, observations=())
    env.reset()
    model, data = plain(magical_mj.export_mjcf(env, tmp_path / "world.xml"))
    mujoco.mj_resetDataKeyframe(model, data, 0)
    actions = np.random.default_rng(0).integers(18, size=env.horizon).tolist()
    actions[: env.horizon // 2] = [1, 1, 1, 1, 9, 10, 10, 10, 13, 2][: env.horizon // 2] * (env.horizon // 20)
    for action in actions:
        env.step(action)
        step(model, data, action)
        np.testing.assert_allclose(data.qpos, env.physics.data.qpos, atol=1e-9)


def test_keyframe_is_the_present_state(tmp_path: Path) -> None:
    env = magical_mj.load("FindDupe", "Dynamics", seed=1, observations=())
    env.reset()
    for action in (1, 1, 10, 13, 13):
        env.step(action)
    model, data = plain(magical_mj.export_mjcf(env, tmp_path / "now.xml"))
    mujoco.mj_resetDataKeyframe(model, data, 0)
    np.testing.assert_array_equal(data.qpos, env.physics.data.qpos)
    np.testing.assert_array_equal(data.qvel, env.physics.data.qvel)


def test_reference_pose_is_the_scene(tmp_path: Path) -> None:
    """A viewer that knows nothing of keyframes shows the scene."""
    scene = magical_mj.sample_scene("ClusterShape", "All", 4)
    model, data = plain(magical_mj.export_mjcf(scene, tmp_path / "scene.xml"))
    mujoco.mj_forward(model, data)
    for index, block in enumerate(scene.blocks):
        body = data.body(f"block{index}")
        np.testing.assert_allclose(body.xpos[:2], (block.x, block.y), atol=1e-9)
        np.testing.assert_allclose(body.xmat.reshape(3, 3)[0, 0], np.cos(block.angle), atol=1e-9)
    assert {model.camera(i).name for i in range(model.ncam)} == {"ego", "allo"}


def test_files_are_not_overwritten_without_a_word(tmp_path: Path) -> None:
    scene = magical_mj.sample_scene("MoveToRegion", "Demo", 0)
    path = magical_mj.export_mjcf(scene, tmp_path / "deep" / "scene.xml")
    with pytest.raises(FileExistsError):
        magical_mj.export_mjcf(scene, path)
    assert magical_mj.export_mjcf(scene, path, overwrite=True).read_text().startswith("<mujoco")


def test_illegal_scenes_are_not_exported(tmp_path: Path) -> None:
    scene = magical_mj.sample_scene("MoveToRegion", "Demo", 0).moved(robot=(3, 0, 0))
    with pytest.raises(InvalidSceneError, match="walls"):
        magical_mj.export_mjcf(scene, tmp_path / "scene.xml")
    assert not (tmp_path / "scene.xml").exists()
