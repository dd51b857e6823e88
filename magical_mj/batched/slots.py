"""One model for many scenes: slots for blocks, each with the collision geoms of every shape it may take.

MuJoCo Warp gives worlds their own sizes and poses of geoms, but not their own types. So a slot holds as many geoms of
each kind as the shape with most of them needs; those that a world's shape does not use are parked far above the plane,
and slots without a block far outside the arena. What a block or a force cap is in a model, `magical_mj.assets` says:
blocks are copied from models with one block of each shape.
"""

from __future__ import annotations

from collections import Counter
from functools import cache
from typing import Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.contacts import foot_friction
from magical_mj.assets.robot import torque_caps, wheel_caps
from magical_mj.assets.world import planar, world_mjcf
from magical_mj.batched.scenes import ABSENT, WorldScenes
from magical_mj.scene import Block, Robot, Scene
from magical_mj.scene.constants import SHAPES, Shape

GEOM_FIELDS: Final = ("geom_size", "geom_pos", "geom_quat", "geom_rbound", "geom_aabb")
BODY_FIELDS: Final = ("body_inertia", "body_invweight0")
FIELDS: Final = (
    *GEOM_FIELDS,
    *BODY_FIELDS,
    "dof_invweight0",
    "dof_frictionloss",
    "pair_friction",
    "tendon_frictionloss",
)
"""What differs between the worlds of a batch, by the names of MuJoCo's model."""

PARKED: Final = 1000.0  # world units above the plane; each geom at a height of its own, or they would meet there
OUTSIDE: Final = 10.0  # world units from the centre, where slots without a block wait, two apart

Kind = tuple[int, int, int]
"""Type, contype and conaffinity of a geom."""
Fields = dict[str, NDArray[np.float64]]
"""Arrays by the names of MuJoCo's model."""


class BlockParts(NamedTuple):
    """What MuJoCo makes of a block of one shape."""

    classes: list[tuple[str, int]]
    """Default class and type of each of its collision geoms."""
    kinds: list[Kind]
    """Of each collision geom."""
    geoms: Fields
    """A row for each collision geom."""
    bodies: Fields
    """Rows for the block's body and for the body of its geoms."""
    dof_invweight0: NDArray[np.float64]


class Slot(NamedTuple):
    """Where a block is in a model."""

    bodies: list[int]
    """The block's body, and the body that holds its collision geoms."""
    geoms: NDArray[np.int64]
    """The collision geoms."""
    joints: NDArray[np.int64]
    """The degrees of freedom x, y and angle."""

    @classmethod
    def of(cls, model: mujoco.MjModel, number: int) -> Slot:
        """Where this block is."""
        body = model.body(f"block{number}").id
        solid = body + 1
        geoms = model.body_geomadr[solid] + np.arange(model.body_geomnum[solid])
        return cls([body, solid], geoms, model.body_dofadr[body] + np.arange(3))


@cache
def block_parts(shape: Shape) -> BlockParts:
    """What MuJoCo makes of a block of this shape."""
    scene = Scene(Robot(0.0, -0.5, 0.0), (Block(shape, "red", 0.0, 0.5, 0.0),))
    spec = mujoco.MjSpec.from_string(world_mjcf(scene, regions=""))
    model = spec.compile()
    slot = Slot.of(model, 0)
    solid = spec.body("block0").first_body()
    return BlockParts(
        classes=[(geom.classname.name, int(geom.type)) for geom in solid.geoms],
        kinds=[_kind(model, geom) for geom in slot.geoms],
        geoms={name: getattr(model, name)[slot.geoms].copy() for name in GEOM_FIELDS},
        bodies={name: getattr(model, name)[slot.bodies].copy() for name in BODY_FIELDS},
        dof_invweight0=model.dof_invweight0[slot.joints].copy(),
    )


def _kind(model: mujoco.MjModel, geom: int) -> Kind:
    return int(model.geom_type[geom]), int(model.geom_contype[geom]), int(model.geom_conaffinity[geom])


