"""The arena: walls, the floor that feet stand on, what they look like, and the settings of simulation and look."""

from __future__ import annotations

from typing import Final

from magical_mj import constants as c
from magical_mj.assets import solids, style
from magical_mj.assets.contacts import FOOT_DEPTH, FOOT_RADIUS, SETTINGS, TIMESTEP, PhysicsSettings
from magical_mj.assets.mjcf import numbers
from magical_mj.assets.region import BONE

CAMERA_HEIGHT: Final = 2.0
_CAMERA = f'projection="orthographic" fovy="{c.VISIBLE_SIZE}"'
ALLO_CAMERA: Final = f'<camera name="allo" {_CAMERA} pos="0 0 {CAMERA_HEIGHT}"/>'
EGO_CAMERA: Final = (
    f'<camera name="ego" {_CAMERA} pos="0 {c.VISIBLE_SIZE * (0.5 - c.EGO_ANCHOR):.17g} {CAMERA_HEIGHT}"/>'
)
"""Rides on the robot, which stands in the middle, near the bottom, and heads up."""

LOOK: Final = (
    '<visual><headlight ambient="1 1 1" diffuse="0 0 0" specular="0 0 0"/>'
    '<global offwidth="1024" offheight="1024"/><map znear="1" zfar="3"/>'
    '<quality shadowsize="0" offsamples="4"/></visual>'
    '<statistic extent="1" center="0 0 0"/>'
)
"""One flat ambient light gives the palette's colours exactly."""


def options(settings: PhysicsSettings = SETTINGS) -> str:
    """How MuJoCo simulates.

    Elliptic cones make friction a disc. Explicit Euler with a fixed step is the original's integrator; implicit
    damping would soften servos whose gain is chosen for the step. With so few geoms, testing all pairs beats the
    mid-phase; sparse matrices make heaps of blocks cheaper. Blocks that have come to rest sleep until something
    touches them, which is most blocks most of the time.
    """
    return (
        '<compiler angle="radian" autolimits="true" usethread="false"/>'
        f'<option timestep="{numbers(TIMESTEP)}" gravity="0 0 0" integrator="Euler" cone="elliptic" solver="Newton" '
        f'jacobian="sparse" iterations="{settings.iterations}" tolerance="{settings.tolerance}" '
        f'impratio="{numbers(settings.impratio)}">'
        '<flag eulerdamp="disable" midphase="disable" sleep="enable"/></option>'
    )


def arena_mjcf() -> str:
    """What stands still in the world: floor, walls, their look, the allo camera, and the regions' body."""
    half = c.ARENA_HALF_WIDTH
    parts = [
        solids.solid('type="mesh" mesh="floor"', style.WHITE),
        style.visual_geom("surround", style.LIGHT_GREY),
        style.visual_geom("border", style.ARENA_BORDER),
        f'<geom name="floor" class="floor" type="plane" size="0 0 1" pos="0 0 {numbers(FOOT_DEPTH - FOOT_RADIUS)}"/>',
    ]
    for side, (x, y) in {"left": (-1, 0), "right": (1, 0), "bottom": (0, -1), "top": (0, 1)}.items():
        parts.append(solids.wall(x, y))
        pos, size = numbers((half + 1) * x, (half + 1) * y, 0), f"{1 + 2 * abs(y)} {1 + 2 * abs(x)} 1"
        for kind in ("wall", "finger_wall"):  # bodies of their own: what is not near them is then not tested
            geom = f'<geom name="{side}_{kind}" class="{kind}" type="box" size="{size}"/>'
            parts.append(f'<body name="{side}_{kind}" pos="{pos}">{geom}</body>')
    return "".join(parts) + ALLO_CAMERA + f'<body name="{BONE}"/>'
