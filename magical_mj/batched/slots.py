"""One model for many scenes: slots for blocks, each with the collision geoms of every shape it may take.

MuJoCo Warp gives worlds their own sizes and poses of geoms, but not their own types. So a slot holds as many geoms of
each kind as the shape with most of them needs; those that a world's shape does not use are parked far above the plane,
and slots without a block far outside the arena.
"""

from __future__ import annotations

from collections import Counter
from functools import cache
from typing import Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.contacts import PRESS
from magical_mj.assets.robot import MOTORS, ROTORS, WHEELS
from magical_mj.assets.world import planar, world_mjcf
from magical_mj.batched.scenes import WorldScenes
from magical_mj.scene import Block, Dynamics, Robot, Scene
from magical_mj.scene.arrays import ABSENT
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


class BlockGeoms(NamedTuple):
    """A shape's collision geoms and inertia, as compiled."""

    kinds: list[Kind]
    geoms: dict[str, NDArray[np.float64]]
    """By field, a row for each geom."""
    bodies: dict[str, NDArray[np.float64]]
    """By field, rows for the block's body and for the body of its geoms."""
    dof_invweight0: NDArray[np.float64]


def _solid_body(model: mujoco.MjModel, slot: int) -> int:
    """The body that holds the collision geoms of a block."""
    return model.body(f"block{slot}").id + 1


def _collision_geoms(model: mujoco.MjModel, slot: int) -> NDArray[np.int64]:
    body = _solid_body(model, slot)
    return model.body_geomadr[body] + np.arange(model.body_geomnum[body])


@cache
def block_geoms(shape: Shape) -> BlockGeoms:
    """What MuJoCo makes of a block of this shape."""
    scene = Scene(Robot(0.0, -0.5, 0.0), (Block(shape, "red", 0.0, 0.5, 0.0),))
    model = mujoco.MjModel.from_xml_string(world_mjcf(scene, regions=""))
    geoms = _collision_geoms(model, 0)
    bodies = [model.body("block0").id, _solid_body(model, 0)]
    columns = (model.geom_type, model.geom_contype, model.geom_conaffinity)
    kinds = [tuple(int(column[geom]) for column in columns) for geom in geoms]
    first = model.body_dofadr[bodies[0]]
    return BlockGeoms(
        kinds=kinds,  # type: ignore[arg-type]
        geoms={name: getattr(model, name)[geoms].copy() for name in GEOM_FIELDS},
        bodies={name: getattr(model, name)[bodies].copy() for name in BODY_FIELDS},
        dof_invweight0=model.dof_invweight0[first : first + 3].copy(),
    )


def slotted_model(blocks: int) -> mujoco.MjModel:
    """The model whose every slot can be a block of any shape."""
    apart = tuple(Block("circle", "red", 2.0 * index, 0.0, 0.0) for index in range(blocks))
    spec = mujoco.MjSpec.from_string(world_mjcf(Scene(Robot(0.0, 0.0, 0.0), apart), regions=""))
    needed: Counter[tuple[str, int]] = Counter()
    for shape in SHAPES:
        for one, count in Counter(_classes(shape)).items():
            needed[one] = max(needed[one], count)
    unseen = [geom for geom in spec.geoms if geom.classname.name == "visual"]
    for element in (*unseen, *spec.lights, *spec.cameras):  # each kind would cost a launch in every substep
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


@cache
def _classes(shape: Shape) -> tuple[tuple[str, int], ...]:
    """Default class and type of each collision geom of a shape."""
    spec = mujoco.MjSpec.from_string(
        world_mjcf(Scene(Robot(0.0, -0.5, 0.0), (Block(shape, "red", 0.0, 0.5, 0.0),)), regions="")
    )
    return tuple((geom.classname.name, int(geom.type)) for geom in spec.body("block0").first_body().geoms)


