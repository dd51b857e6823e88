"""The Warp kernel that draws a batch, with a thread for each pixel of each environment.

A pixel is the mean of 2 x 2 samples, rounded in the same manner as in the renderer. For each sample, the kernel finds
the topmost object that covers it: robot, blocks, regions, or the arena's border. So pictures differ from the renderer's
only where a sample is within rounding of an edge.

Warp compiles these functions from their source. Their annotations are Warp's types, not Python's.
"""

from typing import Final

import warp as wp

from magical_mj.assets import style
from magical_mj.scene import constants as c

ROBOT_LAYERS: Final = (
    ("pupils", 0, style.BLACK),
    ("eyes", 0, style.WHITE),
    ("robot_fill", 0, style.GREY),
    ("robot_outline", 0, style.DARK_GREY),
    ("right_finger_fill", 2, style.LIGHT_GREY),
    ("right_finger_outline", 2, style.GREY),
    ("left_finger_fill", 1, style.LIGHT_GREY),
    ("left_finger_outline", 1, style.GREY),
)
"""From top to bottom: the part, the object that it moves with (0 body, 1 left finger, 2 right finger), its colour."""

MAX_OBJECTS: Final = 30
"""The maximum number of blocks and regions of an environment: `neighbours` has a bit for each."""

_LAYERS: Final = wp.constant(len(ROBOT_LAYERS))
_ARENA: Final = wp.constant(c.ARENA_HALF_WIDTH)
_BORDER: Final = wp.constant(style.ARENA_BORDER_WIDTH / 2)
_LINE: Final = wp.constant(style.REGION_BORDER_WIDTH / 2)
_ROOT_X: Final = wp.constant(c.FINGER_ROOT[0])
_ROOT_Y: Final = wp.constant(c.FINGER_ROOT[1])
_ROBOT_REACH: Final = wp.constant(0.45)  # distance of the open fingers' tips, world units
_BLOCK_REACH: Final = wp.constant(0.16)  # distance of a star's tips


def packed_rgb(rgb: style.Rgb) -> int:
    """A colour as one number."""
    red, green, blue = rgb
    return red << 16 | green << 8 | blue


_BORDER_COLOUR: Final = wp.constant(packed_rgb(style.ARENA_BORDER))
_SURROUND_COLOUR: Final = wp.constant(packed_rgb(style.LIGHT_GREY))
_NOTHING: Final = wp.constant(-1)


@wp.struct
class Outlines:
    """Polygons. A part consists of one or two loops of points."""

    points: wp.array(dtype=wp.vec2)
    loops: wp.array(dtype=wp.vec2i)
    """The index of each loop's first point, and the index after its last."""
    parts: wp.array(dtype=wp.vec2i)
    """The same of each part's loops. The layers of the robot come first, then outline and fill of each block shape."""
    reach: wp.array(dtype=float)
    """The squared distance of each part's furthest point from its origin."""
    frames: wp.array(dtype=int)
    """The object that each of the robot's layers moves with, see ROBOT_LAYERS."""
    colours: wp.array(dtype=int)
    """The colours of the robot's layers."""
    palette: wp.array2d(dtype=int)
    """Row: block's outline, block, region, or region's border. Column: colour."""


@wp.struct
class Objects:
    """The poses of the objects in every environment."""

    poses: wp.array2d(dtype=wp.vec4)
    """x, y, cosine and sine of the robot and of each block."""
    fingers: wp.array2d(dtype=wp.vec2)
    """Cosine and sine of both fingers' angles."""
    shapes: wp.array2d(dtype=int)
    colours: wp.array2d(dtype=int)
    regions: wp.array2d(dtype=wp.vec4)
    region_colours: wp.array2d(dtype=int)
    dashes: wp.array3d(dtype=wp.vec4)


@wp.func
def covers(part: int, x: float, y: float, outlines: Outlines) -> bool:
    """Whether a point is inside one of the part's loops: an odd number of edges crosses the ray to its right."""
    if x * x + y * y > outlines.reach[part]:
        return False
    loops = outlines.parts[part]
    for loop in range(loops[0], loops[1]):
        ends = outlines.loops[loop]
        odd = bool(False)
        before = outlines.points[ends[1] - 1]
        for number in range(ends[0], ends[1]):
            point = outlines.points[number]
            if (point[1] > y) != (before[1] > y):
                if x < (before[0] - point[0]) * (y - point[1]) / (before[1] - point[1]) + point[0]:
                    odd = not odd
            before = point
        if odd:
            return True
    return False


@wp.func
def robot_colour(env: int, x: float, y: float, objects: Objects, outlines: Outlines) -> int:
    """The colour of the robot at a point, or -1."""
    pose = objects.poses[env, 0]
    dx, dy = x - pose[0], y - pose[1]
    px = pose[2] * dx + pose[3] * dy
    py = pose[2] * dy - pose[3] * dx
    for layer in range(_LAYERS):
        qx, qy = px, py
        frame = outlines.frames[layer]
        if frame > 0:
            turn = objects.fingers[env, frame - 1]
            fx = px + _ROOT_X
            if frame == 2:
                fx = px - _ROOT_X
            fy = py - _ROOT_Y
            qx = turn[0] * fx + turn[1] * fy
            qy = turn[0] * fy - turn[1] * fx
        if covers(layer, qx, qy, outlines):
            return outlines.colours[layer]
    return _NOTHING


