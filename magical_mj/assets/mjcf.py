"""MJCF text: numbers as attributes, bodies that move in the plane, and the layout of a file for people."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Final
from xml.etree.ElementTree import Comment, Element
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np

from magical_mj.scene import Pose

INDENT: Final = "  "
LINE: Final = 120
"""Characters in a line of a file for people."""
GROUPS: Final = {"vertex": 3, "face": 3}
"""How many numbers of a list belong together, by attribute."""


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


def comment(text: str) -> str:
    """A remark for those who read the model."""
    return f"<!-- {text} -->"


def indented(element: Element, depth: int = 0) -> str:
    """An element as text: one element a line, sections apart, long lists of numbers on lines of their own."""
    pad = INDENT * depth
    if element.tag is Comment:
        return f"{pad}<!-- {str(element.text).strip()} -->\n"
    start = f"{pad}<{element.tag}{_attributes(element, pad)}"
    if not len(element):
        return f"{start}/>\n"
    content = ""
    for child in element:
        is_section = depth == 0 and child.tag is Comment
        content += ("\n" if is_section else "") + indented(child, depth + 1)
    return f"{start}>\n{content}{pad}</{element.tag}>\n"


def _attributes(element: Element, pad: str) -> str:
    """The attributes of an element; what is longer than a line goes on in the next one."""
    text, width, deeper = "", len(pad) + len(str(element.tag)) + 1, pad + 2 * INDENT
    line_break = f"\n{deeper}"
    for name, value in element.items():
        entry = f"{name}={quoteattr(value).replace('&#10;', line_break)}"
        if "\n" not in value and len(deeper) + len(entry) > LINE and value[:1] in "-.0123456789":
            rows = wrap(value, GROUPS.get(name, 1), LINE - len(deeper) - 3)
            entry = f'{name}="{line_break}{line_break.join(rows)}"'
        if width + 3 + len(entry.partition("\n")[0]) > LINE:
            text, width = f"{text}\n{deeper}{entry}", len(deeper) + len(entry)
        else:
            text, width = f"{text} {entry}", width + 1 + len(entry)
    return text


def wrap(value: str, group: int, width: int) -> Iterator[str]:
    """A list of numbers as lines of whole groups."""
    entries = value.split()
    row = ""
    for start in range(0, len(entries), group):
        item = " ".join(entries[start : start + group])
        if row and len(row) + len(item) + 2 > width:
            yield row
            row = ""
        row += ("  " if row and group > 1 else " " if row else "") + item
    yield row
