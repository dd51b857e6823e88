"""Exports scenes and running episodes as readable MJCF files that plain MuJoCo loads.

Such a file is enough to show, play and score an episode. Besides the model, its element `<custom>` holds the scene, the
task and its rules, the horizon, and the values of `ctrl` for each of the 18 actions.

The text is made readable: materials instead of colours, no unused meshes, rounded coordinates, indented lines. None of
this changes the dynamics. A program that must draw exactly the environment's pictures should not round: rounding moves
visual coordinates by up to 5e-7 units, which changes a few pixels.
"""

from __future__ import annotations

import contextlib
import os
import re
import textwrap
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, cast
from xml.etree.ElementTree import Comment, Element, SubElement
from xml.sax.saxutils import quoteattr

import mujoco

from magical_mj._version import __version__
from magical_mj.assets.contacts import SUBSTEPS
from magical_mj.assets.mjcf import elements, numbers, parsed
from magical_mj.assets.region import BONE, region_mjcf
from magical_mj.assets.robot import controls
from magical_mj.assets.scene_mjcf import scene_mjcf
from magical_mj.assets.style import MATERIALS, rgba
from magical_mj.engine.engine import Engine
from magical_mj.engine.simulation import Simulation, different_numbers
from magical_mj.protocol import PROTOCOL
from magical_mj.scene import Scene
from magical_mj.scene.bodies import body_named
from magical_mj.scene.constants import SHAPES
from magical_mj.scene.geometry import check_scene
from magical_mj.shifts.registry import shift_label
from magical_mj.tasks.registry import task_spec
from magical_mj.utils import files
from magical_mj.utils.errors import InvalidSceneError, SettingsError, as_integer, short_repr

HEADER: Final = """<!--
  {title}, as a MuJoCo model. Written by magical-mj {version}.

  View it:     python -m mujoco.viewer -mjcf=FILE
  Play it:     start in the keyframe "now". For each action, write {controls} into ctrl,
               and call mj_step as many times as the numeric "substeps" says.

  Units: the workspace is {sides}; seconds; radians. Angles are counter-clockwise; at 0 the robot heads up (+y).
-->
"""
ABOUT: Final = """For programs. "scene": the initial scene. "controls": a row for each action. The actions are
    9 * gripper (0 open, 1 close) + 3 * turn (0 none, 1 left, 2 right) + drive (0 none, 1 forwards, 2 backwards)"""
ABOUT_SPEEDS: Final = """For programs. "scene": the initial scene. Actions are speeds: write into ctrl the speeds of
    both wheels (units/s), of both rotors (rad/s) and, with fingers, of both finger motors (rad/s)"""
NUMERIC: Final = ("protocol", "substeps", "horizon")
LINE_BREAKS: Final = re.compile(r'(?<=[\[,])(?=\{|"(?:robot|blocks|regions|dynamics|pebbles)")')
"""Positions of line breaks in the JSON of a scene: one line for each object."""
BLOCK_PARTS: Final = ("outline", "fill", "sides")
PICTURES: Final = "cam_", "geom_rgba", "skin_rgba"
"""The beginnings of the names of a model's arrays that only pictures depend on."""
SENSORS: Final = "For plots: positions and velocities, in world coordinates"


def export_mjcf(source: Any, path: str | os.PathLike[str], *, overwrite: bool = False, index: int = 0) -> Path:
    """Writes a self-contained MJCF model: geometry, dynamics, all cameras, sensors and a keyframe.

    The model's reference poses are those of the scene, or of an episode's initial scene. The keyframe "now" is the
    current state, with velocities. Played as the file's header says, the model moves exactly as the engine does from
    the start of an episode, and up to rounding from later states.

    Args:
        source: a scene; or an engine or environment at any point of an episode: a Gymnasium environment, wrapped or
            not, a composer environment, or a vector environment. For an episode, the file also holds task, rules and
            horizon. If the scene was drawn from a seed, it also holds variant and seed.
        path: the file to write. Missing folders are created.
        overwrite: whether an existing file may be replaced.
        index: the index of the environment in a vector environment.

    Returns:
        The path written.

    Raises:
        InvalidSceneError: if the scene is illegal, or the source has another type.
        SettingsError: if users have changed the model of a composer environment (dm_control can export its tree); if
            the physics of the model was changed by hand, or by the method `model` of a shift, which files cannot
            contain; or if a vector environment has no environment with this index.
        ClosedError: if the engine or environment is closed.
        FileExistsError: if the file exists and `overwrite` is false.
        OSError: if the file cannot be written.
    """
    path = files.to_path(path)
    text = mjcf_text(_scene_or_engine(source, index))
    path.parent.mkdir(parents=True, exist_ok=True)
    files.write(path, text, overwrite=overwrite)
    return path


