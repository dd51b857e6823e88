"""Scenes and running environments as MJCF files that plain MuJoCo loads."""

from __future__ import annotations

import os
from pathlib import Path

import mujoco

from magical_mj.assets.world import keyframe_mjcf, world_mjcf
from magical_mj.environment import Environment
from magical_mj.geometry import check_scene
from magical_mj.scene import Scene


def export_mjcf(source: Scene | Environment, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Writes a self-contained MJCF model: the scene, its dynamics, both cameras and a keyframe.

    The reference pose of the model is the scene (of an environment: the one its episode started in), and the
    keyframe "now" its present state, velocities included. The file needs no other file. Its controls are those
    of `magical_mj.assets.robot.control_signal`; one action is `magical_mj.assets.world.SUBSTEPS` calls of `mj_step`.

    Args:
        source: a scene, or an environment at any point of an episode.
        path: the file to write; its folder is made if missing.
        overwrite: whether an existing file may be replaced.

    Returns:
        The path written.

    Raises:
        InvalidSceneError: if the scene is not legal.
        FileExistsError: if the file exists and `overwrite` is false.
        OSError: if it cannot be written.
    """
    if isinstance(source, Scene):
        check_scene(source)
        model = mujoco.MjModel.from_xml_string(world_mjcf(source))
        text = world_mjcf(source, keyframe_mjcf(mujoco.MjData(model)))
    else:
        text = world_mjcf(source.initial_scene, keyframe_mjcf(source.physics.data.ptr))
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w" if overwrite else "x", encoding="utf-8") as file:
        file.write(text)
    return path