@wp.func
def block_colour(env: int, slot: int, x: float, y: float, objects: Objects, outlines: Outlines) -> int:
    """The colour of a block at a point, or -1."""
    pose = objects.poses[env, 1 + slot]
    dx, dy = x - pose[0], y - pose[1]
    px = pose[2] * dx + pose[3] * dy
    py = pose[2] * dy - pose[3] * dx
    part = _LAYERS + 2 * objects.shapes[env, slot]
    if covers(part + 1, px, py, outlines):
        return outlines.palette[1, objects.colours[env, slot]]
    if covers(part, px, py, outlines):
        return outlines.palette[0, objects.colours[env, slot]]
    return _NOTHING


@wp.func
def region_colour(env: int, slot: int, x: float, y: float, objects: Objects, outlines: Outlines) -> int:
    """The colour of a region at a point, or -1."""
    box = objects.regions[env, slot]
    depth = wp.min(wp.min(x - box[0], box[2] - x), wp.min(y - box[1], box[3] - y))  # negative outside
    if wp.abs(depth) <= _LINE:
        for number in range(objects.dashes.shape[2]):
            dash = objects.dashes[env, slot, number]
            if x > dash[0] and x < dash[2] and y > dash[1] and y < dash[3]:
                return outlines.palette[3, objects.region_colours[env, slot]]
    if depth > 0.0:
        return outlines.palette[2, objects.region_colours[env, slot]]
    return _NOTHING


@wp.func
def sample(env: int, x: float, y: float, near: int, objects: Objects, outlines: Outlines) -> int:
    """The colour of the topmost object at a point; -1 for the white floor. `near` has a bit for each candidate."""
    blocks = objects.shapes.shape[1]
    regions = objects.regions.shape[1]
    if near & 1:
        colour = robot_colour(env, x, y, objects, outlines)
        if colour >= 0:
            return colour
    for number in range(blocks):
        slot = blocks - 1 - number
        if (near >> (1 + slot)) & 1:
            colour = block_colour(env, slot, x, y, objects, outlines)
            if colour >= 0:
                return colour
    for number in range(regions):
        slot = regions - 1 - number
        if (near >> (1 + blocks + slot)) & 1:
            colour = region_colour(env, slot, x, y, objects, outlines)
            if colour >= 0:
                return colour
    far = wp.max(wp.abs(x), wp.abs(y))
    if wp.abs(far - _ARENA) < _BORDER:
        return _BORDER_COLOUR
    if far > _ARENA:
        return _SURROUND_COLOUR
    return _NOTHING


@wp.func
def neighbours(env: int, x: float, y: float, margin: float, objects: Objects) -> int:
    """The objects that may cover points within `margin` of this one, as bits of robot, blocks and regions."""
    blocks = objects.shapes.shape[1]
    near = int(0)
    pose = objects.poses[env, 0]
    if wp.length(wp.vec2(x - pose[0], y - pose[1])) < _ROBOT_REACH + margin:
        near = 1
    for slot in range(blocks):
        if objects.shapes[env, slot] >= 0:
            pose = objects.poses[env, 1 + slot]
            if wp.length(wp.vec2(x - pose[0], y - pose[1])) < _BLOCK_REACH + margin:
                near = near | (1 << (1 + slot))
    for slot in range(objects.regions.shape[1]):
        if objects.region_colours[env, slot] >= 0:
            box = objects.regions[env, slot]
            reach = margin + _LINE
            if x > box[0] - reach and x < box[2] + reach and y > box[1] - reach and y < box[3] + reach:
                near = near | (1 << (1 + blocks + slot))
    return near


@wp.kernel
def paint(
    objects: Objects,
    outlines: Outlines,
    ego: int,
    visible: float,
    forward: float,
    out: wp.array4d(dtype=wp.uint8),
):
    """Computes one pixel of one environment."""
    env, row, column = wp.tid()
    size = float(out.shape[1])
    step = visible / size
    turn = wp.vec4(0.0, 0.0, 1.0, 0.0)
    if ego > 0:
        turn = objects.poses[env, 0]
    red, green, blue, alpha = int(0), int(0), int(0), int(0)
    u = step * (float(column) + 0.5) - visible / 2.0
    v = visible / 2.0 - step * (float(row) + 0.5) + forward * float(ego)
    middle_x = turn[0] + turn[2] * u - turn[3] * v
    middle_y = turn[1] + turn[3] * u + turn[2] * v
    near = neighbours(env, middle_x, middle_y, step, objects)
    for number in range(4):
        su = u + step * (float(number % 2) * 0.5 - 0.25)
        sv = v + step * (float(number >> 1) * 0.5 - 0.25)
        x = turn[0] + turn[2] * su - turn[3] * sv
        y = turn[1] + turn[3] * su + turn[2] * sv
        colour = sample(env, x, y, near, objects, outlines)
        if colour >= 0:
            red += (colour >> 16) & 255
            green += (colour >> 8) & 255
            blue += colour & 255
            alpha += 255
    white = 255 - ((alpha + 2) >> 2)
    out[env, row, column, 0] = wp.uint8(((red + 2) >> 2) + white)
    out[env, row, column, 1] = wp.uint8(((green + 2) >> 2) + white)
    out[env, row, column, 2] = wp.uint8(((blue + 2) >> 2) + white)
