"""The physics of a batch on MuJoCo Warp: the one file that knows its names, for it calls itself alpha.

Single precision, so worlds move as MuJoCo's do within rounding, until heaps make that chaotic. Three things are put
right: the solver's tolerance, which `put_model` raises; the friction of feet and wheels, whose impedance of 0.9999 is
off by 2e-4 of its distance to 1 in single precision; and the mid-phase, a flag that Warp does not know.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from torch import Tensor

from magical_mj.assets.contacts import SETTINGS, SUBSTEPS
from magical_mj.assets.robot import controls
from magical_mj.assets.world import planar
from magical_mj.batched.scenes import WorldScenes
from magical_mj.batched.slots import FIELDS, Slots, slotted_model
from magical_mj.scene.scene import MAX_NUMBER
from magical_mj.utils.errors import SettingsError

wp.config.log_level = wp.LOG_ERROR  # or it tells of every kernel that it compiles

CONTACTS: Final = 64
"""Room for contacts in each world on average: all share one pool. More are reported as an overflow."""
ROWS: Final = 224
"""Room for constraints in each world: contacts, dry friction, limits."""

DROPPED: Final = int(
    mjw.OverflowType.NEFC
    | mjw.OverflowType.NJMAX_NNZ
    | mjw.OverflowType.BROADPHASE
    | mjw.OverflowType.NARROWPHASE
    | mjw.OverflowType.CCD
)
"""The overflows by which contacts or constraints are lost; others say that the solver used all its iterations."""

STATE: Final = ("qpos", "qvel", "act", "ctrl", "qacc_warmstart")
"""The arrays of the simulation that the next step depends on, by their names."""


def check_device(name: str) -> str:
    """Warp's name of a device, if it is there.

    Raises:
        SettingsError: if it is not.
    """
    try:
        return str(wp.get_device(str(name)).alias)
    except (RuntimeError, ValueError) as error:
        devices = ", ".join(str(device.alias) for device in wp.get_devices())
        raise SettingsError(f"there is no device {name!r} here; there is {devices}") from error


class Physics:
    """Steps all worlds of a batch at once.

    Args:
        scenes: the first scenes; all later ones must have room in as many slots.
        device: Warp's name of the device.

    Attributes:
        worlds: how many.
        blocks: slots for blocks in each.
        model: the one model of all worlds, as MuJoCo compiles it.
        data: Warp's arrays of the simulation.
    """

    def __init__(self, scenes: WorldScenes, device: str = "cpu") -> None:
        self.worlds, self.blocks = scenes.shapes.shape
        self._device = device
        self.model = slotted_model(self.blocks)
        self.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
        self.model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)  # takes twice as long there
        self._slots = Slots(self.model, self.blocks)
        with wp.ScopedDevice(device):
            self._warp = mjw.put_model(self.model, batch_sizes=dict.fromkeys(FIELDS, self.worlds))
            self.data = mjw.make_data(self.model, nworld=self.worlds, nconmax=CONTACTS, njmax=ROWS)
        self._warp.opt.tolerance.fill_(SETTINGS.tolerance)
        self._warp.opt.warn_overflow = 0  # told by `overflowed` instead of printed
        self._fields = {name: wp.to_torch(getattr(self._warp, name)) for name in FIELDS}
        self._state = {name: wp.to_torch(getattr(self.data, name)) for name in STATE}
        self._overflow = wp.to_torch(self.data.overflow)
        self._controls = torch.tensor(controls(), dtype=torch.float32, device=device)
        self._planar = torch.from_numpy(planar(self.blocks)).to(device)
        self._fingers = torch.tensor(self._slots.fingers, device=device)
        self._graph: Any = None
        self.reset(scenes, torch.arange(self.worlds, device=device))

    def reset(self, scenes: WorldScenes, worlds: Tensor) -> None:
        """Puts scenes, at rest, into these worlds.

        Args:
            scenes: a row for each of the worlds.
            worlds: their numbers. Shape (n,), int64.
        """
        fields = self._slots.fields(scenes)
        impedance = self.model.pair_solimp[:, 0]  # feet press with a force in proportion to 1 / (1 - impedance)
        error = (1 - impedance.astype(np.float32).astype(np.float64)) / (1 - impedance)
        fields["pair_friction"][..., :2] *= error[:, None]
        for name, values in fields.items():
            place = self._fields[name]
            place[worlds] = torch.from_numpy(values).to(place).reshape(len(worlds), *place.shape[1:])
        for name, place in self._state.items():
            start = self._slots.positions(scenes) if name == "qpos" else np.zeros((len(worlds), *place.shape[1:]))
            place[worlds] = torch.from_numpy(start).to(place)
        self._overflow[worlds] = 0

    def get_state(self) -> dict[str, Tensor]:
        """All that the steps to come depend on, scenes aside; copies."""
        return {name: values.clone() for name, values in (*self._state.items(), ("overflow", self._overflow))}

    def set_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes back to a state of worlds that hold the same scenes."""
        for name, values in (*self._state.items(), ("overflow", self._overflow)):
            values[:] = state[name].to(values)

    def step(self, actions: Tensor, *, graph: bool = True) -> None:
        """One action in every world.

        Args:
            actions: numbers in 0..17. Shape (worlds,), int64.
            graph: on an accelerator, make all launches as one graph; else one by one, so that they can be watched.
        """
        self._state["ctrl"][:] = self._controls[actions]
        if graph and wp.get_device(self._device).is_cuda:
            self._launch_graph()
        else:
            self._substeps()

    def _launch_graph(self) -> None:
        """All launches of a control step as one: there are about a hundred in a substep."""
        if self._graph is None:
            before = {name: values.clone() for name, values in self._state.items()}
            with wp.ScopedDevice(self._device):
                self._substeps()  # compiles what a capture may not
                with wp.ScopedCapture() as capture:
                    self._substeps()
            self._graph = capture.graph
            for name, values in before.items():
                self._state[name][:] = values
        wp.capture_launch(self._graph)

    def _substeps(self) -> None:
        for _ in range(SUBSTEPS):
            mjw.step(self._warp, self.data)

    @property
    def poses(self) -> Tensor:
        """x, y, angle of the robot and then of each slot. Shape (worlds, 1 + blocks, 3), float32."""
        return self._state["qpos"][:, self._planar]

    @property
    def fingers(self) -> Tensor:
        """Angles of the left and the right finger. Shape (worlds, 2), float32."""
        return self._state["qpos"][:, self._fingers]

    @property
    def velocities(self) -> Tensor:
        """Of what `poses` holds, in units/s and rad/s. Shape (worlds, 1 + blocks, 3), float32."""
        return self._state["qvel"][:, self._planar]

    @property
    def broken(self) -> Tensor:
        """Worlds whose state is not finite, or too large for MuJoCo. Shape (worlds,), bool."""
        state = torch.cat([self._state["qpos"], self._state["qvel"]], dim=-1)
        return ~(state.abs() <= MAX_NUMBER).all(-1)

    @property
    def solved(self) -> tuple[Tensor, Tensor]:
        """Of the last substep: how many constraints there were, and the solver's iterations. Shape (worlds,) each."""
        return wp.to_torch(self.data.nefc), wp.to_torch(self.data.solver_niter)

    @property
    def overflowed(self) -> Tensor:
        """Worlds that had, since their reset, more contacts or constraints than there is room for: some were dropped.

        Shape (worlds,), bool.
        """
        return (self._overflow & DROPPED) != 0
