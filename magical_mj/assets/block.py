"""Blocks: planar bodies with dry friction against the ground, collision geoms and visual geoms.

Pebbles are small discs of the same kind that only shifts add to scenes. They do not change the models of other scenes.
"""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Final

from magical_mj.assets import style
from magical_mj.assets.contacts import DEBRIS_MASS, SETTINGS, PhysicsSettings, floor_pair, foot, vertex
from magical_mj.assets.meshes import Points, convex, disc, inset, mesh_mjcf
from magical_mj.assets.mjcf import comment, numbers, planar_body
from magical_mj.assets.style import BLOCK_FILL, BLOCK_OUTLINE
from magical_mj.scene import Block, Dynamics, Pebble
from magical_mj.scene import constants as c
from magical_mj.scene.constants import Shape
from magical_mj.scene.geometry import block_outline, regular_polygon, square

INERTIA: Final[dict[Shape, float]] = {
    "square": 0.0037699111843077504,
    "circle": 0.0036,
    "pentagon": 0.0036611027179584824,
    "star": 0.004682686464592393,
}
"""Moments of inertia about the centre of blocks of mass 0.5, as in the original's engine."""
SIDES: Final = 3
"""The index of the sides among a block's geoms, after outline, fill and foot."""

PEBBLE_CORNERS: Final = 12
PEBBLE_HEIGHT: Final = 0.03  # world units
PEBBLE_OUTLINE: Final = 0.008  # width of the outline, world units


def block_mjcf(index: int, block: Block, dynamics: Dynamics, settings: PhysicsSettings) -> str:
    """The body `block<index>`."""
    name, inertia = f"block{index}", block_inertia(block.shape, block.mass)
    content = (
        f'<inertial pos="0 0 0" mass="{block.mass}" diaginertia="{numbers(inertia, inertia, inertia)}"/>'
        + style.visual_geom(f"{name}_outline", f"{block.shape}_outline", BLOCK_OUTLINE[block.colour])
        + style.visual_geom(f"{name}_fill", f"{block.shape}_fill", BLOCK_FILL[block.colour])
        + comment("a foot that presses on the ground with a constant force: dry friction")
        + foot(f"{name}_foot")
        + style.block_sides(f"{name}_sides", block.shape, block.colour)
        # in a body of their own, so that collision tests skip the visual geoms
        + f'<body name="{name}_collision">{collision_geoms(name, block.shape, block.mass, settings)}</body>'
    )
    hinge = f'class="spin" frictionloss="{numbers(dynamics.block_friction_torque)}"'
    return comment(f"Block {index}: {block.colour}, {block.shape}") + planar_body(name, block.pose, content, hinge)


def block_inertia(shape: Shape, mass: float) -> float:
    """The moment of inertia of a block about its centre."""
    return INERTIA[shape] * (mass / c.BLOCK_MASS)


def block_pair(index: int, block: Block, dynamics: Dynamics, settings: PhysicsSettings) -> str:
    """The contact of the block's foot with the floor."""
    return floor_pair(f"block{index}_foot", dynamics.block_friction_force, block.mass, settings)


@lru_cache(128)
def collision_geoms(name: str, shape: Shape, mass: float = c.BLOCK_MASS, settings: PhysicsSettings = SETTINGS) -> str:
    """The collision geoms of the block with this name, as MJCF: a disc, or edges and convex corners."""
    overlap = settings.debris_overlap if mass < DEBRIS_MASS else settings.block_overlap
    if shape == "circle":
        return f'<geom name="{name}_disc" class="disc" size="{numbers(c.BLOCK_SIZE - overlap)}"/>'
    if shape == "square":
        core = c.SQUARE_SIDE / 2 - overlap
        half = core + c.SQUARE_MARGIN
        box = f'<geom name="{name}_edges" class="edge" type="box" size="{numbers(half, half, 0.1)}"/>'
        return box + _corners(name, square(core), c.SQUARE_MARGIN)
    outline = inset(block_outline(shape), overlap)
    if shape == "star":
        radius = settings.star_tip_radius
        tips = regular_polygon(5, c.STAR_OUTER_RADIUS - settings.star_tip_depth - overlap - radius)
        # blunt tips also collide with other corners
        return _edges(name, outline, settings.star_edge_radius) + _corners(name, tips, radius, "disc")
    return polygon_geoms(name, outline, settings)


def polygon_geoms(name: str, outline: Points, settings: PhysicsSettings) -> str:
    """The collision geoms of a convex polygon: its edges and its corners. Their names begin with `name`."""
    radius = settings.vertex_radius
    return _edges(name, outline, settings.edge_radius) + _corners(name, inset(outline, radius), radius)


def _edges(name: str, outline: Points, radius: float) -> str:
    """Capsules whose outer sides are the edges of the outline."""
    ends = inset(outline, radius)
    return "".join(
        f'<geom name="{name}_edge{k}" class="edge" type="capsule" size="{numbers(radius)}" '
        f'fromto="{numbers(*ends[k - 1], 0, *ends[k], 0)}"/>'
        for k in range(len(ends))
    )


def _corners(name: str, points: Points, radius: float, kind: str = "vertex") -> str:
    """Spheres at these points."""
    return "".join(vertex(f"{name}_corner{k}", x, y, radius, kind) for k, (x, y) in enumerate(points))


@cache
def pebble_library() -> str:
    """The meshes of a pebble, as MJCF. Models with pebbles list them after the meshes that all models share."""
    outline = convex(disc(PEBBLE_CORNERS, c.PEBBLE_RADIUS), PEBBLE_HEIGHT)
    fill = convex(disc(PEBBLE_CORNERS, c.PEBBLE_RADIUS - PEBBLE_OUTLINE), PEBBLE_HEIGHT + style.LIFT)
    return mesh_mjcf("pebble_outline", outline) + mesh_mjcf("pebble_fill", fill)


def pebble_mjcf(index: int, pebble: Pebble) -> str:
    """The body `pebble<index>`."""
    name, inertia = f"pebble{index}", c.PEBBLE_MASS * c.PEBBLE_RADIUS**2 / 2
    disc_geom = f'<geom name="{name}_disc" class="disc" size="{numbers(c.PEBBLE_RADIUS)}"/>'
    content = (
        f'<inertial pos="0 0 0" mass="{c.PEBBLE_MASS}" diaginertia="{numbers(inertia, inertia, inertia)}"/>'
        + style.visual_geom(f"{name}_outline", "pebble_outline", style.DARK_GREY)
        + style.visual_geom(f"{name}_fill", "pebble_fill", style.GREY)
        + foot(f"{name}_foot")
        + style.solid(f"{name}_sides", style.cylinder_shape(c.PEBBLE_RADIUS, PEBBLE_HEIGHT), style.DARK_GREY)
        + f'<body name="{name}_collision">{disc_geom}</body>'
    )
    hinge = f'class="spin" frictionloss="{c.PEBBLE_FRICTION_TORQUE}"'
    return comment(f"Pebble {index}") + planar_body(name, (pebble.x, pebble.y, 0.0), content, hinge)


def pebble_pair(index: int, settings: PhysicsSettings = SETTINGS) -> str:
    """The contact of the pebble's foot with the floor."""
    return floor_pair(f"pebble{index}_foot", c.PEBBLE_FRICTION_FORCE, c.PEBBLE_MASS, settings)
