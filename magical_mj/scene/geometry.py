"""Exact outlines of all solid objects, and the check of scenes.

A solid part is a shapely geometry enlarged by a radius: a disc is a point with a radius, the square has a
small rounded margin, and all others are polygons with radius 0. Two parts touch if the distance between their
geometries is at most the sum of their radii. This is exact for all of them.
"""

from __future__ import annotations

import math
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene import GoalRegion, Pebble, Pose, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.bodies import GRIPPER, body_named
from magical_mj.scene.constants import Shape
from magical_mj.utils.errors import InvalidSceneError

if TYPE_CHECKING:  # functions import it: listing the environments does not need it
    from shapely.geometry.base import BaseGeometry

    Part = tuple[BaseGeometry, float]
    """A solid part in world coordinates: its core geometry, and the radius by which it is enlarged."""

Outline = NDArray[np.float64]
"""The corners of a simple polygon, counter-clockwise. Shape (n, 2)."""

OVERLAP_TOLERANCE: Final = 0.04
"""The largest depth (world units) of overlaps in a user's scene: contacts are slightly soft."""

OVERHANG: Final = 0.11
"""How far (world units) a goal region with a solid border may reach beyond the walls, as x-magical's zone does."""

MAX_ANGLE: Final = 500.0
"""The largest angle (rad) in a scene. Further turns during an episode keep it within the bounds of states."""


FINGER_SLACK: Final = 0.05
"""How far a finger's angle may be outside of its range, rad."""


class Solid(NamedTuple):
    """The parts of one body around (x, y), all within the distance `reach`."""

    x: float
    y: float
    reach: float
    parts: tuple[Part, ...]


def regular_polygon(corners: int, radius: float) -> Outline:
    """A regular polygon around the origin with its first corner on +y. Shape (corners, 2)."""
    angles = math.pi / 2 + 2 * math.pi * np.arange(corners) / corners
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def square(half: float) -> Outline:
    """The square around the origin with this half side. Shape (4, 2)."""
    return half * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


@cache
def block_outline(shape: Shape) -> Outline:
    """Corners of a block in its own frame, as drawn. Shape (n, 2); the circle is a 100-gon."""
    if shape == "square":
        outline = square(c.SQUARE_SIDE / 2)
    elif shape == "pentagon":
        outline = regular_polygon(5, c.PENTAGON_RADIUS)
    elif shape == "star":
        outline = regular_polygon(10, 1.0)
        outline *= np.where(np.arange(10) % 2, c.STAR_INNER_RADIUS, c.STAR_OUTER_RADIUS)[:, None]
    else:
        outline = regular_polygon(100, c.BLOCK_SIZE)
    outline.setflags(write=False)
    return outline


@cache
def finger_outlines() -> tuple[Outline, Outline]:
    """Upper segment and forearm of the right finger in its own frame (pivot at the origin, +y outwards).

    Each has shape (4, 2). The forearm is hinged at the outer corner of the upper segment's tip and turned
    inwards, to the left. The left finger is the mirror image.
    """
    half = c.FINGER_THICKNESS / 2
    box = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, 0.0], [1.0, 0.0]])
    upper = box * [half, c.FINGER_UPPER_LENGTH]
    cosine, sine = math.cos(c.FINGER_BEND), math.sin(c.FINGER_BEND)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    corner = np.array([half, c.FINGER_UPPER_LENGTH])
    forearm = ((box - [1.0, 0.0]) * [half, c.FINGER_FOREARM_LENGTH]) @ turn.T + corner
    return upper, forearm


def mirrored(outline: Outline) -> Outline:
    """The outline reflected in the y axis, counter-clockwise again."""
    return (outline * [-1.0, 1.0])[::-1]


def placed(outline: Outline, pose: Pose) -> Outline:
    """The outline turned by the pose's angle and moved to its position. Shape (..., n, 2), like the outline's."""
    x, y, angle = pose
    cosine, sine = math.cos(angle), math.sin(angle)
    return outline @ np.array([[cosine, sine], [-sine, cosine]]) + (x, y)


def quaternion(angle: float) -> tuple[float, float, float, float]:
    """The rotation about z by `angle` (rad) as a quaternion w, x, y, z."""
    return math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)


