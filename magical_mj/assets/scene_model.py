"""The compiled model of a scene, and the coordinates of its objects.

Parsing MJCF text takes longer than compiling it. The models of scenes with the same number of blocks and regions differ
only in the shapes of blocks and in numbers. So specs are assembled from parts that are parsed once, and
`SceneModel.rewrite` writes the numbers into the compiled model.

Models that this package compiles list a scene's coordinates and controls in one order, and demonstrations are recorded
in that order. Users may add joints and actuators to the model of a composer environment. There, indices are looked up
by name.
"""

from __future__ import annotations

import dataclasses
import itertools
import threading
from collections.abc import Callable, Iterator
from copy import copy
from functools import cache, lru_cache
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.assets import style
from magical_mj.assets.block import SIDES, block_inertia, collision_geoms
from magical_mj.assets.contacts import PRESS, default_classes
from magical_mj.assets.mjcf import AXES
from magical_mj.assets.region import blank_regions_mjcf, dash_count, region_corners
from magical_mj.assets.robot import MOTORS, ROTORS, actuators, joints, torque_caps, wheel_caps
from magical_mj.assets.scene_mjcf import scene_mjcf
from magical_mj.scene import Block, Dynamics, GoalRegion, Pebble, Pose, Robot, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.bodies import GRIPPER, body_named
from magical_mj.scene.constants import Shape
from magical_mj.scene.geometry import quaternion, slide_axes
from magical_mj.utils.errors import SettingsError


class Structure(NamedTuple):
    """Scenes with equal structures have models that differ only in numbers."""

    shapes: tuple[Shape, ...]
    """The shape of each block."""
    dashes: tuple[int, ...]
    """The number of quads for the border of each region."""
    masses: tuple[float, ...]
    """The mass of each block."""
    body: str = GRIPPER
    """The robot's body."""
    half_width: float = c.ARENA_HALF_WIDTH
    """Half of the arena's side, in world units."""
    pebbles: int = 0
    """The number of pebbles."""


_COMPILER: Final = threading.Lock()
"""Held while compiling: specs share parts, also between threads."""
_GEOM: Final = ("name", "type", "size", "pos", "fromto", "meshname")
"""The attributes of geoms that differ between shapes."""


def scene_spec(structure: Structure) -> mujoco.MjSpec:
    """A spec for scenes of this structure; `SceneModel.rewrite` writes the numbers into the compiled model."""
    spec = _unshaped(*structure[1:]).copy()
    find_class = cache(spec.find_default)
    for index, (shape, mass) in enumerate(zip(structure.shapes, structure.masses, strict=True)):
        block = spec.body(f"block{index}")
        block.inertia = [block_inertia(shape, mass)] * 3
        outline = block.first_geom()
        outline.meshname, block.next_geom(outline).meshname = f"{shape}_outline", f"{shape}_fill"
        for body, geoms in zip((block, block.first_body()), _shape_geoms(index, shape, mass), strict=True):
            for kind, attributes in geoms:
                geom = body.add_geom(find_class(kind))
                for name, value in attributes:  # twice as fast as passing them to `add_geom`
                    setattr(geom, name, value)
    return spec


@lru_cache(16)
def compiled_model(structure: Structure) -> mujoco.MjModel:
    """The compiled model for scenes of this structure (0.2 MB). It is cached and must not be changed."""
    with _COMPILER:
        return scene_spec(structure).compile()


def new_model(structure: Structure) -> mujoco.MjModel:
    """A model for scenes of this structure, for `SceneModel.rewrite`."""
    if next(_requests(structure)) == 0:  # many structures occur once, and a copy takes a third of a compilation
        with _COMPILER:
            return scene_spec(structure).compile()
    return copy(compiled_model(structure))


@lru_cache(64)
def _requests(structure: Structure) -> Iterator[int]:  # noqa: ARG001
    """Counts the requests of a structure."""
    return itertools.count()


