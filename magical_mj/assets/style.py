"""Appearance: colours, heights of the drawing layers, widths of lines, visual geoms, cameras and lamps.

The cameras ego and allo look straight down without shading, and see each object as flat polygons of one colour. RGB
values are those of the original's pictures. For all other cameras, solid geoms are below the polygons. They are boxes
and cylinders where possible: these cost less than meshes and are easier to read in an exported file.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Final

from magical_mj.assets.mjcf import numbers
from magical_mj.scene import constants as c
from magical_mj.scene.constants import Colour, Shape
from magical_mj.scene.geometry import quaternion

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
MATERIALS: Final[Mapping[str, Rgb]] = MappingProxyType(
    {
        "white": WHITE,
        "light_grey": LIGHT_GREY,
        "wall_grey": ARENA_BORDER,
        "grey": GREY,
        "dark_grey": DARK_GREY,
        "black": BLACK,
    }
    | {f"{colour}_outline": rgb for colour, rgb in BLOCK_OUTLINE.items()}
    | {f"{colour}_fill": rgb for colour, rgb in BLOCK_FILL.items()}
    | {f"{colour}_region": rgb for colour, rgb in REGION_FILL.items()}
)
"""The names of all colours in exported files. The border of a region has the colour of a block's fill."""

# Heights (world units). Objects that are drawn later are higher, so every program shows the same picture from above.
Z_REGION, REGION_STEP, BORDER_ABOVE_FILL = 0.001, 0.001, 0.0005
WALL_HEIGHT, BLOCK_HEIGHT, FINGER_HEIGHT, ROBOT_HEIGHT = 0.05, 0.08, 0.09, 0.13
LIFT: Final = 0.001  # distance between stacked polygons: in one plane, their order would be undefined

# Widths (world units)
WALL_THICKNESS: Final = 0.06
ARENA_BORDER_WIDTH: Final = 0.0085  # 1.6 times the original's, which would be thinner than a pixel at 96 px
BLOCK_OUTLINE_WIDTH: Final = 0.015
ROBOT_OUTLINE_WIDTH: Final = 0.01
REGION_BORDER_WIDTH: Final = 0.01328125
DASH_LENGTH: Final = 0.0425  # of a dash, and of the gap between dashes

# Geom groups: MuJoCo's viewers show 0 to 2 and hide the others.
SOLID_GROUP: Final = 1  # sides, ground and floor: hidden from the cameras ego and allo, which have a white background
DRAWN_GROUP: Final = 2
COLLISION_GROUP: Final = 3
TASK_GROUP: Final = 4  # seen by the cameras ego and allo only


CAMERA_HEIGHT: Final = 2.0


def allo_camera(half: float = c.ARENA_HALF_WIDTH) -> str:
    """The camera that sees the whole arena of this half width."""
    return f'<camera name="allo" {_camera(half)} pos="{numbers(0, 0, CAMERA_HEIGHT)}"/>'


def ego_camera(half: float = c.ARENA_HALF_WIDTH) -> str:
    """The camera on the robot. In its picture the robot is near the bottom, centred, and heads up."""
    ahead = c.VISIBLE_SIZE * half * (0.5 - c.EGO_ANCHOR)
    return f'<camera name="ego" {_camera(half)} pos="{numbers(0, ahead, CAMERA_HEIGHT)}"/>'


def _camera(half: float) -> str:
    return f'projection="orthographic" fovy="{numbers(c.VISIBLE_SIZE * half)}"'