def slotted_model(blocks: int) -> mujoco.MjModel:
    """The model whose every slot can be a block of any shape."""
    apart = tuple(Block("circle", "red", 2.0 * index, 0.0, 0.0) for index in range(blocks))
    spec = mujoco.MjSpec.from_string(world_mjcf(Scene(Robot(0.0, 0.0, 0.0), apart), regions=""))
    needed: Counter[tuple[str, int]] = Counter()
    for shape in SHAPES:
        needed |= Counter(block_parts(shape).classes)  # the greater number of each
    drawn = [geom for geom in spec.geoms if geom.classname.name == "visual"]
    for element in (*drawn, *spec.lights, *spec.cameras):  # each kind would cost a launch in every substep
        spec.delete(element)
    for index in range(blocks):
        body = spec.body(f"block{index}").first_body()
        for geom in body.geoms:
            spec.delete(geom)
        for (name, kind), count in sorted(needed.items()):
            for _ in range(count):
                geom = body.add_geom(spec.find_default(name))
                geom.type, geom.size = mujoco.mjtGeom(kind), [0.01, 0.01, 0.01]
    model = spec.compile()
    frictionless = (model.geom_contype | model.geom_conaffinity) == 0
    model.geom_friction[frictionless] = 1.0  # theirs is that of named pairs; Warp warns of zeros
    return model


class Slots:
    """Turns scenes into what differs between worlds of one slotted model.

    Args:
        model: see `slotted_model`.
        blocks: its number of slots.

    Attributes:
        fingers: where the angles of the left and the right finger are in `qpos`.
    """

    def __init__(self, model: mujoco.MjModel, blocks: int) -> None:
        self._model = model
        self._slots = [Slot.of(model, number) for number in range(blocks)]
        self.fingers = [int(model.joint(name).qposadr[0]) for name in ("left_finger", "right_finger")]

    def fields(self, scenes: WorldScenes) -> Fields:
        """The values of all `FIELDS`, a row for each world."""
        worlds = len(scenes.shapes)
        fields = {name: np.repeat(getattr(self._model, name)[None], worlds, axis=0) for name in FIELDS}
        for number, slot in enumerate(self._slots):
            heights = PARKED + 7.0 * slot.geoms
            fields["geom_pos"][:, slot.geoms] = np.stack([0 * heights, 0 * heights, heights], axis=-1)
            for index, shape in enumerate(SHAPES):
                where = np.flatnonzero(scenes.shapes[:, number] == index)
                if len(where):
                    self._write_block(fields, where, slot, block_parts(shape))
        self._write_dynamics(fields, scenes.dynamics)
        return fields

    def _write_block(self, fields: Fields, worlds: NDArray[np.int64], slot: Slot, block: BlockParts) -> None:
        """In these worlds, the slot holds this block."""
        free: dict[Kind, list[int]] = {}
        for geom in slot.geoms.tolist():
            free.setdefault(_kind(self._model, geom), []).append(geom)
        geoms = np.array([free[kind].pop(0) for kind in block.kinds])
        rows = worlds[:, None]
        for name, values in block.geoms.items():
            fields[name][rows, geoms] = values.reshape(len(geoms), *fields[name].shape[2:])
        for name, values in block.bodies.items():
            fields[name][rows, slot.bodies] = values
        fields["dof_invweight0"][rows, slot.joints] = block.dof_invweight0

    def _write_dynamics(self, fields: Fields, dynamics: NDArray[np.float64]) -> None:
        """The force caps of each world."""
        model = self._model
        drive, turn, finger, force, torque = dynamics.T
        feet = {f"block{number}_foot": force for number in range(len(self._slots))}
        for name, forces in (wheel_caps(drive) | feet).items():
            fields["pair_friction"][:, model.pair(name).id, :2] = foot_friction(forces)[:, None]
        for name, torques in torque_caps(turn, finger).items():
            fields["tendon_frictionloss"][:, model.tendon(name).id] = torques
        for slot in self._slots:
            fields["dof_frictionloss"][:, slot.joints[2]] = torque

    def positions(self, scenes: WorldScenes) -> NDArray[np.float64]:
        """MuJoCo's `qpos` of the scenes, a row for each world."""
        numbers = np.arange(len(self._slots))
        qpos = np.repeat(self._model.qpos0[None], len(scenes.shapes), axis=0)
        waiting = np.stack([OUTSIDE + 2.0 * numbers, np.full(len(numbers), OUTSIDE), 0.0 * numbers], axis=-1)
        poses = scenes.poses.copy()
        poses[:, 1:] = np.where((scenes.shapes == ABSENT)[..., None], waiting, poses[:, 1:])
        qpos[:, planar(len(numbers))] = poses
        qpos[:, self.fingers] = scenes.fingers
        return qpos