@lru_cache(16)
def _unshaped(
    dashes: tuple[int, ...], masses: tuple[float, ...], body: str, half_width: float, pebbles: int
) -> mujoco.MjSpec:
    """A spec for scenes of this structure, with blocks that have no sides and no collision geoms."""
    blocks = tuple(Block("circle", "red", index, 0, 0, mass) for index, mass in enumerate(masses))
    discs = tuple(Pebble(0, -index) for index in range(pebbles))
    scene = Scene(Robot(0, 0, 0, body=body), blocks, half_width=half_width, pebbles=discs)
    spec = mujoco.MjSpec.from_string(scene_mjcf(scene, regions=blank_regions_mjcf(dashes)))
    for index in range(len(masses)):
        block = spec.body(f"block{index}")
        for geom in (block.geoms[SIDES], *block.first_body().geoms):  # sides and collision geoms
            spec.delete(geom)
    return spec


_Geoms = tuple[tuple[str, tuple[tuple[str, Any], ...]], ...]


@lru_cache(256)  # writing and parsing the text takes longer than adding the geoms
def _shape_geoms(index: int, shape: Shape, mass: float) -> tuple[_Geoms, _Geoms]:
    """The geoms that a block's shape determines: its sides, and those for collisions; see `_parsed`."""
    name = f"block{index}"
    return _parsed(style.block_sides(f"{name}_sides", shape, "red")), _parsed(collision_geoms(name, shape, mass))


def _parsed(geoms: str) -> _Geoms:
    """For each of these geoms: its class, and the attributes that differ from those of the class."""
    spec = mujoco.MjSpec.from_string(
        f"<mujoco><default>{default_classes()}</default><worldbody>{geoms}</worldbody></mujoco>"
    )

    def own_attributes(geom: Any) -> tuple[tuple[str, Any], ...]:
        values = ((name, getattr(geom, name), getattr(geom.classname.geom, name)) for name in _GEOM)
        return tuple((name, copy(value)) for name, value, default in values if str(value) != str(default))

    return tuple((geom.classname.name, own_attributes(geom)) for geom in spec.geoms)


Indices = NDArray[np.int64]

_KINDS: Final = {name.removeprefix("mjOBJ_").lower(): kind.value for name, kind in mujoco.mjtObj.__members__.items()}
"""Kind of object -> MuJoCo's number for it. Reading the enum takes longer than finding an object."""

FINGERS: Final = ("left_finger", "right_finger")


class Coordinates(NamedTuple):
    """Indices into MuJoCo's vectors."""

    qpos: Indices
    """x, y and angle of the robot, and then of each block. Shape (1 + blocks, 3)."""
    qvel: Indices
    """Velocities of the same coordinates. Shape (1 + blocks, 3)."""
    fingers: Indices
    """Indices into `qpos`: the left and the right finger. Shape (2,), without fingers (0,)."""
    pebbles: Indices
    """Indices into `qpos`: x, y and angle of each pebble. Shape (pebbles, 3)."""
    ctrl: Indices
    """The robot's actuators. Shape (6,), without fingers (4,)."""


def index_of(model: mujoco.MjModel, kind: str, name: str) -> int:
    """The index of an object in a compiled model. Faster than the model's own accessors.

    Args:
        model: a compiled model.
        kind: "joint", "geom" and so on, as in `mujoco.mjtObj`.
        name: the object's name.

    Raises:
        SettingsError: if no object has this name: users of a composer environment can remove elements.
    """
    index = mujoco.mj_name2id(model, _KINDS[kind], name)
    if index < 0:
        raise SettingsError(
            f"the MJCF tree lacks the {kind} {name!r}, which its scene needs: do not remove or rename it"
        )
    return index


@lru_cache(64)
def own_coordinates(blocks: int, body: str = GRIPPER, pebbles: int = 0) -> Coordinates:
    """The coordinates in a model that this package compiles.

    Args:
        blocks: the number of blocks.
        body: the robot's body.
        pebbles: the number of pebbles.
    """
    axes, order = len(AXES), joints(body)
    robot_start = axes * blocks  # blocks come first, then the robot, then pebbles
    pebbles_start = robot_start + len(order)
    poses = np.arange(axes) + np.array([robot_start, *range(0, robot_start, axes)])[:, None]
    fingers = [robot_start + order.index(name) for name in FINGERS] if body_named(body).fingers else []
    pebble_poses = np.arange(pebbles_start, pebbles_start + axes * pebbles).reshape(-1, axes)
    return Coordinates(poses, poses, np.array(fingers, np.int64), pebble_poses, np.arange(len(actuators(body))))