def slide_axes(angle: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """The x and y axes of the world frame, in the frame of a body rotated by `angle` (rad)."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return (cosine, -sine, 0.0), (sine, cosine, 0.0)


def block_solid(shape: Shape, pose: Pose) -> Solid:
    """A block at `pose`."""
    import shapely

    x, y, _ = pose
    if shape == "circle":
        return Solid(x, y, c.BLOCK_SIZE, ((shapely.Point(x, y), c.BLOCK_SIZE),))
    outline = block_outline(shape)
    margin = c.SQUARE_MARGIN if shape == "square" else 0.0
    reach = math.hypot(*outline[0]) + margin
    return Solid(x, y, reach, ((shapely.Polygon(placed(outline, pose)), margin),))


@lru_cache(maxsize=64)  # placement calls this often with the same few arguments
def _robot_segments(fingers: tuple[float, float], body: str) -> tuple[Outline, float, float]:
    """The robot's polygons in its frame, shape (m, n, 2), its reach, and its disc's radius or 0.

    The polygons are the four segments of both fingers, or the outline of a body without fingers, or none for a disc.
    """
    shape = body_named(body)
    if not shape.fingers:
        outlines = shape.corners[None] if shape.outline else np.zeros((0, 4, 2))
        return outlines, shape.reach, 0.0 if shape.outline else shape.radius
    root_x, root_y = c.FINGER_ROOT
    left, right = fingers
    segments = np.stack(
        [placed(mirrored(outline), (-root_x, root_y, left)) for outline in finger_outlines()]
        + [placed(outline, (root_x, root_y, right)) for outline in finger_outlines()]
    )
    reach = max(shape.radius, float(np.hypot(segments[..., 0], segments[..., 1]).max()))
    return segments, reach, shape.radius


def robot_solid(
    pose: Pose, fingers: tuple[float, float] = (c.FINGER_OPEN, -c.FINGER_OPEN), body: str = GRIPPER
) -> Solid:
    """The robot at `pose`: the disc and the segments of both fingers, or the parts of another body."""
    import shapely

    x, y, _ = pose
    segments, reach, radius = _robot_segments(fingers, body)
    polygons = np.asarray(shapely.polygons(placed(segments, pose)))  # one call for all four is much faster
    disc = ((shapely.Point(x, y), radius),) if radius else ()
    return Solid(x, y, reach, (*disc, *((polygon, 0.0) for polygon in polygons)))


def pebble_solid(pebble: Pebble) -> Solid:
    """A pebble."""
    import shapely

    part = shapely.Point(pebble.x, pebble.y), c.PEBBLE_RADIUS
    return Solid(pebble.x, pebble.y, c.PEBBLE_RADIUS, (part,))


def region_solid(region: GoalRegion) -> Solid:
    """A goal region as an obstacle for placement."""
    import shapely

    reach = math.hypot(region.width, region.height) / 2
    return Solid(*region.centre, reach, ((shapely.box(*region.box), 0.0),))


def touch(solid: Solid, other: Solid, tolerance: float = 0.0) -> bool:
    """Whether the solids touch. With a `tolerance` (world units), each is first shrunk by half of it."""
    if math.hypot(solid.x - other.x, solid.y - other.y) > solid.reach + other.reach:
        return False
    for a in solid.parts:
        for b in other.parts:
            if _meet(a, b) and (tolerance == 0.0 or _meet(_shrunk(a, tolerance / 2), _shrunk(b, tolerance / 2))):
                return True
    return False


def _meet(a: Part, b: Part) -> bool:
    return a[0].distance(b[0]) <= a[1] + b[1]


def _shrunk(part: Part, by: float) -> Part:
    core, radius = part
    return (core, radius - by) if radius >= by else (core.buffer(radius - by), 0.0)


def inside_walls(solid: Solid, tolerance: float = 0.0, half_width: float = c.ARENA_HALF_WIDTH) -> bool:
    """Whether the solid is inside walls at the distance `half_width` from the centre, up to `tolerance`."""
    limit = half_width + tolerance
    if max(abs(solid.x), abs(solid.y)) + solid.reach <= limit:
        return True
    for core, radius in solid.parts:
        x_min, y_min, x_max, y_max = core.bounds
        if max(x_max, y_max, -x_min, -y_min) + radius > limit:
            return False
    return True


def solids(scene: Scene) -> dict[str, Solid]:
    """The robot and the blocks as solids, by name: "robot", then "block 0", "block 1", ..."""
    robot = scene.robot
    bodies = {"robot": robot_solid(robot.pose, robot.fingers, robot.body)}
    bodies |= {f"block {index}": block_solid(block.shape, block.pose) for index, block in enumerate(scene.blocks)}
    return bodies


@np.errstate(all="ignore")  # tiny numbers may underflow, independent of the caller's settings
def check_scene(scene: Scene) -> None:
    """Raises an `InvalidSceneError` unless all objects are inside the walls, and no two solids overlap.

    Contacts in the simulation are slightly soft, so overlaps up to `OVERLAP_TOLERANCE` are allowed.
    """
    _check_fingers(*scene.robot.fingers)
    for body in (scene.robot, *scene.blocks):
        if abs(body.angle) > MAX_ANGLE:
            raise InvalidSceneError(f"the angle of {body} is larger than {MAX_ANGLE:g} rad; subtract whole turns")
    bodies, half = list(solids(scene).items()), scene.half_width
    bodies += [(f"pebble {index}", pebble_solid(pebble)) for index, pebble in enumerate(scene.pebbles)]
    for name, solid in bodies:
        if not inside_walls(solid, OVERLAP_TOLERANCE, half):
            raise InvalidSceneError(
                f"{name} at ({solid.x:.3f}, {solid.y:.3f}) is not inside the walls, which are at x, y = "
                f"{-half:g} and {half:g}"
            )
    for index, (name, solid) in enumerate(bodies):
        for other_name, other in bodies[:index]:
            if touch(solid, other, OVERLAP_TOLERANCE):
                raise InvalidSceneError(
                    f"{other_name} and {name} overlap at ({solid.x:.3f}, {solid.y:.3f}); move one of them"
                )
    for index, region in enumerate(scene.regions):
        reaches_out = OVERHANG if region.is_zone else OVERLAP_TOLERANCE
        if not inside_walls(region_solid(region), reaches_out, half):
            raise InvalidSceneError(
                f"region {index} ({region}) is not inside the walls, at x, y = {-half:g} and {half:g}"
            )


def _check_fingers(left: float, right: float) -> None:
    """Raises unless the fingers' angles are within their range, left 0..pi/8, right -pi/8..0 (small slack)."""
    low, high = -FINGER_SLACK, c.FINGER_OPEN + FINGER_SLACK
    if not (low <= left <= high and low <= -right <= high):
        raise InvalidSceneError(
            f"the fingers' angles are {left, right}; left must be in 0..{c.FINGER_OPEN:.4f}, "
            f"right in -{c.FINGER_OPEN:.4f}..0"
        )
