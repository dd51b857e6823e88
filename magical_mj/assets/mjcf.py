"""MJCF text: numbers as attributes, and planar bodies."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable
from typing import Final
from xml.etree.ElementTree import Element, TreeBuilder, XMLParser, fromstring

import mujoco
import numpy as np

from magical_mj.scene import Pose
from magical_mj.utils.errors import SettingsError

AXES: Final = ("x", "y", "angle")
"""The joints of a planar body are named after the body, with one of these appended."""
_KINDS: Final = {name.removeprefix("mjOBJ_").lower(): kind.value for name, kind in mujoco.mjtObj.__members__.items()}
"""Kind of object -> MuJoCo's number for it. Reading the enum takes longer than finding an object."""


def numbers(*values: float) -> str:
    """Numbers as an MJCF attribute, with the fewest digits that parse to the same doubles.

    Numbers below the smallest normal double become 0, since MuJoCo's reader refuses them.
    """
    return " ".join(repr(_readable(float(value), sys.float_info.min)).removesuffix(".0") for value in values)


def single(values: Iterable[float]) -> str:
    """Numbers that MuJoCo stores in single precision as an MJCF attribute, with the fewest digits."""
    smallest = float(np.finfo(np.float32).tiny)
    with np.errstate(all="ignore"):  # values may underflow
        return " ".join(str(np.float32(_readable(float(value), smallest))).removesuffix(".0") for value in values)


def _readable(value: float, smallest: float) -> float:
    return 0.0 if 0 < abs(value) < smallest else value


def quaternion(angle: float) -> tuple[float, float, float, float]:
    """The rotation about z by `angle` (rad) as a quaternion w, x, y, z."""
    return math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)


def slide_axes(angle: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """The x and y axes of the world frame, in the frame of a body rotated by `angle` (rad)."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return (cosine, -sine, 0.0), (sine, cosine, 0.0)


def planar_body(name: str, pose: Pose, content: str, hinge: str = "") -> str:
    """A body at `pose` with two slide joints and a hinge, so that it moves in the plane.

    The values of its joints `<name>_x`, `<name>_y` and `<name>_angle` are world coordinates. The pose is also the
    reference pose, so that viewers that ignore keyframes show the body there.

    Args:
        name: the body's name.
        pose: x, y (world units) and angle (rad).
        content: the elements in the body, as MJCF.
        hinge: additional attributes of the hinge.
    """
    x, y, angle = pose
    x_axis, y_axis = slide_axes(angle)
    return (
        f'<body name="{name}" pos="{numbers(x, y, 0)}" quat="{numbers(*quaternion(angle))}">'
        f'<joint name="{name}_x" type="slide" axis="{numbers(*x_axis)}" ref="{numbers(x)}"/>'
        f'<joint name="{name}_y" type="slide" axis="{numbers(*y_axis)}" ref="{numbers(y)}"/>'
        f'<joint name="{name}_angle" {hinge} type="hinge" axis="0 0 1" ref="{numbers(angle)}"/>'
        f"{content}</body>"
    )


def planar_name(name: str, scope: str) -> str:
    """The name of a planar body's joint in a compiled model.

    Args:
        name: the joint's name.
        scope: "", or the prefix of names, such as "block0/", if dm_control attached the body as a model of its own.
            dm_control puts the planar joints into the attachment frame, and appends "/" to names in that frame.
    """
    return f"{scope}{name}/" if scope else name


def index_of(model: mujoco.MjModel, kind: str, name: str) -> int:
    """The index of an object in a compiled model. Faster than the model's own accessors.

    Args:
        model: a compiled model.
        kind: "joint", "geom" and so on, as in `mujoco.mjtObj`.
        name: the object's name.

    Raises:
        SettingsError: if no object has this name: users of a composer environment can remove elements.
    """
    index = mujoco.mj_name2id(model, _KINDS[kind], name)
    if index < 0:
        raise SettingsError(
            f"the MJCF tree lacks the {kind} {name!r}, which its scene needs: do not remove or rename it"
        )
    return index


def move_body(model: mujoco.MjModel, name: str, pose: Pose, scope: str = "") -> None:
    """Writes the reference pose of a planar body into a compiled model, with the same result as compiling.

    For `scope`, see `planar_name`.
    """
    joints = [index_of(model, "joint", planar_name(f"{name}_{axis}", scope)) for axis in AXES]
    body = model.jnt_bodyid[joints[0]]
    model.body_pos[body, :2] = pose[:2]
    model.body_quat[body] = quaternion(pose[2])
    model.jnt_axis[joints[:2]] = slide_axes(pose[2])
    model.qpos0[model.jnt_qposadr[joints]] = pose


def bend_body(model: mujoco.MjModel, name: str, angle: float) -> None:
    """Writes the reference angle of a body with one hinge into a compiled model. The hinge has the body's name."""
    joint = index_of(model, "joint", name)
    model.body_quat[model.jnt_bodyid[joint]] = quaternion(angle)
    model.qpos0[model.jnt_qposadr[joint]] = angle


def parsed(text: str) -> Element:
    """Parses MJCF text of this package, and keeps its comments."""
    return fromstring(text, XMLParser(target=TreeBuilder(insert_comments=True)))  # noqa: S314


def elements(text: str) -> list[Element]:
    """Parses MJCF text with several elements in sequence."""
    return list(parsed(f"<mujoco>{text}</mujoco>"))


def comment(text: str) -> str:
    """An XML comment."""
    return f"<!-- {text} -->"
