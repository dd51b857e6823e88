"""MJCF text: numbers as attributes, and bodies that move in the plane."""

from __future__ import annotations

import math
from collections.abc import Iterable

import mujoco
import numpy as np

from magical_mj.scene import Pose


def numbers(*values: float) -> str:
    """Numbers as an MJCF attribute, with as few digits as still give the same doubles."""
    return " ".join(repr(float(value)).removesuffix(".0") for value in values)


def single(values: Iterable[float]) -> str:
    """Numbers that MuJoCo keeps in single precision, likewise."""
    return " ".join(str(np.float32(value)).removesuffix(".0") for value in values)


def quaternion(angle: float) -> tuple[float, float, float, float]:
    """A turn about z by `angle` (rad), as w, x, y, z."""
    return math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)


def slide_axes(angle: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """The world's x and y axis in the frame of a body that is turned by `angle` (rad)."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return (cosine, -sine, 0.0), (sine, cosine, 0.0)


def planar_body(name: str, pose: Pose, content: str, hinge: str = "") -> str:
    """A body that stands at `pose` and slides and turns in the plane.

    Its joints `<name>_x`, `<name>_y` and `<name>_angle` read world coordinates, and its reference position is the
    pose, so that a viewer which knows nothing of keyframes shows it in its place.

    Args:
        name: of the body.
        pose: x, y, angle.
        content: what is in the body.
        hinge: more attributes of the hinge.
    """
    x, y, angle = pose
    x_axis, y_axis = slide_axes(angle)
    return (
        f'<body name="{name}" pos="{numbers(x, y, 0)}" quat="{numbers(*quaternion(angle))}">'
        f'<joint name="{name}_x" type="slide" axis="{numbers(*x_axis)}" ref="{numbers(x)}"/>'
        f'<joint name="{name}_y" type="slide" axis="{numbers(*y_axis)}" ref="{numbers(y)}"/>'
        f'<joint name="{name}_angle" type="hinge" axis="0 0 1" ref="{numbers(angle)}" {hinge}/>'
        f"{content}</body>"
    )


def move_body(model: mujoco.MjModel, name: str, pose: Pose) -> None:
    """Change where a planar body of a compiled model stands, as if compiled there."""
    body = model.body(name).id
    joint = model.body_jntadr[body]
    model.body_pos[body, :2] = pose[:2]
    model.body_quat[body] = quaternion(pose[2])
    model.jnt_axis[joint : joint + 2] = slide_axes(pose[2])
    first = model.jnt_qposadr[joint]
    model.qpos0[first : first + 3] = pose


def bend_body(model: mujoco.MjModel, name: str, angle: float) -> None:
    """Change the reference angle of a body with one hinge, likewise."""
    body = model.body(name).id
    model.body_quat[body] = quaternion(angle)
    first = model.jnt_qposadr[model.body_jntadr[body]]
    model.qpos0[first] = angle
