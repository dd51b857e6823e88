"""The arena: walls, floor, cameras and lights, and MuJoCo's options."""

from __future__ import annotations

from typing import Final

from magical_mj.assets import solids, style
from magical_mj.assets.contacts import FOOT_DEPTH, FOOT_RADIUS, TIMESTEP, PhysicsSettings
from magical_mj.assets.mjcf import comment, numbers
from magical_mj.assets.region import BONE
from magical_mj.scene import constants as c

CAMERA_HEIGHT: Final = 2.0
_CAMERA = f'projection="orthographic" fovy="{c.VISIBLE_SIZE}"'
ALLO_CAMERA: Final = f'<camera name="allo" {_CAMERA} pos="{numbers(0, 0, CAMERA_HEIGHT)}"/>'
EGO_CAMERA: Final = (
    f'<camera name="ego" {_CAMERA} pos="{numbers(0, c.VISIBLE_SIZE * (0.5 - c.EGO_ANCHOR), CAMERA_HEIGHT)}"/>'
)
"""Attached to the robot, which appears in the middle near the bottom of the picture and heads up."""

_SKY: Final = ".91 .91 .92"
LOOK: Final = (
    comment("For viewers: a camera above a corner that sees all, and soft light")
    + '<visual><headlight ambient=".56 .56 .56" diffuse=".06 .06 .06" specular="0 0 0"/>'
    '<global azimuth="128" elevation="-45" fovy="30" offwidth="2048" offheight="2048"/>'
    f'<map znear="0.02" zfar="8" shadowclip="1"/><quality shadowsize="2048"/><rgba haze="{_SKY} 1"/></visual>'
    '<statistic extent="4" center="0.08 -0.1 0"/>'
)
"""For all cameras except ego and allo: a free camera that starts above a corner with all in view, and soft light."""
SKY: Final = f'<texture type="skybox" builtin="gradient" rgb1="1 1 1" rgb2="{_SKY}" width="16" height="96"/>'
_LAMPS: Final = ((0.32, 0.18), (0.44, 0.18), (0.32, 0.30), (0.44, 0.30))
LIGHTS: Final = "".join(
    f'<light directional="true" pos="{numbers(-16 * x, -16 * y, 16)}" dir="{x} {y} -1" '
    'ambient="0 0 0" diffuse=".11 .11 .11" specular="0 0 0"/>'
    for x, y in _LAMPS
)
"""Four lights side by side make shadows with soft edges. They are far away, since close lights make noisy shadows."""


SIDES: Final = {"left": (-1, 0), "right": (1, 0), "bottom": (0, -1), "top": (0, 1)}


def options(settings: PhysicsSettings) -> str:
    """MuJoCo's options, as MJCF.

    Elliptic cones make friction equal in all directions. Explicit Euler with a fixed step is the original's
    integrator; implicit damping would soften servos whose gain is chosen for this step. With so few geoms, testing all
    pairs is faster than the mid-phase, and sparse matrices make piles of blocks cheaper. Blocks at rest sleep until
    something touches them: most blocks, most of the time.
    """
    return (
        comment("Ten steps of 12.5 ms are one action. What has come to rest sleeps until something touches it.")
        + '<compiler angle="radian" autolimits="true" usethread="false"/>'
        f'<option timestep="{numbers(TIMESTEP)}" gravity="0 0 0" integrator="Euler" cone="elliptic" solver="Newton" '
        f'jacobian="sparse" iterations="{settings.iterations}" tolerance="{settings.tolerance}" '
        f'impratio="{numbers(settings.impratio)}">'
        '<flag eulerdamp="disable" midphase="disable" sleep="enable"/></option>'
    )


def arena_mjcf() -> str:
    """The static part of the world, as MJCF: floor, walls, their look, the allo camera, and the regions' body."""
    half = c.ARENA_HALF_WIDTH
    parts = [
        comment("The arena: the ground, the white workspace, what the flat pictures show beyond it, the line between"),
        f'<geom name="floor" class="floor" type="plane" size="0 0 1" pos="0 0 {numbers(FOOT_DEPTH - FOOT_RADIUS)}"/>',
        solids.solid("workspace", f'type="plane" size="{numbers(half, half, 1)}"', style.WHITE),
        style.visual_geom("surround", "surround", style.LIGHT_GREY, f'group="{style.TASK_GROUP}"'),
        style.visual_geom("border", "border", style.ARENA_BORDER),
    ]
    parts += (solids.wall(f"{side}_wall_sides", x, y) for side, (x, y) in SIDES.items())
    parts += comment(
        "Walls stand twice: of two geoms that touch the larger friction counts, and fingers have their own"
    )
    for side, (x, y) in SIDES.items():
        pos, size = numbers((half + 1) * x, (half + 1) * y, 0), f"{1 + 2 * abs(y)} {1 + 2 * abs(x)} 1"
        for kind in ("wall", "finger_wall"):  # separate bodies, so that the broad phase skips what is far from them
            geom = f'<geom name="{side}_{kind}" class="{kind}" type="box" size="{size}"/>'
            parts.append(f'<body name="{side}_{kind}" pos="{pos}">{geom}</body>')
    return "".join(
        (
            *parts,
            comment("Four lamps, for soft shadows"),
            LIGHTS,
            comment("The whole workspace from above; the robot has the other camera of the task"),
            ALLO_CAMERA,
            comment("Goal regions: drawn, never solid"),
            f'<body name="{BONE}"/>',
        )
    )
