"""Pebbles: small loose discs, which only shifts put into scenes. Models without them are as if there were none."""

from __future__ import annotations

from functools import cache
from typing import Final

import mujoco

from magical_mj.assets import style
from magical_mj.assets.contacts import SETTINGS, PhysicsSettings, floor_pair, foot, softness
from magical_mj.assets.meshes import convex, disc, mesh_mjcf
from magical_mj.assets.mjcf import comment, move_body, numbers, planar_body
from magical_mj.scene import Pebble
from magical_mj.scene import constants as c

SIDES: Final = 12
HEIGHT: Final = 0.03  # world units
OUTLINE_WIDTH: Final = 0.008


@cache
def pebble_library() -> str:
    """The meshes of a pebble, as MJCF. They come after those of all models, and only where there are pebbles."""
    outline = convex(disc(SIDES, c.PEBBLE_RADIUS), HEIGHT)
    fill = convex(disc(SIDES, c.PEBBLE_RADIUS - OUTLINE_WIDTH), HEIGHT + style.LIFT)
    return mesh_mjcf("pebble_outline", outline) + mesh_mjcf("pebble_fill", fill)


def pebble_mjcf(index: int, pebble: Pebble, settings: PhysicsSettings = SETTINGS) -> str:
    """The body `pebble<index>`."""
    name, inertia = f"pebble{index}", c.PEBBLE_MASS * c.PEBBLE_RADIUS**2 / 2
    content = (
        f'<inertial pos="0 0 0" mass="{c.PEBBLE_MASS}" diaginertia="{numbers(inertia, inertia, inertia)}"/>'
        + style.visual_geom(f"{name}_outline", "pebble_outline", style.DARK_GREY)
        + style.visual_geom(f"{name}_fill", "pebble_fill", style.GREY)
        + foot(f"{name}_foot")
        + style.solid(f"{name}_sides", style.cylinder_shape(c.PEBBLE_RADIUS, HEIGHT), style.DARK_GREY)
        + f'<body><geom class="disc" size="{numbers(c.PEBBLE_RADIUS)}"/></body>'
    )
    hinge = f'frictionloss="{c.PEBBLE_FRICTION_TORQUE}" {softness("friction", 1, settings.dry_impedance)}'
    return comment(f"Pebble {index}") + planar_body(name, (pebble.x, pebble.y, 0.0), content, hinge)


def pebble_pair(index: int, settings: PhysicsSettings = SETTINGS) -> str:
    """The contact of the pebble's foot with the floor."""
    return floor_pair(f"pebble{index}_foot", c.PEBBLE_FRICTION_FORCE, c.PEBBLE_MASS, settings)


def rewrite_pebble(model: mujoco.MjModel, index: int, pebble: Pebble, scope: str = "") -> None:
    """Changes the place of a pebble in a compiled model, with the same result as compiling."""
    move_body(model, f"pebble{index}", (pebble.x, pebble.y, 0.0), scope)
