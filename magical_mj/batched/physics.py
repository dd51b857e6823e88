"""The physics of a batch on MuJoCo Warp. Only this file uses its API, which is still declared alpha.

MuJoCo Warp calls each environment of a batch a world (`nworld`). It computes in single precision, so environments move
like MuJoCo's within rounding, until heaps of blocks make the movement chaotic. Three settings are corrected:

- the solver's tolerance, which `put_model` raises,
- the friction of feet and wheels, because the difference between 1 and their impedance, 0.9999, has a relative error of
  2e-4 in single precision,
- the mid-phase of collision detection, which Warp does not support.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, Final, NamedTuple

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray
from torch import Tensor

from magical_mj.assets.contacts import PRESS, SETTINGS, SUBSTEPS
from magical_mj.assets.robot import controls, torque_caps, wheel_caps
from magical_mj.assets.scene_mjcf import scene_mjcf
from magical_mj.assets.scene_model import own_coordinates
from magical_mj.batched.scenes import ABSENT, BatchScenes
from magical_mj.scene import Block, Robot, Scene
from magical_mj.scene.constants import SHAPES, Shape
from magical_mj.scene.scene import MAX_NUMBER
from magical_mj.utils.errors import SettingsError

wp.config.log_level = wp.LOG_ERROR  # otherwise it reports each compiled kernel

CONTACTS: Final = 64
"""The maximum mean number of contacts per environment: all share one pool. An excess is reported as an overflow."""
ROWS: Final = 224
"""The maximum number of constraints in each environment: contacts, dry friction, limits."""

DROPPED: Final = int(
    mjw.OverflowType.NEFC
    | mjw.OverflowType.NJMAX_NNZ
    | mjw.OverflowType.BROADPHASE
    | mjw.OverflowType.NARROWPHASE
    | mjw.OverflowType.CCD
)
"""The overflows that lose contacts or constraints. Others report that the solver used all its iterations."""

STATE: Final = ("qpos", "qvel", "act", "ctrl", "qacc_warmstart")
"""The names of the simulation's arrays that determine the next step."""

GEOM_FIELDS: Final = ("geom_size", "geom_pos", "geom_quat", "geom_rbound", "geom_aabb")
BODY_FIELDS: Final = ("body_inertia", "body_invweight0")
SHAPE_FIELDS: Final = (*GEOM_FIELDS, *BODY_FIELDS, "dof_invweight0")
DYNAMICS_FIELDS: Final = ("dof_frictionloss", "pair_friction", "tendon_frictionloss")
FIELDS: Final = (*SHAPE_FIELDS, *DYNAMICS_FIELDS)
"""The names of the model's arrays that differ between the environments of a batch."""

PARKED: Final = 1000.0  # world units above the plane; each geom has its own height, so that they do not collide
OUTSIDE: Final = 10.0  # distance of slots without a block from the centre, world units; they are two apart

Kind = tuple[int, int, int]
"""The type, contype and conaffinity of a geom."""
Fields = dict[str, NDArray[np.float64]]
"""Arrays by the names of MuJoCo's model."""


def check_device(name: str) -> str:
    """Warp's name of a device. Raises a `SettingsError` if it does not exist."""
    try:
        return str(wp.get_device(str(name)).alias)
    except (RuntimeError, ValueError) as error:
        devices = ", ".join(str(device.alias) for device in wp.get_devices())
        raise SettingsError(f"this machine has no device {name!r}; it has {devices}") from error