def find_coordinates(model: mujoco.MjModel, blocks: int, body: str = GRIPPER, pebbles: int = 0) -> Coordinates:
    """The coordinates in the model of a composer environment, which may contain more than the scene.

    Raises:
        SettingsError: if the model lacks a joint or an actuator of the scene.
    """

    def find(*names: str, kind: str = "joint") -> Indices:
        return np.array([index_of(model, kind, name) for name in names], np.int64)

    def planar(*bodies: str) -> Indices:
        names = (f"{body}/{body}_{axis}/" for body in bodies for axis in AXES)
        return find(*names).reshape(-1, len(AXES))

    poses = planar("robot", *(f"block{index}" for index in range(blocks)))
    fingers = find(*(f"robot/{name}" for name in FINGERS if body_named(body).fingers))
    pebble_poses = planar(*(f"pebble{index}" for index in range(pebbles)))
    return Coordinates(
        model.jnt_qposadr[poses].astype(np.int64),
        model.jnt_dofadr[poses].astype(np.int64),
        model.jnt_qposadr[fingers].astype(np.int64),
        model.jnt_qposadr[pebble_poses].astype(np.int64),
        find(*(f"robot/{name}" for name in actuators(body)), kind="actuator"),
    )


class SceneModel:
    """Writes a scene into a compiled model, and reads the current scene from `qpos`.

    Args:
        scene: the initial scene.

    Attributes:
        structure: scenes with equal structures share a compiled model, apart from its numbers.
        has_fingers: whether the robot has fingers.
        coordinates: the indices of the scene's objects in MuJoCo's vectors. They are those of a model of this package
            until `find_in` is called.
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
        self.has_fingers = body_named(scene.robot.body).fingers
        self._counts = len(scene.blocks), scene.robot.body, len(scene.pebbles)
        self.coordinates = own_coordinates(*self._counts)

    def find_in(self, model: mujoco.MjModel) -> None:
        """Looks up the coordinates in the compiled model of a composer environment, which may contain more objects.

        Raises:
            SettingsError: if the model lacks a joint or an actuator of the scene.
        """
        self.coordinates = find_coordinates(model, *self._counts)

    def rewrite(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        *,
        nested: bool = False,
        change: Callable[[mujoco.MjModel], None] | None = None,
    ) -> None:
        """Turns the compiled model of another scene with the same structure into the model of this scene.

        Compiling takes more than ten times as long. The constants that the compiler derives are computed again.

        Args:
            model: the compiled model, which is changed.
            data: a data of this model, used to compute constants. Reset it afterwards.
            nested: whether robot and blocks are separate models attached to the arena's model, so that names have a
                prefix: "block0/block0_x".
            change: a function that changes further numbers of the model.
        """
        scene = self.scene
        _rewrite_robot(model, scene.robot, scene.dynamics, "robot/" if nested else "")
        for index, block in enumerate(scene.blocks):
            _rewrite_block(model, index, block, scene.dynamics, f"block{index}/" if nested else "")
        for index, pebble in enumerate(scene.pebbles):
            name = f"pebble{index}"
            _move_body(model, name, (pebble.x, pebble.y, 0.0), f"{name}/" if nested else "")
        for index, region in enumerate(scene.regions):
            rewrite_region(model, index, region)
        if change is not None:
            change(model)
        mujoco.mj_setConst(model, data)

    def poses(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """x, y (world units) and angle (rad) of the robot and then of each block. Shape (1 + blocks, 3)."""
        return qpos[self.coordinates.qpos]

    def velocities(self, qvel: NDArray[np.float64]) -> NDArray[np.float64]:
        """Velocities of the robot and then of each block, in units/s and rad/s. Shape (1 + blocks, 3)."""
        return qvel[self.coordinates.qvel]

    def fingers(self, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
        """Angles of the left and the right finger, rad; without fingers, those in the scene. Shape (2,)."""
        if not self.has_fingers:
            return np.array(self.scene.robot.fingers)
        return qpos[self.coordinates.fingers]

    def read(self, qpos: NDArray[np.float64]) -> Scene:
        """The current scene."""
        robot, *blocks = self.poses(qpos).tolist()
        now = self.scene.moved(robot, blocks)
        if self.has_fingers:
            fingers = tuple(self.fingers(qpos).tolist())
            now = dataclasses.replace(now, robot=dataclasses.replace(now.robot, fingers=fingers))
        if self.scene.pebbles:
            positions = qpos[self.coordinates.pebbles[:, :2]].tolist()
            now = dataclasses.replace(now, pebbles=tuple(Pebble(x, y) for x, y in positions))
        return now


# All functions that rewrite a model have the same result as compiling. `scope` is "", or the prefix of names, such as
# "block0/", if dm_control attached the body as a model of its own. dm_control then puts the joints x, y and angle into
# the attachment frame, and appends "/" to names in that frame.


def _rewrite_robot(model: mujoco.MjModel, robot: Robot, dynamics: Dynamics, scope: str) -> None:
    """Writes pose and force caps of the robot into a compiled model."""
    _move_body(model, "robot", robot.pose, scope)
    for wheel, force in wheel_caps(dynamics.drive_force).items():
        model.pair_friction[index_of(model, "pair", wheel), :2] = force / PRESS
    caps = torque_caps(dynamics.turn_torque, dynamics.finger_torque)
    fingers = body_named(robot.body).fingers
    for motor in (*ROTORS, *MOTORS.values()) if fingers else ROTORS:
        model.tendon_frictionloss[index_of(model, "tendon", f"{scope}{motor}")] = caps[motor]
    for side, angle in zip(MOTORS, robot.fingers, strict=True) if fingers else ():
        joint = index_of(model, "joint", f"{scope}{side}_finger")
        model.body_quat[model.jnt_bodyid[joint]] = quaternion(angle)
        model.qpos0[model.jnt_qposadr[joint]] = angle


def _rewrite_block(model: mujoco.MjModel, index: int, block: Block, dynamics: Dynamics, scope: str) -> None:
    """Writes pose, colour and friction of a block into a compiled model."""
    name = f"block{index}"
    spin = _move_body(model, name, block.pose, scope)
    model.dof_frictionloss[model.jnt_dofadr[spin]] = dynamics.block_friction_torque
    model.pair_friction[index_of(model, "pair", f"{name}_foot"), :2] = dynamics.block_friction_force / PRESS
    outline, fill = style.levels(style.BLOCK_OUTLINE[block.colour]), style.levels(style.BLOCK_FILL[block.colour])
    for part, colour in (("outline", outline), ("fill", fill), ("sides", outline)):
        model.geom_rgba[index_of(model, "geom", f"{scope}{name}_{part}")] = colour


def _move_body(model: mujoco.MjModel, name: str, pose: Pose, scope: str) -> int:
    """Writes the reference pose of a planar body into a compiled model. Returns the index of its joint "angle"."""
    joints = [index_of(model, "joint", f"{scope}{name}_{axis}{'/' if scope else ''}") for axis in AXES]
    body = model.jnt_bodyid[joints[0]]
    model.body_pos[body, :2] = pose[:2]
    model.body_quat[body] = quaternion(pose[2])
    model.jnt_axis[joints[:2]] = slide_axes(pose[2])
    model.qpos0[model.jnt_qposadr[joints]] = pose
    return joints[2]


def rewrite_region(model: mujoco.MjModel, index: int, region: GoalRegion) -> None:
    """Writes box and colour of a region into a compiled model.

    Raises:
        ValueError: if the model has fewer quads than the region needs. Models of equal `Structure` have enough.
    """
    for part, palette in (("fill", style.REGION_FILL), ("border", style.REGION_BORDER)):
        skin = index_of(model, "skin", f"region{index}_{part}")
        model.skin_rgba[skin] = style.levels(palette[region.colour])
        first, count = model.skin_vertadr[skin], model.skin_vertnum[skin]
        model.skin_vert[first : first + count] = region_corners(region, index, count // 4)
