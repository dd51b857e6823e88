"""The meshes of the visual geoms, the same in all models.

The cameras ego and allo look straight down and see flat polygons: an outline, and above it a smaller polygon in the
fill colour. Other cameras also see solids below them. These are mostly boxes and cylinders; only pentagons and stars
need meshes for their sides.

All models with the same body and arena list the same meshes in the same order, whether they use them or not. So one
drawing context can draw all these models.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from magical_mj.assets import style
from magical_mj.assets.mjcf import single
from magical_mj.scene import constants as c
from magical_mj.scene.bodies import GRIPPER, body_named
from magical_mj.scene.constants import SHAPES, Shape
from magical_mj.scene.geometry import block_outline, finger_outlines, mirrored, regular_polygon, square

Points = NDArray[np.float64]
"""Shape (n, 2), world units, counter-clockwise."""
Vertices = NDArray[np.float64]
"""Shape (n, 3), world units."""
Faces = NDArray[np.int64]
"""Shape (m, 3): triangles of vertices, by index."""
Mesh = tuple[Vertices, Faces]

CIRCLE_SIDES, ROBOT_SIDES, EYE_SIDES, PUPIL_SIDES = 32, 40, 16, 10
SURROUND_HALF = 3.2  # in half widths of the arena: more than the camera ego sees from any corner


def disc(sides: int, radius: float) -> Points:
    """A regular polygon with the area of a circle of this radius. Shape (sides, 2)."""
    return regular_polygon(sides, radius * float(np.sqrt(2 * np.pi / sides / np.sin(2 * np.pi / sides))))


def inset(outline: Points, depth: float) -> Points:
    """The outline with every edge moved inwards by `depth`. Shape (n, 2)."""
    before, after = outline - np.roll(outline, 1, axis=0), np.roll(outline, -1, axis=0) - outline
    normals = [
        np.stack([-e[:, 1], e[:, 0]], axis=1) / np.linalg.norm(e, axis=1, keepdims=True) for e in (before, after)
    ]
    bisector = normals[0] + normals[1]
    # a corner moves along its bisector, farther than `depth`: its distance from both edges changes by `depth`
    return outline + depth * bisector / np.sum(bisector * normals[0], axis=1, keepdims=True)


def at_height(points: Points, z: float) -> Vertices:
    """2-D points at height `z`. Shape (n, 3)."""
    return np.column_stack([points, np.full(len(points), z)])


def convex(outline: Points, z: float = 0.0) -> Mesh:
    """A flat convex polygon, triangulated by halving its arcs: compact triangles are drawn faster than a fan."""

    def cut(first: int, last: int) -> list[tuple[int, int, int]]:
        if last - first < 2:
            return []
        middle = (first + last) // 2
        return [(first, middle, last), *cut(first, middle), *cut(middle, last)]

    third, n = len(outline) / 3, len(outline)
    a, b = round(third), round(2 * third)
    faces = [(0, a, b), *cut(0, a), *cut(a, b), *((i, j, k % n) for i, j, k in cut(b, n))]
    return at_height(outline, z), np.array(faces)


def around_centre(outline: Points, z: float = 0.0) -> Mesh:
    """A flat star-shaped polygon, as a fan around the origin."""
    steps = np.arange(1, len(outline) + 1)
    vertices = at_height(np.vstack([np.zeros((1, 2)), outline]), z)
    return vertices, np.stack([0 * steps, steps, np.roll(steps, -1)], axis=1)


def frame(inner: float, outer: float, z: float) -> Mesh:
    """A flat frame between the squares with these half sides."""
    k = np.arange(4)
    n = np.roll(k, -1)
    faces = np.vstack([np.stack([k, k + 4, n + 4], axis=1), np.stack([k, n + 4, n], axis=1)])
    return at_height(np.vstack([square(inner), square(outer)]), z), faces


def sides(outline: Points, height: float) -> Mesh:
    """The vertical faces of a prism on the floor. They share no vertices: shared ones are shaded as if round."""
    ends = np.stack([outline, np.roll(outline, -1, axis=0)], axis=1).reshape(-1, 2)
    first, above = np.arange(0, len(ends), 2), len(ends)
    faces = [[first, first + 1, first + 1 + above], [first, first + 1 + above, first + above]]
    return np.vstack([at_height(ends, 0), at_height(ends, height)]), np.hstack(faces).T


def together(parts: Iterable[Mesh]) -> Mesh:
    """Several meshes as one."""
    vertices, faces, count = [], [], 0
    for points, triangles in parts:
        vertices.append(points)
        faces.append(triangles + count)  # numbers of vertices, which follow those of earlier parts
        count += len(points)
    return np.vstack(vertices), np.vstack(faces)


def loops(faces: Faces) -> list[list[int]]:
    """The outlines of a flat mesh, as closed loops of vertices. Their edges belong to one triangle only."""
    edges = {(int(face[k]), int(face[(k + 1) % 3])) for face in faces for k in range(3)}
    after = {start: end for start, end in edges if (end, start) not in edges}
    outlines = []
    while after:
        start = min(after)
        loop = [start]
        while (end := after.pop(loop[-1])) != start:
            loop.append(end)
        outlines.append(loop)
    return outlines


def _block(shape: Shape, depth: float, z: float) -> Mesh:
    """The drawn outline of a block, moved inwards by `depth`."""
    if shape == "circle":
        return convex(disc(CIRCLE_SIDES, c.BLOCK_SIZE - depth), z)
    if shape == "star":  # the original shrinks both radii
        outline = block_outline(shape)
        return around_centre(outline * (1 - depth / np.linalg.norm(outline, axis=1, keepdims=True)), z)
    return convex(inset(block_outline(shape), depth), z)


def _finger(sign: int, depth: float, z: float) -> Mesh:
    """Upper segment and forearm of the right (sign 1) or left (sign -1) finger, with edges moved inwards by `depth`."""
    outlines = (outline if sign > 0 else mirrored(outline) for outline in finger_outlines())
    return together(convex(inset(outline, depth), z) for outline in outlines)


def _pair(outline: Points, x: float, y: float, z: float) -> Mesh:
    """The same flat convex polygon at (-x, y) and (x, y)."""
    return together(convex(outline + np.array([side * x, y]), z) for side in (-1, 1))


@cache
def meshes(body: str = GRIPPER, half: float = c.ARENA_HALF_WIDTH) -> dict[str, Mesh]:
    """The meshes of all models with this body and this half width of the arena, by name."""
    line, lift, shape = style.ARENA_BORDER_WIDTH / 2, style.LIFT, body_named(body)
    wall, block, finger, robot = style.WALL_HEIGHT, style.BLOCK_HEIGHT, style.FINGER_HEIGHT, style.ROBOT_HEIGHT
    aside, ahead = shape.eye
    pupil = aside + c.PUPIL_CENTRE[0] - c.EYE_CENTRE[0], ahead + c.PUPIL_CENTRE[1] - c.EYE_CENTRE[1]
    outline, fill = (
        inset(shape.corners, depth) if shape.outline else disc(ROBOT_SIDES, shape.radius - depth)
        for depth in (0.0, style.ROBOT_OUTLINE_WIDTH)
    )
    shared = {
        "surround": frame(half, SURROUND_HALF * half, 0),  # its inner edge is under the border line
        "border": frame(half - line, half + line, wall + lift),
        "robot_outline": convex(outline, robot),
        "robot_fill": convex(fill, robot + lift),
        "eyes": _pair(disc(EYE_SIDES, c.EYE_RADIUS), *shape.eye, robot + 2 * lift),
        "pupils": _pair(disc(PUPIL_SIDES, c.PUPIL_RADIUS), *pupil, robot + 3 * lift),
    }
    for side, sign in (("left", -1), ("right", 1)):
        shared[f"{side}_finger_outline"] = _finger(sign, 0.0, finger)
        shared[f"{side}_finger_fill"] = _finger(sign, style.ROBOT_OUTLINE_WIDTH, finger + lift)
    for kind in SHAPES:
        shared[f"{kind}_outline"] = _block(kind, 0.0, block)
        shared[f"{kind}_fill"] = _block(kind, style.BLOCK_OUTLINE_WIDTH, block + lift)
    shared |= {f"{kind}_sides": sides(block_outline(kind), block) for kind in ("pentagon", "star")}
    if shape.outline:
        shared["robot_sides"] = sides(outline, robot - lift)
    return shared


@cache
def library(body: str = GRIPPER, half: float = c.ARENA_HALF_WIDTH) -> str:
    """These meshes as MJCF."""
    return "".join(mesh_mjcf(name, mesh) for name, mesh in meshes(body, half).items())


def mesh_mjcf(name: str, mesh: Mesh) -> str:
    """A mesh as MJCF."""
    vertices, faces = mesh
    return (
        f'<mesh name="{name}" inertia="shell" vertex="{single(vertices.ravel().tolist())}" '
        f'face="{" ".join(map(str, faces.ravel()))}"/>'
    )