class Physics:
    """Steps all environments of a batch together. Later scenes must fit into as many slots as the first ones.

    Attributes:
        num_envs: the number of environments.
        blocks: the number of slots for blocks in each environment.
        model: the MuJoCo model that all environments share.
        data: Warp's arrays of the simulation.
        state: those of `STATE` as tensors, which share their memory.
    """

    def __init__(self, scenes: BatchScenes, device: str = "cpu") -> None:
        self.num_envs, self.blocks = scenes.shapes.shape
        self._device = device
        self.model = slotted_model(self.blocks)
        self.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
        self.model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)  # takes twice as long in Warp
        self._slots = [Slot.of(self.model, number) for number in range(self.blocks)]
        with wp.ScopedDevice(device):
            self._warp = mjw.put_model(self.model, batch_sizes=dict.fromkeys(FIELDS, self.num_envs))
            self.data = mjw.make_data(self.model, nworld=self.num_envs, nconmax=CONTACTS, njmax=ROWS)
        self._warp.opt.tolerance.fill_(SETTINGS.tolerance)
        self._warp.opt.warn_overflow = 0  # reported by `overflowed` instead
        self._fields = {name: wp.to_torch(getattr(self._warp, name)) for name in FIELDS}
        self.state = {name: wp.to_torch(getattr(self.data, name)) for name in STATE}
        self._overflow = wp.to_torch(self.data.overflow)
        self._lasting = {**self.state, "overflow": self._overflow}
        self._controls = torch.tensor(controls(), dtype=torch.float32, device=device)
        self._planar = torch.from_numpy(own_coordinates(self.blocks).qpos).to(device)
        self._fingers = torch.from_numpy(own_coordinates(self.blocks).fingers).to(device)
        self._graph: Any = None
        self._by_shape = {name: torch.from_numpy(values).to(self._fields[name]) for name, values in self._parts()}
        self._slot_of = {name: torch.from_numpy(slots).to(device) for name, slots in self._owners()}
        self.reset(scenes, torch.arange(self.num_envs, device=device))

    def reset(self, scenes: BatchScenes, envs: Tensor) -> None:
        """Places scenes, at rest, into the environments with these numbers, shape (n,), int64."""
        shapes = torch.from_numpy(scenes.shapes).to(self._planar)  # ABSENT is the last row of `_by_shape`
        for name, values in self._by_shape.items():
            columns = torch.arange(values.shape[1], device=self._device)
            field = self._fields[name]
            field[envs] = values[shapes[:, self._slot_of[name]], columns].reshape(len(envs), *field.shape[1:])
        for name, values in self._dynamics(scenes.dynamics).items():
            field = self._fields[name]
            field[envs] = torch.from_numpy(values).to(field).reshape(len(envs), *field.shape[1:])
        for name, values in self.state.items():
            start = self._positions(scenes) if name == "qpos" else np.zeros((len(envs), *values.shape[1:]))
            values[envs] = torch.from_numpy(start).to(values)
        self._overflow[envs] = 0

    def _parts(self) -> Iterator[tuple[str, NDArray[np.float64]]]:
        """Yields the fields that depend on shapes, with a row for each shape in all slots, and last for no block."""
        fields = {name: np.repeat(getattr(self.model, name)[None], len(SHAPES) + 1, axis=0) for name in SHAPE_FIELDS}
        for slot in self._slots:
            heights = PARKED + 7.0 * slot.geoms
            fields["geom_pos"][:, slot.geoms] = np.stack([0 * heights, 0 * heights, heights], axis=-1)
            for row, shape in enumerate(SHAPES):
                self._write_block(fields, row, slot, block_parts(shape))
        yield from fields.items()

    def _owners(self) -> Iterator[tuple[str, NDArray[np.int64]]]:
        """Yields the same fields' slots: for each geom, body or degree of freedom. 0 for those that have no slot."""
        for name in SHAPE_FIELDS:
            owners = np.zeros(len(getattr(self.model, name)), np.int64)
            for number, slot in enumerate(self._slots):
                owners[slot.rows(name)] = number
            yield name, owners

    def _write_block(self, fields: Fields, row: int, slot: Slot, block: BlockParts) -> None:
        """Writes this block into the slot in a row of the fields."""
        free: dict[Kind, list[int]] = {}
        for geom in slot.geoms.tolist():
            free.setdefault(_kind(self.model, geom), []).append(geom)
        geoms = np.array([free[kind].pop(0) for kind in block.kinds])
        for name, values in block.geoms.items():
            fields[name][row, geoms] = values.reshape(len(geoms), *fields[name].shape[2:])
        for name, values in block.bodies.items():
            fields[name][row, slot.bodies] = values
        fields["dof_invweight0"][row, slot.joints] = block.dof_invweight0

    def _dynamics(self, dynamics: NDArray[np.float64]) -> Fields:
        """The fields that depend on the force caps, a row for each environment."""
        fields = {name: np.repeat(getattr(self.model, name)[None], len(dynamics), axis=0) for name in DYNAMICS_FIELDS}
        drive, turn, finger, force, torque = dynamics.T
        feet = {f"block{number}_foot": force for number in range(len(self._slots))}
        for name, forces in (wheel_caps(drive) | feet).items():
            fields["pair_friction"][:, self.model.pair(name).id, :2] = (forces / PRESS)[:, None]
        for name, torques in torque_caps(turn, finger).items():
            fields["tendon_frictionloss"][:, self.model.tendon(name).id] = torques
        for slot in self._slots:
            fields["dof_frictionloss"][:, slot.joints[2]] = torque
        impedance = self.model.pair_solimp[:, 0]  # feet press with a force in proportion to 1 / (1 - impedance)
        error = (1 - impedance.astype(np.float32).astype(np.float64)) / (1 - impedance)
        fields["pair_friction"][..., :2] *= error[:, None]
        return fields

    def _positions(self, scenes: BatchScenes) -> NDArray[np.float64]:
        """MuJoCo's `qpos` of the scenes, a row for each environment."""
        numbers = np.arange(len(self._slots))
        qpos = np.repeat(self.model.qpos0[None], len(scenes.shapes), axis=0)
        waiting = np.stack([OUTSIDE + 2.0 * numbers, np.full(len(numbers), OUTSIDE), 0.0 * numbers], axis=-1)
        poses = scenes.poses.copy()
        poses[:, 1:] = np.where((scenes.shapes == ABSENT)[..., None], waiting, poses[:, 1:])
        coordinates = own_coordinates(len(numbers))
        qpos[:, coordinates.qpos], qpos[:, coordinates.fingers] = poses, scenes.fingers
        return qpos

    def get_state(self) -> dict[str, Tensor]:
        """Copies of all data that determine later steps, except the scenes."""
        return {name: values.clone() for name, values in self._lasting.items()}

    def set_state(self, state: Mapping[str, Tensor]) -> None:
        """Restores a state of environments with the same scenes."""
        for name, values in self._lasting.items():
            values[:] = state[name].to(values)

    def step(self, actions: Tensor, *, graph: bool = True) -> None:
        """Performs an action in 0..17 in each environment, (envs,) int64. To trace kernels, set `graph` to False."""
        self.state["ctrl"][:] = self._controls[actions]
        if graph and wp.get_device(self._device).is_cuda:
            self._launch_graph()
        else:
            self._substeps()

    def _launch_graph(self) -> None:
        """Launches a control step as one graph: each substep has about a hundred launches."""
        if self._graph is None:
            before = {name: values.clone() for name, values in self.state.items()}
            with wp.ScopedDevice(self._device):
                self._substeps()  # compiles kernels, which is not possible during a capture
                with wp.ScopedCapture() as capture:
                    self._substeps()
            self._graph = capture.graph
            for name, values in before.items():
                self.state[name][:] = values
        wp.capture_launch(self._graph)

    def _substeps(self) -> None:
        for _ in range(SUBSTEPS):
            mjw.step(self._warp, self.data)

    @property
    def poses(self) -> Tensor:
        """x, y, angle of the robot and then of each slot. Shape (envs, 1 + blocks, 3), float32."""
        return self.state["qpos"][:, self._planar]

    @property
    def fingers(self) -> Tensor:
        """Angles of the left and the right finger. Shape (envs, 2), float32."""
        return self.state["qpos"][:, self._fingers]

    @property
    def velocities(self) -> Tensor:
        """The velocities of `poses`, in units/s and rad/s. Shape (envs, 1 + blocks, 3), float32."""
        return self.state["qvel"][:, self._planar]

    @property
    def broken(self) -> Tensor:
        """Whether an environment's state is not finite, or too large for MuJoCo. Shape (envs,), bool."""
        state = torch.cat([self.state["qpos"], self.state["qvel"]], dim=-1)
        return ~(state.abs() <= MAX_NUMBER).all(-1)

    @property
    def overflowed(self) -> Tensor:
        """Whether an environment has lost contacts or constraints since its reset, because there were too many.

        Shape (envs,), bool.
        """
        return (self._overflow & DROPPED) != 0


