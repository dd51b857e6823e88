"""Visual geoms with a height, below the flat polygons: for all cameras except ego and allo.

They are boxes and cylinders where possible, which cost less than meshes and are easier to read in an exported file.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

from magical_mj.assets.mjcf import numbers, quaternion
from magical_mj.assets.style import ARENA_BORDER, BLOCK_HEIGHT, BLOCK_OUTLINE, LIFT, WALL_HEIGHT, Rgb, rgba
from magical_mj.scene import constants as c
from magical_mj.scene.constants import Colour, Shape

WALL_THICKNESS: Final = 0.06  # world units


def solid(name: str, shape: str, rgb: Rgb) -> str:
    """A visual geom; `shape` holds MJCF attributes, such as those of `box`."""
    return f'<geom name="{name}" class="solid" {shape} rgba="{rgba(rgb)}"/>'


def box(x: float, y: float, half_x: float, half_y: float, height: float, angle: float = 0.0) -> str:
    """Attributes of a box on the floor at (x, y), rotated by `angle` (rad), whose top is just below `height`."""
    height -= LIFT
    turned = f'quat="{numbers(*quaternion(angle))}"' if angle else ""
    return f'type="box" size="{numbers(half_x, half_y, height / 2)}" pos="{numbers(x, y, height / 2)}" {turned}'


def cylinder(radius: float, height: float) -> str:
    """Attributes of a cylinder on the floor at the origin, whose top is just below `height`."""
    height -= LIFT
    return f'type="cylinder" size="{numbers(radius, height / 2)}" pos="0 0 {numbers(height / 2)}"'


@lru_cache(64)
def block(name: str, shape: Shape, colour: Colour) -> str:
    """The sides of a block."""
    sides = f'type="mesh" mesh="{shape}_sides"'
    if shape == "circle":
        sides = cylinder(c.BLOCK_SIZE, BLOCK_HEIGHT)
    elif shape == "square":
        sides = box(0, 0, c.SQUARE_SIDE / 2, c.SQUARE_SIDE / 2, BLOCK_HEIGHT)
    return solid(name, sides, BLOCK_OUTLINE[colour])


def wall(name: str, x: int, y: int) -> str:
    """The wall on the side of the arena to which (x, y), a unit vector, points; at corners two walls overlap."""
    middle, along = c.ARENA_HALF_WIDTH + WALL_THICKNESS / 2, c.ARENA_HALF_WIDTH + WALL_THICKNESS * abs(y)
    half = (WALL_THICKNESS / 2, along) if x else (along, WALL_THICKNESS / 2)
    return solid(name, box(middle * x, middle * y, *half, WALL_HEIGHT), ARENA_BORDER)
