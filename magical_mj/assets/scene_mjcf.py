"""The MJCF text of a scene: the arena, the blocks, the robot and the goal regions."""

from __future__ import annotations

from typing import Final

from magical_mj.assets import style
from magical_mj.assets.block import block_mjcf, block_pair, pebble_library, pebble_mjcf, pebble_pair
from magical_mj.assets.contacts import FOOT_DEPTH, FOOT_RADIUS, SETTINGS, TIMESTEP, PhysicsSettings, default_classes
from magical_mj.assets.meshes import library
from magical_mj.assets.mjcf import numbers
from magical_mj.assets.region import BONE, regions_mjcf
from magical_mj.assets.robot import actuators_mjcf, robot_mjcf, robot_pairs, tendons_mjcf
from magical_mj.scene import Scene
from magical_mj.scene.bodies import body_named

MEMORY: Final = '<size memory="33M"/>'
"""MuJoCo's arena. Only about 50 kB are used, and unused memory costs nothing. glibc returns allocations above 32 MiB to
the system. Smaller ones would fragment memory as models are created and freed: 1 MB per 300 models."""
APART: Final = '<exclude body1="left_finger" body2="right_finger"/>'
"""The fingers do not touch each other."""
WALLS: Final = {"left": (-1, 0), "right": (1, 0), "bottom": (0, -1), "top": (0, 1)}
"""Wall -> the unit vector from the middle of the arena towards it."""


def scene_mjcf(
    scene: Scene, settings: PhysicsSettings = SETTINGS, regions: str | None = None, *, empty: bool = False
) -> str:
    """The MJCF text of a scene, whose poses are the reference poses. The robot follows the blocks: it is drawn on top.

    Args:
        scene: the scene.
        settings: parameters of the simulation.
        regions: the skins of the regions, as MJCF; None: those of the scene.
        empty: write only the arena, and the meshes that the scene needs.

    Elliptic cones make friction equal in all directions. Explicit Euler with a fixed step is the original's
    integrator; implicit damping would soften servos whose gain is chosen for this step. The model has few geoms, so
    testing all pairs is faster than the mid-phase. Sparse matrices make piles of blocks cheaper. Blocks at rest sleep
    until something touches them, which saves time: most blocks rest most of the time.
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
  <!-- Ten steps of 12.5 ms are one action. Blocks at rest sleep until something touches them. -->
  <compiler angle="radian" autolimits="true" usethread="false"/>
  <option {integrator} solver="Newton" jacobian="sparse" {limits} impratio="{numbers(settings.impratio)}">
    <flag eulerdamp="disable" midphase="disable" sleep="enable"/>
  </option>
  {MEMORY}
  {style.LOOK}
  <!-- Classes. Two geoms collide if the contype of one shares a bit with the conaffinity of the other -->
  <default>{default_classes(settings)}</default>
  <!-- Colours -->
  <asset>{style.SKY}</asset>
  <!-- The arena, the blocks and the robot -->
  <worldbody>{_arena(half)}{bodies}</worldbody>
  <deformable>{regions or ""}</deformable>
  <!-- Friction with the ground: force cap / pressure -->
  <contact>{contacts}</contact>
  <!-- Servos -->
  <tendon>{tendons}</tendon>
  <actuator>{actuators}</actuator>
  <!-- Meshes: the flat polygons that the cameras ego and allo see, and the sides of pentagons and stars -->
  <asset>{library(robot.body, half)}{meshes}</asset>
</mujoco>"""


def _arena(half: float) -> str:
    """The static part of the model: floor, walls, lamps, the camera allo, and the body of the regions."""
    sides = "".join(style.wall_sides(f"{wall}_wall_sides", x, y, half) for wall, (x, y) in WALLS.items())
    walls = ""
    for wall, (x, y) in WALLS.items():
        pos, size = numbers((half + 1) * x, (half + 1) * y, 0), f"{1 + 2 * abs(y)} {1 + 2 * abs(x)} 1"
        for kind in ("wall", "finger_wall"):  # separate bodies: the broad phase skips distant pairs of bodies
            geom = f'<geom name="{wall}_{kind}" class="{kind}" type="box" size="{size}"/>'
            walls += f'<body name="{wall}_{kind}" pos="{pos}">{geom}</body>'
    return f"""
<!-- The arena: the ground, the white workspace, the grey area around it in flat pictures, the line between them -->
<geom name="floor" class="floor" type="plane" size="0 0 1" pos="0 0 {numbers(FOOT_DEPTH - FOOT_RADIUS)}"/>
{style.solid("workspace", f'type="plane" size="{numbers(half, half, 1)}"', style.WHITE)}
{style.visual_geom("surround", "surround", style.LIGHT_GREY, f'group="{style.TASK_GROUP}"')}
{style.visual_geom("border", "border", style.ARENA_BORDER)}
{sides}
<!-- Two walls on each side, for the fingers and for the rest: MuJoCo uses the larger friction of two geoms -->
{walls}
<!-- Four lamps, for soft shadows -->
{style.lamps_mjcf()}
<!-- The camera that sees the whole workspace from above; the other camera is on the robot -->
{style.allo_camera(half)}
<!-- Goal regions: drawn, without collisions -->
<body name="{BONE}"/>"""
