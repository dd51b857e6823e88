"""The world of a scene: its MJCF model, its compiled model, and where the scene's things are in it.

Parsing the MJCF text of a world takes longer than compiling it. Worlds with the same numbers of blocks and regions
differ only in the shapes of their blocks and in numbers, which `World.rewrite` writes into the compiled model. So specs
are assembled from parts that are parsed once.
"""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable
from copy import copy
from functools import cache, lru_cache
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.assets import style
from magical_mj.assets.block import (
    SIDES,
    block_inertia,
    block_mjcf,
    block_pair,
    collision_geoms,
    pebble_library,
    pebble_mjcf,
    pebble_pair,
    rewrite_block,
)
from magical_mj.assets.contacts import FOOT_DEPTH, FOOT_RADIUS, SETTINGS, TIMESTEP, PhysicsSettings, default_classes
from magical_mj.assets.meshes import library
from magical_mj.assets.mjcf import move_body, numbers
from magical_mj.assets.region import BONE, blank_regions_mjcf, dash_count, regions_mjcf, rewrite_region
from magical_mj.assets.robot import JOINTS, actuators_mjcf, rewrite_robot, robot_mjcf, robot_pairs, tendons_mjcf
from magical_mj.scene import Block, Pebble, Robot, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.bodies import GRIPPER, body_named
from magical_mj.scene.constants import Shape

MEMORY: Final = '<size memory="33M"/>'
"""Only about 50 kB of it are used, and unused memory costs nothing. Blocks above 32 MiB are returned to the system by
glibc; with smaller ones, memory would become fragmented as models come and go: 1 MB per 300 models."""
APART: Final = '<exclude body1="left_finger" body2="right_finger"/>'
"""The fingers do not touch each other."""


WALLS: Final = {"left": (-1, 0), "right": (1, 0), "bottom": (0, -1), "top": (0, 1)}
"""Wall -> the unit vector from the middle of the arena towards it."""


def world_mjcf(
    scene: Scene, settings: PhysicsSettings = SETTINGS, regions: str | None = None, *, empty: bool = False
) -> str:
    """The model as MJCF text: the scene is its reference pose. Blocks come before the robot, which is drawn over them.

    Args:
        scene: the scene.
        settings: parameters of the simulation.
        regions: the skins of the regions, as MJCF; None: those of the scene.
        empty: leave out all but the arena, with the meshes that the scene needs.

    Elliptic cones make friction equal in all directions. Explicit Euler with a fixed step is the original's
    integrator; implicit damping would soften servos whose gain is chosen for this step. With so few geoms, testing all
    pairs is faster than the mid-phase, and sparse matrices make piles of blocks cheaper. Blocks at rest sleep until
    something touches them: most blocks, most of the time.
    """
    dynamics, robot, half = scene.dynamics, scene.robot, scene.half_width
    bodies = contacts = tendons = actuators = meshes = ""
    if not empty:
        blocks, pebbles = list(enumerate(scene.blocks)), list(enumerate(scene.pebbles))
        bodies = "".join(block_mjcf(index, block, dynamics, settings) for index, block in blocks)
        bodies += robot_mjcf(robot, settings, half)
        bodies += "".join(pebble_mjcf(index, pebble) for index, pebble in pebbles)
        contacts = "".join(block_pair(index, block, dynamics, settings) for index, block in blocks)
        contacts += robot_pairs(robot, dynamics, settings)
        contacts += "".join(pebble_pair(index, settings) for index, _ in pebbles)
        contacts += APART if body_named(robot.body).fingers else ""
        tendons, actuators = tendons_mjcf(robot, dynamics, settings), actuators_mjcf(robot.body)
        meshes = pebble_library() if pebbles else ""
        regions = regions_mjcf(scene.regions) if regions is None else regions
    integrator = f'timestep="{numbers(TIMESTEP)}" gravity="0 0 0" integrator="Euler" cone="elliptic"'
    limits = f'iterations="{settings.iterations}" tolerance="{settings.tolerance}"'
    return f"""
<mujoco model="magical_mj">
  <!-- Ten steps of 12.5 ms are one action. What has come to rest sleeps until something touches it. -->
  <compiler angle="radian" autolimits="true" usethread="false"/>
  <option {integrator} solver="Newton" jacobian="sparse" {limits} impratio="{numbers(settings.impratio)}">
    <flag eulerdamp="disable" midphase="disable" sleep="enable"/>
  </option>
  {MEMORY}
  {style.LOOK}
  <!-- What geoms are: two meet if a bit of the contype of one is in the conaffinity of the other -->
  <default>{default_classes(settings)}</default>
  <!-- What things look like -->
  <asset>{style.SKY}</asset>
  <!-- The world -->
  <worldbody>{_arena(half)}{bodies}</worldbody>
  <deformable>{regions or ""}</deformable>
  <!-- Friction with the ground: force cap / pressure -->
  <contact>{contacts}</contact>
  <!-- Servos -->
  <tendon>{tendons}</tendon>
  <actuator>{actuators}</actuator>
  <!-- Flat polygons, in which things are drawn, and the sides of pentagons and stars -->
  <asset>{library(robot.body, half)}{meshes}</asset>
</mujoco>"""


