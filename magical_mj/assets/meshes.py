"""Flat meshes: what the visual geoms of all models show, made once.

Every model lists the same meshes in the same order, used or not: so one drawing context serves them all.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from magical_mj import constants as c
from magical_mj.assets import style
from magical_mj.assets.mjcf import single
from magical_mj.constants import SHAPES, Shape
from magical_mj.geometry import block_outline, finger_outlines, mirrored, regular_polygon

Points = NDArray[np.float64]
"""Shape (n, 2), world units, counter-clockwise."""
Faces = NDArray[np.int64]
"""Shape (m, 3): triangles of points, by index."""
Mesh = tuple[Points, Faces]

CIRCLE_SIDES, ROBOT_SIDES, EYE_SIDES, PUPIL_SIDES = 32, 40, 16, 10
SURROUND_HALF = 3.2  # world units: reaches beyond what the ego camera sees from any corner


def disc(sides: int, radius: float) -> Points:
    """A regular polygon with the area of the circle of this radius."""
    return regular_polygon(sides, radius * float(np.sqrt(2 * np.pi / sides / np.sin(2 * np.pi / sides))))


def square(half: float) -> Points:
    """Corners of the square of this half side, counter-clockwise."""
    return half * np.array([[1.0, 1], [-1, 1], [-1, -1], [1, -1]])


def convex(points: Points) -> Mesh:
    """A convex polygon, cut by halving its arcs: stout triangles are filled faster than the slivers of a fan."""

    def cut(first: int, last: int) -> list[tuple[int, int, int]]:
        if last - first < 2:
            return []
        middle = (first + last) // 2
        return [(first, middle, last), *cut(first, middle), *cut(middle, last)]

    third, n = len(points) / 3, len(points)
    a, b = round(third), round(2 * third)
    faces = [(0, a, b), *cut(0, a), *cut(a, b), *((i, j, k % n) for i, j, k in cut(b, n))]
    return points, np.array(faces)


def around_centre(points: Points) -> Mesh:
    """A star-shaped polygon as a fan around the origin."""
    steps = np.arange(1, len(points) + 1)
    return np.vstack([np.zeros((1, 2)), points]), np.stack([0 * steps, steps, np.roll(steps, -1)], axis=1)


def frame(inner: float, outer: float) -> Mesh:
    """A square frame between two half sides."""
    k = np.arange(4)
    n = np.roll(k, -1)
    faces = np.vstack([np.stack([k, k + 4, n + 4], axis=1), np.stack([k, n + 4, n], axis=1)])
    return np.vstack([square(inner), square(outer)]), faces


def together(parts: Iterable[Mesh]) -> Mesh:
    """Several flat meshes as one."""
    vertices, faces, count = [], [], 0
    for points, triangles in parts:
        vertices.append(points)
        faces.append(triangles + count)
        count += len(points)
    return np.vstack(vertices), np.vstack(faces)


def inset(outline: Points, depth: float) -> Points:
    """The outline with every edge moved inwards by `depth`. Shape (n, 2)."""
    before, after = outline - np.roll(outline, 1, axis=0), np.roll(outline, -1, axis=0) - outline
    normals = [
        np.stack([-e[:, 1], e[:, 0]], axis=1) / np.linalg.norm(e, axis=1, keepdims=True) for e in (before, after)
    ]
    bisector = normals[0] + normals[1]
    return outline + depth * bisector / np.sum(bisector * normals[0], axis=1, keepdims=True)


def _block(shape: Shape, depth: float) -> Mesh:
    """The drawn outline of a block, moved inwards by `depth`."""
    if shape == "circle":
        return convex(disc(CIRCLE_SIDES, c.BLOCK_SIZE - depth))
    if shape == "star":  # the original shrinks both radii
        outline = block_outline(shape)
        return around_centre(outline * (1 - depth / np.linalg.norm(outline, axis=1, keepdims=True)))
    return convex(inset(block_outline(shape), depth))


def _finger(sign: int, depth: float) -> Mesh:
    """Upper segment and forearm of the right (sign 1) or left (sign -1) finger, moved inwards by `depth`."""
    outlines = (outline if sign > 0 else mirrored(outline) for outline in finger_outlines())
    return together(convex(inset(outline, depth)) for outline in outlines)


def _pair(points: Points, x: float, y: float) -> Mesh:
    """The same convex polygon at (-x, y) and (x, y)."""
    return together(convex(points + np.array([side * x, y])) for side in (-1, 1))


@cache
def library() -> str:
    """The shared meshes of every model, as MJCF."""
    half = c.ARENA_HALF_WIDTH
    line = style.ARENA_BORDER_WIDTH / 2
    meshes = {
        "floor": convex(square(half)),  # floor and surround meet under the border line
        "surround": frame(half, SURROUND_HALF),
        "border": frame(half - line, half + line),
        "robot_outline": convex(disc(ROBOT_SIDES, c.ROBOT_RADIUS)),
        "robot_fill": convex(disc(ROBOT_SIDES, c.ROBOT_RADIUS - style.ROBOT_OUTLINE_WIDTH)),
        "eyes": _pair(disc(EYE_SIDES, c.EYE_RADIUS), *c.EYE_CENTRE),
        "pupils": _pair(disc(PUPIL_SIDES, c.PUPIL_RADIUS), *c.PUPIL_CENTRE),
    }
    for side, sign in (("left", -1), ("right", 1)):
        meshes[f"{side}_finger_outline"] = _finger(sign, 0.0)
        meshes[f"{side}_finger_fill"] = _finger(sign, style.ROBOT_OUTLINE_WIDTH)
    for shape in SHAPES:
        meshes[f"{shape}_outline"] = _block(shape, 0.0)
        meshes[f"{shape}_fill"] = _block(shape, style.BLOCK_OUTLINE_WIDTH)
    return "".join(
        f'<mesh name="{name}" inertia="shell" vertex="{single(np.pad(points, ((0, 0), (0, 1))).ravel().tolist())}" '
        f'face="{" ".join(map(str, faces.ravel()))}"/>'
        for name, (points, faces) in meshes.items()
    )
