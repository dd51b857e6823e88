"""The look: colours, heights of the drawing layers, widths of lines.

Nothing is lit: every thing is one or more flat polygons of one colour, one above the other, seen from straight
above. RGB values are those of the original's pictures.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Final

from magical_mj.constants import Colour

Rgb = tuple[int, int, int]
Palette = Mapping[Colour, Rgb]


def _palette(red: Rgb, green: Rgb, blue: Rgb, yellow: Rgb) -> Palette:
    return MappingProxyType({"red": red, "green": green, "blue": blue, "yellow": yellow})


WHITE: Final = (255, 255, 255)
GREY: Final = (162, 163, 175)  # robot, outline of the fingers
DARK_GREY: Final = (144, 145, 159)  # outline of the robot
LIGHT_GREY: Final = (231, 231, 234)  # outside the workspace, fingers
BLACK: Final = (26, 26, 26)  # pupils
ARENA_BORDER: Final = (192, 193, 201)  # the original's grey, thinned out to a wider line
BLOCK_FILL: Final = _palette((245, 129, 165), (195, 208, 130), (135, 185, 211), (254, 213, 123))
BLOCK_OUTLINE: Final = _palette((243, 94, 141), (183, 198, 105), (110, 170, 202), (254, 201, 86))
REGION_FILL: Final = _palette((250, 190, 209), (224, 231, 191), (194, 219, 233), (254, 234, 188))
REGION_BORDER: Final = BLOCK_FILL

# Heights (world units), in drawing order; to a camera straight above, nothing but the order matters.
Z_FLOOR, Z_SURROUND, Z_BORDER = -0.03, -0.02, -0.01
Z_REGION, REGION_STEP, BORDER_ABOVE_FILL = 0.01, 0.01, 0.005
Z_BLOCK, Z_FINGER, Z_BODY, Z_EYES, Z_PUPILS = 0.10, 0.20, 0.30, 0.35, 0.40
FILL_ABOVE_OUTLINE: Final = 0.01

# Line widths (world units)
ARENA_BORDER_WIDTH: Final = 0.0085  # 1.6 times the original's: at 96 px that would fall between two pixels
BLOCK_OUTLINE_WIDTH: Final = 0.015
ROBOT_OUTLINE_WIDTH: Final = 0.01
REGION_BORDER_WIDTH: Final = 0.01328125
DASH_LENGTH: Final = 0.0425  # of a dash, and of the gap after it

# Geom groups: MuJoCo's viewers show 0 to 2 and hide 3.
FLOOR_GROUP: Final = 1  # the white floor, which our own renderer spares itself by painting on white
DRAWN_GROUP: Final = 2
COLLISION_GROUP: Final = 3


@cache
def rgba(rgb: Rgb) -> str:
    """An opaque colour as an MJCF attribute."""
    return " ".join(f"{level / 255:.6g}" for level in rgb) + " 1"


@cache
def levels(rgb: Rgb) -> tuple[float, ...]:
    """The same colour as a compiled model holds it: red, green, blue and alpha in [0, 1]."""
    return tuple(map(float, rgba(rgb).split()))


def visual_geom(mesh: str, rgb: Rgb, z: float, group: int = DRAWN_GROUP) -> str:
    """A geom that is drawn and does nothing else."""
    return f'<geom class="visual" type="mesh" mesh="{mesh}" pos="0 0 {z:.6g}" rgba="{rgba(rgb)}" group="{group}"/>'