class BlockParts(NamedTuple):
    """The compiled model of a block of one shape."""

    classes: list[tuple[str, int]]
    """The default class and type of each collision geom."""
    kinds: list[Kind]
    """The kind of each collision geom."""
    geoms: Fields
    """The geoms' arrays, with a row for each collision geom."""
    bodies: Fields
    """The bodies' arrays, with rows for the block's body and for the body of its geoms."""
    dof_invweight0: NDArray[np.float64]


class Slot(NamedTuple):
    """The indices of a block in a model."""

    bodies: list[int]
    """The block's body, and the body with its collision geoms."""
    geoms: NDArray[np.int64]
    """The collision geoms."""
    joints: NDArray[np.int64]
    """The degrees of freedom x, y and angle."""

    def rows(self, field: str) -> NDArray[np.int64]:
        """The indices of the slot in one of `SHAPE_FIELDS`."""
        if field in GEOM_FIELDS:
            return self.geoms
        if field in BODY_FIELDS:
            return np.array(self.bodies)
        return self.joints

    @classmethod
    def of(cls, model: mujoco.MjModel, number: int) -> Slot:
        """The indices of block `number`."""
        body = model.body(f"block{number}").id
        solid = body + 1
        geoms = model.body_geomadr[solid] + np.arange(model.body_geomnum[solid])
        return cls([body, solid], geoms, model.body_dofadr[body] + np.arange(3))


@cache
def block_parts(shape: Shape) -> BlockParts:
    """Compiles a block of this shape."""
    scene = Scene(Robot(0.0, -0.5, 0.0), (Block(shape, "red", 0.0, 0.5, 0.0),))
    spec = mujoco.MjSpec.from_string(scene_mjcf(scene, regions=""))
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
    """One model for many scenes. It has slots for blocks, each with the collision geoms of every shape.

    In MuJoCo Warp, environments have their own geom sizes and poses, but share the geom types. So for each kind of
    geom, a slot has the maximum number over all shapes. Unused geoms are parked far above the plane, and slots without
    a block far outside the arena. `magical_mj.assets` defines the geoms of a block and the force caps: blocks are
    copied from models with one block of each shape.
    """
    apart = tuple(Block("circle", "red", 2.0 * index, 0.0, 0.0) for index in range(blocks))
    spec = mujoco.MjSpec.from_string(scene_mjcf(Scene(Robot(0.0, 0.0, 0.0), apart), regions=""))
    needed: Counter[tuple[str, int]] = Counter()
    for shape in SHAPES:
        needed |= Counter(block_parts(shape).classes)  # the maximum number of each
    drawn = [geom for geom in spec.geoms if geom.classname.name == "visual"]
    for element in (*drawn, *spec.lights, *spec.cameras):  # each kind would need a launch in every substep
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
    model.geom_friction[frictionless] = 1.0  # unused, since their pairs define friction; Warp warns of zeros
    return model
