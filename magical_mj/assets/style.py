"""The look: colours, heights of the drawing layers, widths of lines.

The cameras ego and allo look straight down without shading, so that each thing is a flat polygon of one colour. RGB
values are those of the original's pictures.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Final

from magical_mj.scene.constants import Colour

Rgb = tuple[int, int, int]
Palette = Mapping[Colour, Rgb]


def _palette(red: Rgb, green: Rgb, blue: Rgb, yellow: Rgb) -> Palette:
    return MappingProxyType({"red": red, "green": green, "blue": blue, "yellow": yellow})


WHITE: Final = (255, 255, 255)
GREY: Final = (162, 163, 175)  # robot, outline of the fingers
DARK_GREY: Final = (144, 145, 159)  # outline of the robot
LIGHT_GREY: Final = (231, 231, 234)  # outside the workspace, fingers
BLACK: Final = (26, 26, 26)  # pupils
ARENA_BORDER: Final = (192, 193, 201)  # lighter than the original's, since the line is wider
BLOCK_FILL: Final = _palette((245, 129, 165), (195, 208, 130), (135, 185, 211), (254, 213, 123))
BLOCK_OUTLINE: Final = _palette((243, 94, 141), (183, 198, 105), (110, 170, 202), (254, 201, 86))
REGION_FILL: Final = _palette((250, 190, 209), (224, 231, 191), (194, 219, 233), (254, 234, 188))
REGION_BORDER: Final = BLOCK_FILL

# Heights (world units). What is drawn later is higher, so that every program shows the same picture from above.
Z_REGION, REGION_STEP, BORDER_ABOVE_FILL = 0.001, 0.001, 0.0005
WALL_HEIGHT, BLOCK_HEIGHT, FINGER_HEIGHT, ROBOT_HEIGHT = 0.05, 0.08, 0.09, 0.13
LIFT: Final = 0.001  # distance between stacked polygons; in the same plane, which one is visible would be undefined

# Line widths (world units)
ARENA_BORDER_WIDTH: Final = 0.0085  # 1.6 times the original's, which would be thinner than a pixel at 96 px
BLOCK_OUTLINE_WIDTH: Final = 0.015
ROBOT_OUTLINE_WIDTH: Final = 0.01
REGION_BORDER_WIDTH: Final = 0.01328125
DASH_LENGTH: Final = 0.0425  # of a dash, and of the gap between dashes

# Geom groups: MuJoCo's viewers show 0 to 2 and hide the others.
SOLID_GROUP: Final = 1  # hidden from the cameras ego and allo: sides, ground and floor; their background is white
DRAWN_GROUP: Final = 2
COLLISION_GROUP: Final = 3
TASK_GROUP: Final = 4  # seen by the cameras ego and allo only


@cache
def rgba(rgb: Rgb) -> str:
    """An opaque colour as an MJCF attribute."""
    return " ".join(f"{level / 255:.6g}" for level in rgb) + " 1"


@cache
def levels(rgb: Rgb) -> tuple[float, ...]:
    """The same colour as in a compiled model: red, green, blue and alpha in [0, 1]."""
    return tuple(map(float, rgba(rgb).split()))


def visual_geom(name: str, mesh: str, rgb: Rgb, more: str = "") -> str:
    """A visual geom that shows a flat mesh; `more` holds further attributes."""
    return f'<geom name="{name}" class="visual" mesh="{mesh}" rgba="{rgba(rgb)}" {more}/>'
