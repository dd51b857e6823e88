"""Scenes and running episodes as MJCF files that plain MuJoCo loads, and that people can read.

A program needs only such a file to show, play and score an episode: besides the model it holds, under `<custom>`, the
scene, the task and its rules, the horizon and the values of `ctrl` for each of the 18 actions.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, cast
from xml.etree.ElementTree import Comment, Element, SubElement

import mujoco

from magical_mj._version import __version__
from magical_mj.assets import readable
from magical_mj.assets.contacts import SUBSTEPS
from magical_mj.assets.mjcf import elements, numbers, parsed
from magical_mj.assets.region import BONE, region_mjcf
from magical_mj.assets.robot import controls
from magical_mj.assets.world import world_mjcf
from magical_mj.engine.engine import Engine
from magical_mj.scene import Scene
from magical_mj.scene.bodies import body_named
from magical_mj.scene.geometry import check_scene
from magical_mj.shifts.registry import shift_label
from magical_mj.tasks.protocol import PROTOCOL
from magical_mj.tasks.registry import task_spec
from magical_mj.utils import files
from magical_mj.utils.errors import InvalidSceneError, short_repr

HEADER: Final = """<!--
  {what}, as a MuJoCo model. Written by magical-mj {version}.

  View it:     python -m mujoco.viewer -mjcf=FILE
  Play it:     start in keyframe "now"; for each action, write {controls} into ctrl, and call
               mj_step as often as the numeric "substeps" says.

  Units: the workspace is {sides}, seconds, radians; angles are counter-clockwise, and at 0 the robot heads up (+y).
-->
"""
ABOUT: Final = """For programs. "scene": at the start of the episode. "controls": a row for each action, which is
    9 * gripper (0 open, 1 close) + 3 * turn (0 none, 1 left, 2 right) + drive (0 none, 1 forwards, 2 backwards)"""
ABOUT_SPEEDS: Final = """For programs. "scene": at the start of the episode. Actions are speeds: write into ctrl those
    of both wheels (units/s), of both rotors (rad/s) and, with fingers, of both finger motors (rad/s)"""
NUMERIC: Final = ("protocol", "substeps", "horizon")
THINGS: Final = re.compile(r'(?<=[\[,])(?=\{|"(?:robot|blocks|regions|dynamics|pebbles)")')
"""The places where the JSON of a scene is broken into lines, one for each thing."""
BLOCK_PARTS: Final = ("outline", "fill", "sides")
SENSORS: Final = "For plots: where everything is and how fast, in world coordinates"


def export_mjcf(source: Scene | Engine, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Writes a self-contained MJCF model: geometry, dynamics, all cameras, sensors and a keyframe.

    The reference pose of the model is the scene (for an engine: the one in which its episode started), and the
    keyframe "now" is the present state with velocities. From the start of an episode, the model moves exactly as the
    engine does if it is played as the file's header says; from later states, up to rounding.

    Args:
        source: a scene, or an engine at any point of an episode. For an engine, the file also holds task,
            rules and horizon, and variant and seed if the scene was drawn from a seed.
        path: the file to write; its folder is made if missing.
        overwrite: whether an existing file may be replaced.

    Returns:
        The path written.

    Raises:
        InvalidSceneError: if the scene is not legal, or the source is something else.
        ClosedError: if the engine is closed.
        FileExistsError: if the file exists and `overwrite` is false.
        OSError: if it cannot be written.
    """
    path = files.to_path(path)
    text = mjcf_text(source)
    path.parent.mkdir(parents=True, exist_ok=True)
    files.write(path, text, overwrite=overwrite)
    return path


def mjcf_text(source: Scene | Engine, *, rounded: bool = True) -> str:
    """The content of the file that `export_mjcf` writes.

    Args:
        source: as `export_mjcf`.
        rounded: whether coordinates of what is only drawn are rounded, for people who read the file. A program that
            draws as environments do, to the pixel, needs all digits.

    Raises:
        InvalidSceneError, ClosedError: as `export_mjcf`.
    """
    about: dict[str, Any] = {"protocol": PROTOCOL, "substeps": SUBSTEPS}
    if isinstance(source, Scene):
        check_scene(source)
        scene, data = source, mujoco.MjData(mujoco.MjModel.from_xml_string(world_mjcf(source)))
    elif not isinstance(source, Engine):
        raise InvalidSceneError(
            f"a file is made of a Scene or a magical_mj.Engine, not of {short_repr(source)}; "
            "in Gymnasium's environments that is env.unwrapped.engine"
        )
    else:
        scene, data = source.initial_scene, source.data
        drawn = source.seed is not None  # else the scene may be of no variant, or of another one
        about |= {"task": source.task, "variant": source.variant if drawn else None, "seed": source.seed}
        about |= {"shifts": shift_label(source.shifts) or None}
        about |= {"rules": source.rules if source.task else None, "horizon": source.horizon}
    about = {name: value for name, value in about.items() if value is not None}
    return _header(about, 2 * scene.half_width) + readable.indented(_model(scene, about, data, rounded=rounded))