def _arena(half: float) -> str:
    """The static part of the world: floor, walls, their look, lamps, the allo camera, and the regions' body."""
    sides = "".join(style.wall_sides(f"{wall}_wall_sides", x, y, half) for wall, (x, y) in WALLS.items())
    walls = ""
    for wall, (x, y) in WALLS.items():
        pos, size = numbers((half + 1) * x, (half + 1) * y, 0), f"{1 + 2 * abs(y)} {1 + 2 * abs(x)} 1"
        for kind in ("wall", "finger_wall"):  # separate bodies, so that the broad phase skips what is far from them
            geom = f'<geom name="{wall}_{kind}" class="{kind}" type="box" size="{size}"/>'
            walls += f'<body name="{wall}_{kind}" pos="{pos}">{geom}</body>'
    return f"""
<!-- The arena: the ground, the white workspace, what the flat pictures show beyond it, the line between -->
<geom name="floor" class="floor" type="plane" size="0 0 1" pos="0 0 {numbers(FOOT_DEPTH - FOOT_RADIUS)}"/>
{style.solid("workspace", f'type="plane" size="{numbers(half, half, 1)}"', style.WHITE)}
{style.visual_geom("surround", "surround", style.LIGHT_GREY, f'group="{style.TASK_GROUP}"')}
{style.visual_geom("border", "border", style.ARENA_BORDER)}
{sides}
<!-- Two walls on each side: of two geoms that touch the larger friction counts, and fingers have their own -->
{walls}
<!-- Four lamps, for soft shadows -->
{style.lamps_mjcf()}
<!-- The whole workspace from above; the robot has the other camera of the task -->
{style.allo_camera(half)}
<!-- Goal regions: drawn, never solid -->
<body name="{BONE}"/>"""


class Structure(NamedTuple):
    """What two worlds must have in common so that their models differ in numbers only."""

    shapes: tuple[Shape, ...]
    """The shape of each block."""
    dashes: tuple[int, ...]
    """The number of quads for the border of each region."""
    masses: tuple[float, ...]
    """The mass of each block."""
    body: str = GRIPPER
    """The robot's body."""
    half_width: float = c.ARENA_HALF_WIDTH
    """Of the arena."""
    pebbles: int = 0
    """The number of pebbles."""


_COMPILER: Final = threading.Lock()
"""Specs are made of parts that all threads share."""
_GEOM: Final = ("name", "type", "size", "pos", "fromto", "meshname")
"""The attributes of geoms that differ between shapes."""


def world_spec(structure: Structure) -> mujoco.MjSpec:
    """A spec of the worlds with this structure; `World.rewrite` writes the numbers into the compiled model."""
    spec = _unshaped(*structure[1:]).copy()
    find_class = cache(spec.find_default)
    for index, (shape, mass) in enumerate(zip(structure.shapes, structure.masses, strict=True)):
        block = spec.body(f"block{index}")
        block.inertia = [block_inertia(shape, mass)] * 3
        outline = block.first_geom()
        outline.meshname, block.next_geom(outline).meshname = f"{shape}_outline", f"{shape}_fill"
        for body, geoms in (
            (block, style.block_sides(f"block{index}_sides", shape, "red")),
            (block.first_body(), collision_geoms(f"block{index}", shape, mass)),
        ):
            for kind, attributes in _parsed(geoms):
                geom = body.add_geom(find_class(kind))
                for name, value in attributes:  # twice as fast as naming them to `add_geom`
                    setattr(geom, name, value)
    return spec


@lru_cache(16)
def world_model(structure: Structure) -> mujoco.MjModel:
    """The compiled model of the worlds with this structure (0.2 MB). It is shared: copy it before `World.rewrite`."""
    with _COMPILER:
        return world_spec(structure).compile()


