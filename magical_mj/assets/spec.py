"""Specs: what MuJoCo compiles, put together from parts that were parsed once.

Parsing the text of a world takes longer than compiling what was parsed. Worlds with as many blocks and regions differ
in little but numbers, which `World.rewrite` writes into the compiled model, and the shapes of their blocks.
"""

from __future__ import annotations

from copy import copy
from functools import cache, lru_cache
from typing import Any, Final

import mujoco

from magical_mj.assets.block import INERTIA, collision_geoms
from magical_mj.assets.contacts import geom_classes
from magical_mj.assets.region import blank_regions_mjcf
from magical_mj.assets.world import Structure, world_mjcf
from magical_mj.constants import Shape
from magical_mj.scene import Block, Robot, Scene

_GEOM: Final = ("type", "size", "pos", "fromto")
"""What the geoms of a block that collide say of themselves; their classes say the rest."""


def world_spec(structure: Structure) -> mujoco.MjSpec:
    """A spec of the worlds of this structure, whose numbers are still to be written."""
    spec = _unshaped(len(structure.shapes), structure.dashes).copy()
    for index, shape in enumerate(structure.shapes):
        block = spec.body(f"block{index}")
        block.inertia = [INERTIA[shape]] * 3
        outline = block.first_geom()
        outline.meshname, block.next_geom(outline).meshname = f"{shape}_outline", f"{shape}_fill"
        solid = block.first_body()
        for kind, attributes in _solid_geoms(shape):
            geom = solid.add_geom(spec.find_default(kind))
            for name, value in attributes:  # twice as fast as naming them to `add_geom`
                setattr(geom, name, value)
    return spec


@lru_cache(16)
def _unshaped(blocks: int, dashes: tuple[int, ...]) -> mujoco.MjSpec:
    """A spec with so many blocks, which touch nothing, and with regions of so many dashes."""
    apart = tuple(Block("circle", "red", index, 0, 0) for index in range(blocks))
    spec = mujoco.MjSpec.from_string(world_mjcf(Scene(Robot(0, 0, 0), apart), regions=blank_regions_mjcf(dashes)))
    for index in range(blocks):
        for geom in spec.body(f"block{index}").first_body().geoms:
            spec.delete(geom)
    return spec


@cache
def _solid_geoms(shape: Shape) -> tuple[tuple[str, tuple[tuple[str, Any], ...]], ...]:
    """The geoms of a block of this shape that collide: class and attributes."""
    spec = mujoco.MjSpec.from_string(
        f"<mujoco><default>{geom_classes()}</default><worldbody>{collision_geoms(shape)}</worldbody></mujoco>"
    )
    return tuple(
        (geom.classname.name, tuple((name, copy(getattr(geom, name))) for name in _GEOM)) for geom in spec.geoms
    )