def _header(about: Mapping[str, Any], side: float) -> str:
    """The comment at the top."""
    words = {"task": "{}", "variant": ", variant {}", "seed": ", seed {}"}
    what = "".join(text.format(about[name]) for name, text in words.items() if name in about)
    controls = "its speeds" if _takes_speeds(about) else 'its row of the numeric "controls"'
    return HEADER.format(what=what or "A scene", version=__version__, controls=controls, sides=f"{side:g} x {side:g}")


def _takes_speeds(about: Mapping[str, Any]) -> bool:
    return "task" in about and task_spec(about["task"]).speeds


def _model(scene: Scene, about: Mapping[str, Any], data: mujoco.MjData, *, rounded: bool) -> Element:
    """The model of a scene with everything that only files have: names, comments, sensors, custom data, keyframe."""
    root = parsed(world_mjcf(scene))
    _name_blocks(root, scene)
    _regions_as_geoms(root, scene)
    speeds = _takes_speeds(about)
    root[:0] = [Comment(ABOUT_SPEEDS if speeds else ABOUT), _custom(scene, about, speeds)]
    readable.name_colours(root)
    readable.drop_unused_meshes(root)
    if rounded:
        readable.round_coordinates(root)
    state = {"time": [data.time], "qpos": data.qpos, "qvel": data.qvel, "act": data.act, "ctrl": data.ctrl}
    keyframe = Element("keyframe")
    SubElement(
        keyframe, "key", {"name": "now"} | {name: numbers(*value) for name, value in state.items() if len(value)}
    )
    root[-2:-2] = [Comment(SENSORS), _sensors(scene), Comment("The present state"), keyframe]  # before the meshes
    return root


def _name_blocks(root: Element, scene: Scene) -> None:
    """Adds shape and colour to the names of the blocks' visual geoms."""
    for geom in root.iter("geom"):
        name, _, part = geom.get("name", "").partition("_")
        if name.startswith("block") and part in BLOCK_PARTS:
            block = scene.blocks[int(name.removeprefix("block"))]
            geom.set("name", f"{name}_{block.colour}_{block.shape}_{part}")


def _regions_as_geoms(root: Element, scene: Scene) -> None:
    """Replaces the regions' skins, which environments modify from scene to scene, by geoms."""
    paths = ("deformable", "asset[last()]", f".//body[@name='{BONE}']")
    skins, assets, body = (cast("Element", root.find(path)) for path in paths)
    root.remove(skins)
    for index, region in enumerate(scene.regions):
        mesh, *geoms = elements("".join(region_mjcf(index, region)))
        assets.append(mesh)
        body.append(Comment(f"Goal region {index}: {region.colour}"))
        body.extend(geoms)


def _custom(scene: Scene, about: Mapping[str, Any], speeds: bool) -> Element:
    """The `<custom>` element: the data that programs need besides the model."""
    custom = Element("custom")
    for name, value in about.items():
        SubElement(custom, "numeric" if name in NUMERIC else "text", {"name": name, "data": str(value)})
    SubElement(custom, "text", {"name": "scene", "data": "\n" + THINGS.sub("\n", scene.to_json())})
    if not speeds:
        rows = (numbers(*row) for row in controls(scene.robot.body, scene.dynamics.veer))
        SubElement(custom, "numeric", {"name": "controls", "data": "\n" + "\n".join(rows)})
    return custom


def _sensors(scene: Scene) -> Element:
    """The `<sensor>` element: value and velocity of each coordinate of the robot, its fingers, blocks and pebbles."""
    bodies = ["robot", *(f"block{index}" for index in range(len(scene.blocks)))]
    bodies += [f"pebble{index}" for index in range(len(scene.pebbles))]
    joints = [f"{body}_{axis}" for body in bodies for axis in ("x", "y", "angle")]
    if body_named(scene.robot.body).fingers:
        joints[3:3] = ["left_finger", "right_finger"]
    sensor = Element("sensor")
    for kind, suffix in (("jointpos", ""), ("jointvel", "_velocity")):
        for joint in joints:
            SubElement(sensor, kind, {"name": f"{joint}{suffix}", "joint": joint})
    return sensor