@lru_cache(16)
def _unshaped(
    dashes: tuple[int, ...], masses: tuple[float, ...], body: str, half_width: float, pebbles: int
) -> mujoco.MjSpec:
    """A spec of the worlds with this structure, with blocks that have no sides and no collision geoms."""
    apart = tuple(Block("circle", "red", index, 0, 0, mass) for index, mass in enumerate(masses))
    grit = tuple(Pebble(0, -index) for index in range(pebbles))
    scene = Scene(Robot(0, 0, 0, body=body), apart, half_width=half_width, pebbles=grit)
    spec = mujoco.MjSpec.from_string(world_mjcf(scene, regions=blank_regions_mjcf(dashes)))
    for index in range(len(masses)):
        block = spec.body(f"block{index}")
        for geom in (block.geoms[SIDES], *block.first_body().geoms):  # sides and collision geoms
            spec.delete(geom)
    return spec


@cache
def _parsed(geoms: str) -> tuple[tuple[str, tuple[tuple[str, Any], ...]], ...]:
    """The class of each of these geoms, and the attributes in which it differs from its class."""
    spec = mujoco.MjSpec.from_string(
        f"<mujoco><default>{default_classes()}</default><worldbody>{geoms}</worldbody></mujoco>"
    )

    def own_attributes(geom: Any) -> tuple[tuple[str, Any], ...]:
        values = ((name, getattr(geom, name), getattr(geom.classname.geom, name)) for name in _GEOM)
        return tuple((name, copy(value)) for name, value, default in values if str(value) != str(default))

    return tuple((geom.classname.name, own_attributes(geom)) for geom in spec.geoms)


def planar(blocks: int) -> NDArray[np.int64]:
    """Where x, y and angle of the robot, and then of each block, stand in `qpos` and `qvel`. Shape (1 + blocks, 3)."""
    first = 3 * blocks
    return np.array([range(start, start + 3) for start in (first, *range(0, first, 3))])


class World:
    """A scene in the simulator: its model, rewritten from another one, and the scene that `qpos` describes.

    Args:
        scene: the scene in which the world's episodes start.

    Attributes:
        structure: worlds with the same structure share a compiled model, apart from its numbers.
        has_fingers: whether the robot has any.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.structure = Structure(
            tuple(block.shape for block in scene.blocks),
            tuple(map(dash_count, scene.regions)),
            tuple(block.mass for block in scene.blocks),
            scene.robot.body,
            scene.half_width,
            len(scene.pebbles),
        )
        self._planar = planar(len(scene.blocks))
        self.has_fingers = body_named(scene.robot.body).fingers
        self._fingers = 3 * len(scene.blocks) + JOINTS.index("left_finger")

    def rewrite(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        *,
        nested: bool = False,
        change: Callable[[mujoco.MjModel], None] | None = None,
    ) -> None:
        """Turns the compiled model of a world with the same structure into the model of this world.

        Compiling takes more than ten times as long. Constants that the compiler derives are computed again.

        Args:
            model: the compiled model.
            data: a state of it, which is used to compute constants, and is to be reset afterwards.
            nested: whether robot and blocks are models of their own that were attached to the arena's, whose names
                begin with theirs, as in "block0/block0_x".
            change: changes further numbers of the model.
        """
        scene = self.scene
        rewrite_robot(model, scene.robot, scene.dynamics, "robot/" if nested else "")
        for index, block in enumerate(scene.blocks):
            rewrite_block(model, index, block, scene.dynamics, f"block{index}/" if nested else "")
        for index, pebble in enumerate(scene.pebbles):
            name = f"pebble{index}"
            move_body(model, name, (pebble.x, pebble.y, 0.0), f"{name}/" if nested else "")
        for index, region in enumerate(scene.regions):
            rewrite_region(model, index, region)
        if change is not None:
            change(model)
        mujoco.mj_setConst(model, data)

    def poses(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The planar coordinates (or velocities) of the robot and then of each block. Shape (1 + blocks, 3).

        Args:
            values: MuJoCo's `qpos` (or `qvel`).
        """
        return values[self._planar]

    def fingers(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """The angles of the left and the right finger; those of the scene, of a body without. Shape (2,)."""
        if not self.has_fingers:
            return np.array(self.scene.robot.fingers)
        return qpos[self._fingers : self._fingers + 2]

    def read(self, qpos: NDArray[np.float64]) -> Scene:
        """The scene as it is now."""
        robot, *blocks = self.poses(qpos).tolist()
        now = self.scene.moved(robot, blocks)
        if self.has_fingers:
            fingers = tuple(self.fingers(qpos).tolist())
            now = dataclasses.replace(now, robot=dataclasses.replace(now.robot, fingers=fingers))
        if self.scene.pebbles:
            places = qpos[-3 * len(self.scene.pebbles) :].reshape(-1, 3)[:, :2].tolist()
            now = dataclasses.replace(now, pebbles=tuple(Pebble(x, y) for x, y in places))
        return now