def mjcf_text(source: Scene | Engine, *, rounded: bool = True) -> str:
    """The content of the file that `export_mjcf` writes.

    Args:
        source: a scene, or the engine of an episode.
        rounded: whether coordinates of visual geoms are rounded, which makes the file easier to read. A program that
            must draw exactly the environment's pictures needs all digits.

    Raises:
        InvalidSceneError: if the scene is illegal.
        SettingsError: if the physics of the engine's model was changed.
        ClosedError: if the engine is closed.
    """
    about: dict[str, Any] = {"protocol": PROTOCOL, "substeps": SUBSTEPS}
    if isinstance(source, Scene):
        check_scene(source)
        scene, data = source, mujoco.MjData(mujoco.MjModel.from_xml_string(scene_mjcf(source)))
    else:
        scene, data = source.initial_scene, source.data
        _check_physics(source)
        about |= {
            "task": source.task,
            "variant": None if source.seed is None else source.variant,  # a user's scene may belong to none
            "seed": source.seed,
            "shifts": shift_label(source.shifts) or None,
            "rules": source.rules if source.task else None,
            "horizon": source.limit,
        }
        about = {name: value for name, value in about.items() if value is not None}
    return _header(about, 2 * scene.half_width) + _indented(_model(scene, about, data, rounded=rounded))


def _check_physics(engine: Engine) -> None:
    """Raises a `SettingsError` if the model's physics is not that of the scene."""
    differing = different_numbers(engine.model, Simulation.of(engine.initial_scene).model)
    if changes := [name for name in differing if not name.startswith(PICTURES)]:
        raise SettingsError(
            f"the engine's model was changed ({', '.join(changes[:5])}), by a shift or by hand, and a file would "
            "contain only the scene"
        )


def _scene_or_engine(source: Any, index: int) -> Scene | Engine:
    """The scene or engine to export. Environments are exported by their engine."""
    if isinstance(source, Scene | Engine):
        return source
    env = getattr(source, "unwrapped", source)
    if hasattr(env, "num_envs"):
        number = as_integer(index, 0, env.num_envs - 1)
        if number is None:
            raise SettingsError(
                f"index must be that of one of the {env.num_envs} environments, 0 to {env.num_envs - 1}, not {index}"
            )
        with contextlib.suppress(AttributeError):
            env = env.get_attr("engine")[number]
    elif hasattr(env, "to_engine"):
        env = env.to_engine()
    engine = env if isinstance(env, Engine) else getattr(env, "engine", None)
    if not isinstance(engine, Engine):
        raise InvalidSceneError(
            "only a magical_mj.Scene, a magical_mj.Engine or an environment that runs one can be exported, not "
            f"{short_repr(source)}"
        )
    return engine


def _header(about: Mapping[str, Any], side: float) -> str:
    """The comment at the top of the file."""
    words = {"task": "{}", "variant": ", variant {}", "seed": ", seed {}"}
    title = "".join(text.format(about[name]) for name, text in words.items() if name in about)
    controls = "its speeds" if _takes_speeds(about) else 'its row of the numeric "controls"'
    return HEADER.format(title=title or "A scene", version=__version__, controls=controls, sides=f"{side:g} x {side:g}")


