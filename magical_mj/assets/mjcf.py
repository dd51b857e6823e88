"""MJCF text: numbers as attributes, and planar bodies."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Final
from xml.etree.ElementTree import Element, TreeBuilder, XMLParser, fromstring

import numpy as np

from magical_mj.scene import Pose
from magical_mj.scene.geometry import quaternion, slide_axes

AXES: Final = ("x", "y", "angle")
"""The joints of a planar body are named after the body, with one of these appended."""


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


def parsed(text: str) -> Element:
    """Parses MJCF text of this package, and keeps its comments."""
    return fromstring(text, XMLParser(target=TreeBuilder(insert_comments=True)))  # noqa: S314


def elements(text: str) -> list[Element]:
    """Parses MJCF text with several elements in sequence."""
    return list(parsed(f"<mujoco>{text}</mujoco>"))


def comment(text: str) -> str:
    """An XML comment."""
    return f"<!-- {text} -->"