_SKY: Final = ".91 .91 .92"
LOOK: Final = f"""
<!-- For viewers: a free camera above a corner with everything in view, and soft light -->
<visual>
  <headlight ambient=".56 .56 .56" diffuse=".06 .06 .06" specular="0 0 0"/>
  <global azimuth="128" elevation="-45" fovy="30" offwidth="2048" offheight="2048"/>
  <map znear="0.02" zfar="8" shadowclip="0.8"/>
  <quality shadowsize="2048"/>
  <rgba haze="{_SKY} 1"/>
</visual>
<statistic extent="4" center="0.08 -0.1 0"/>
"""
"""For all cameras except ego and allo: a free camera above a corner with everything in view, and soft light."""
SKY: Final = f'<texture type="skybox" builtin="gradient" rgb1="1 1 1" rgb2="{_SKY}" width="16" height="96"/>'
LAMPS: Final = ((0.32, 0.18), (0.44, 0.18), (0.32, 0.30), (0.44, 0.30))
"""The slopes of the light of four lamps side by side. Together they make shadows with soft edges."""
AIM: Final = -1.2
"""The x and y that all lamps point to. In the half of MuJoCo's shadow map nearer to the lamp, the ground shades itself
in speckles. This point keeps that half outside the arena."""


def lamps_mjcf() -> str:
    """The lamps. They are far away, since close ones make noisy shadows."""
    return "".join(
        f'<light name="lamp{index}" directional="true" '
        f'pos="{numbers(round(AIM - 16 * x, 2), round(AIM - 16 * y, 2), 16)}" '
        f'dir="{x} {y} -1" ambient="0 0 0" diffuse=".11 .11 .11" specular="0 0 0"/>'
        for index, (x, y) in enumerate(LAMPS)
    )


@cache
def rgba(rgb: Rgb) -> str:
    """An opaque colour as an MJCF attribute."""
    return " ".join(f"{level / 255:.6g}" for level in rgb) + " 1"


@cache
def levels(rgb: Rgb) -> tuple[float, ...]:
    """A colour's values in a compiled model: red, green, blue and alpha in [0, 1]."""
    return tuple(map(float, rgba(rgb).split()))


def visual_geom(name: str, mesh: str, rgb: Rgb, more: str = "") -> str:
    """A visual geom with a flat mesh; `more` holds further attributes."""
    return f'<geom name="{name}" class="visual" mesh="{mesh}" rgba="{rgba(rgb)}" {more}/>'


def solid(name: str, shape: str, rgb: Rgb) -> str:
    """A visual geom; `shape` holds MJCF attributes, such as those of `box`."""
    return f'<geom name="{name}" class="solid" {shape} rgba="{rgba(rgb)}"/>'


def box_shape(x: float, y: float, half_x: float, half_y: float, height: float, angle: float = 0.0) -> str:
    """Attributes of a box on the floor at (x, y), rotated by `angle` (rad). Its top is just below `height`."""
    height -= LIFT
    turned = f'quat="{numbers(*quaternion(angle))}"' if angle else ""
    return f'type="box" size="{numbers(half_x, half_y, height / 2)}" pos="{numbers(x, y, height / 2)}" {turned}'


def cylinder_shape(radius: float, height: float) -> str:
    """Attributes of a cylinder on the floor at the origin. Its top is just below `height`."""
    height -= LIFT
    return f'type="cylinder" size="{numbers(radius, height / 2)}" pos="0 0 {numbers(height / 2)}"'


@cache
def block_sides(name: str, shape: Shape, colour: Colour) -> str:
    """The sides of a block."""
    sides = f'type="mesh" mesh="{shape}_sides"'
    if shape == "circle":
        sides = cylinder_shape(c.BLOCK_SIZE, BLOCK_HEIGHT)
    elif shape == "square":
        sides = box_shape(0, 0, c.SQUARE_SIDE / 2, c.SQUARE_SIDE / 2, BLOCK_HEIGHT)
    return solid(name, sides, BLOCK_OUTLINE[colour])


def wall_sides(name: str, x: int, y: int, arena: float = c.ARENA_HALF_WIDTH) -> str:
    """The wall in direction (x, y), a unit vector, from the arena's centre. At corners, two walls overlap."""
    middle, along = arena + WALL_THICKNESS / 2, arena + WALL_THICKNESS * abs(y)
    half = (WALL_THICKNESS / 2, along) if x else (along, WALL_THICKNESS / 2)
    return solid(name, box_shape(middle * x, middle * y, *half, WALL_HEIGHT), ARENA_BORDER)