def _takes_speeds(about: Mapping[str, Any]) -> bool:
    return "task" in about and task_spec(about["task"]).speeds


def _model(scene: Scene, about: Mapping[str, Any], data: mujoco.MjData, *, rounded: bool) -> Element:
    """The model of a scene, and what only files have: descriptive names, comments, sensors, custom data, a keyframe."""
    root = parsed(scene_mjcf(scene))
    _name_blocks(root, scene)
    _regions_as_geoms(root, scene)
    speeds = _takes_speeds(about)
    root[:0] = [Comment(ABOUT_SPEEDS if speeds else ABOUT), _custom(scene, about, speeds)]
    _name_colours(root)
    _drop_unused_meshes(root)
    if rounded:
        _round_coordinates(root)
    state = {"time": [data.time], "qpos": data.qpos, "qvel": data.qvel, "act": data.act, "ctrl": data.ctrl}
    keyframe = Element("keyframe")
    SubElement(
        keyframe, "key", {"name": "now"} | {name: numbers(*value) for name, value in state.items() if len(value)}
    )
    root[-2:-2] = [Comment(SENSORS), _sensors(scene), Comment("The current state"), keyframe]  # before the meshes
    return root


def _name_blocks(root: Element, scene: Scene) -> None:
    """Adds shape and colour to the names of the blocks' visual geoms."""
    for geom in root.iter("geom"):
        name, _, part = geom.get("name", "").partition("_")
        if name.startswith("block") and part in BLOCK_PARTS:
            block = scene.blocks[int(name.removeprefix("block"))]
            geom.set("name", f"{name}_{block.colour}_{block.shape}_{part}")


def _regions_as_geoms(root: Element, scene: Scene) -> None:
    """Replaces the regions' skins by geoms. Only environments need skins, since they change the regions."""
    paths = ("deformable", "asset[last()]", f".//body[@name='{BONE}']")
    skins, assets, body = (cast("Element", root.find(path)) for path in paths)
    root.remove(skins)
    for index, region in enumerate(scene.regions):
        mesh, *geoms = elements("".join(region_mjcf(index, region)))
        assets.append(mesh)
        body.append(Comment(f"Goal region {index}: {region.colour}"))
        body.extend(geoms)


def _custom(scene: Scene, about: Mapping[str, Any], speeds: bool) -> Element:
    """The element `<custom>`: data that programs need in addition to the model."""
    custom = Element("custom")
    for name, value in about.items():
        SubElement(custom, "numeric" if name in NUMERIC else "text", {"name": name, "data": str(value)})
    SubElement(custom, "text", {"name": "scene", "data": "\n" + LINE_BREAKS.sub("\n", scene.to_json())})
    if not speeds:
        rows = (numbers(*row) for row in controls(scene.robot.body, scene.dynamics.veer))
        SubElement(custom, "numeric", {"name": "controls", "data": "\n" + "\n".join(rows)})
    return custom


def _sensors(scene: Scene) -> Element:
    """The element `<sensor>`: value and velocity of each coordinate of the robot, its fingers, blocks and pebbles."""
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


DECIMALS: Final = 6
"""The number of decimals of visual coordinates, in world units."""
ROUNDED: Final = """Coordinates of visual geoms are rounded to 6 decimals. Outlines of blocks are not rounded: a block
    sleeps below a speed that depends on its size. Numbers of the physics have all digits"""
DRAWN: Final = ("visual", "solid")
"""The classes of visual geoms."""
FARTHEST: Final = tuple(f"{kind}_outline" for kind in (*SHAPES, "pebble"))
"""The meshes of geoms that reach farthest from the centre of a body with a hinge."""
COORDINATES: Final = ("pos", "quat", "size")
"""The attributes of geoms that are coordinates."""

INDENT: Final = "  "
LINE: Final = 120
"""The longest line of an indented file, in characters."""
GROUPS: Final = {"vertex": 3, "face": 3}
"""Attribute -> how many of its numbers form one entry, such as the 3 coordinates of a vertex."""