class Slots:
    """Turns scenes into what differs between worlds of one slotted model.

    Args:
        model: see `slotted_model`.
        blocks: its number of slots.
    """

    def __init__(self, model: mujoco.MjModel, blocks: int) -> None:
        self._model, self._blocks = model, blocks
        self._geoms = [_collision_geoms(model, slot) for slot in range(blocks)]
        self._bodies = [(model.body(f"block{slot}").id, _solid_body(model, slot)) for slot in range(blocks)]
        self._joints = 3 * np.arange(blocks)

    def fields(self, scenes: WorldScenes) -> dict[str, NDArray[np.float64]]:
        """The values of all `FIELDS`, a row for each world."""
        worlds = len(scenes.shapes)
        made = {name: np.repeat(getattr(self._model, name)[None], worlds, axis=0) for name in FIELDS}
        for slot in range(self._blocks):
            geoms = self._geoms[slot]
            made["geom_pos"][:, geoms] = np.stack([0 * geoms, 0 * geoms, PARKED + 7.0 * geoms], axis=-1)
            for number, shape in enumerate(SHAPES):
                which = np.flatnonzero(scenes.shapes[:, slot] == number)
                if len(which):
                    self._become(made, which, slot, block_geoms(shape))
        self._drive(made, scenes.dynamics)
        return made

    def _become(
        self, made: dict[str, NDArray[np.float64]], worlds: NDArray[np.int64], slot: int, one: BlockGeoms
    ) -> None:
        """In these worlds, the slot holds this shape."""
        free = self._free(slot)
        places = np.array([free[kind].pop(0) for kind in one.kinds])
        for name, values in one.geoms.items():
            made[name][worlds[:, None], places] = values.reshape(len(places), *made[name].shape[2:])
        for name, values in one.bodies.items():
            made[name][worlds[:, None], list(self._bodies[slot])] = values
        made["dof_invweight0"][worlds[:, None], self._joints[slot] + np.arange(3)] = one.dof_invweight0

    def _free(self, slot: int) -> dict[Kind, list[int]]:
        model, found = self._model, {}
        for geom in self._geoms[slot].tolist():
            kind = int(model.geom_type[geom]), int(model.geom_contype[geom]), int(model.geom_conaffinity[geom])
            found.setdefault(kind, []).append(geom)
        return found

    def _drive(self, made: dict[str, NDArray[np.float64]], dynamics: NDArray[np.float64]) -> None:
        """The force caps of each world: all of them are in proportion to a friction of the model."""
        model = self._model
        usual = Dynamics()
        drive, turn, finger, force, torque = dynamics.T
        for wheel in WHEELS:
            pair = model.pair(wheel).id
            made["pair_friction"][:, pair, :2] *= (drive / usual.drive_force)[:, None]
        for names, share in ((ROTORS, turn / usual.turn_torque), (MOTORS.values(), finger / usual.finger_torque)):
            for name in names:
                made["tendon_frictionloss"][:, model.tendon(name).id] *= share
        for slot in range(self._blocks):
            made["pair_friction"][:, model.pair(f"block{slot}_foot").id, :2] = (force / PRESS)[:, None]
            made["dof_frictionloss"][:, self._joints[slot] + 2] = torque

    def positions(self, scenes: WorldScenes) -> NDArray[np.float64]:
        """MuJoCo's `qpos` of the scenes, a row for each world."""
        model, slots = self._model, np.arange(self._blocks)
        qpos = np.repeat(model.qpos0[None], len(scenes.shapes), axis=0)
        waiting = np.stack([OUTSIDE + 2.0 * slots, np.full(len(slots), OUTSIDE), np.zeros(len(slots))], axis=-1)
        poses = scenes.poses.copy()
        poses[:, 1:] = np.where((scenes.shapes == ABSENT)[..., None], waiting, poses[:, 1:])
        qpos[:, planar(self._blocks)] = poses
        fingers = [model.joint(name).qposadr[0] for name in ("left_finger", "right_finger")]
        qpos[:, fingers] = scenes.fingers
        return qpos