def _name_colours(root: Element) -> None:
    """Replaces the colours of geoms by materials, and adds those materials to the assets."""
    names = {rgba(rgb): name for name, rgb in MATERIALS.items()}
    used = set[str]()
    for geom in root.iter("geom"):
        colour = geom.attrib.pop("rgba", None)
        if colour is not None:
            geom.set("material", names[colour])
            used.add(names[colour])
    assets = cast("Element", root.find("asset"))
    for name, rgb in MATERIALS.items():
        if name in used:
            SubElement(assets, "material", {"name": name, "rgba": rgba(rgb)})


def _drop_unused_meshes(root: Element) -> None:
    """Removes the meshes that no geom uses."""
    used = {geom.get("mesh") for geom in root.iter("geom")}
    for assets in root.iter("asset"):
        for mesh in assets.findall("mesh"):
            if mesh.get("name") not in used:
                assets.remove(mesh)


def _round_coordinates(root: Element) -> None:
    """Rounds the coordinates of visual geoms, and adds a comment about it before `worldbody`.

    The geom that reaches farthest from the centre of a body with a hinge is not rounded. MuJoCo takes this distance as
    the body's size, and a body sleeps once it turns slower than a limit that depends on its size.
    """
    for mesh in root.iter("mesh"):
        if mesh.get("name") not in FARTHEST:
            _round(mesh, "vertex")
    for geom in root.iter("geom"):
        if geom.get("class") in DRAWN:
            for name in COORDINATES:
                _round(geom, name)
    index = list(root).index(cast("Element", root.find("worldbody")))
    root.insert(index, Comment(ROUNDED))


def _round(element: Element, name: str) -> None:
    if name in element.attrib:
        element.set(name, numbers(*(round(float(word), DECIMALS) + 0.0 for word in element.attrib[name].split())))


def _indented(element: Element, depth: int = 0) -> str:
    """Indented text: one element per line, blank lines between sections, long lists of numbers wrapped."""
    pad = INDENT * depth
    if element.tag is Comment:
        return f"{pad}<!-- {str(element.text).strip()} -->\n"
    start = f"{pad}<{element.tag}{_attributes(str(element.tag), tuple(element.items()), pad)}"
    if not len(element):
        return f"{start}/>\n"
    content, before = "", None
    for child in element:
        is_section = depth == 0 and child.tag is Comment and before is not Comment
        content += ("\n" if is_section else "") + _indented(child, depth + 1)
        before = child.tag
    return f"{start}>\n{content}{pad}</{element.tag}>\n"


@lru_cache(maxsize=4096)  # most elements of a scene are those of the last one
def _attributes(tag: str, attributes: Sequence[tuple[str, str]], pad: str) -> str:
    """The attributes of an element; lines that would be too long are wrapped."""
    text, width, deeper = "", len(pad) + len(tag) + 1, pad + 2 * INDENT
    line_break = f"\n{deeper}"
    for name, value in attributes:
        entry = f"{name}={quoteattr(value).replace('&#10;', line_break)}"
        if "\n" not in value and len(deeper) + len(entry) > LINE and value[:1] in "-.0123456789":
            rows = _wrapped(value, GROUPS.get(name, 1), LINE - len(deeper) - 3)
            entry = f'{name}="{line_break}{line_break.join(rows)}"'
        if width + 3 + len(entry.partition("\n")[0]) > LINE:
            text, width = f"{text}\n{deeper}{entry}", len(deeper) + len(entry)
        else:
            text, width = f"{text} {entry}", width + 1 + len(entry)
    return text


def _wrapped(value: str, group: int, width: int) -> list[str]:
    """The lines of a wrapped list of numbers. Two spaces separate groups, which are never split."""
    if group == 1:
        return textwrap.wrap(value, width - 1, break_on_hyphens=False)
    entries = value.split()
    groups = ("_".join(entries[start : start + group]) for start in range(0, len(entries), group))
    lines = textwrap.wrap("  ".join(groups), width, break_on_hyphens=False)
    return [line.replace("_", " ") for line in lines]
