"""Compiled worlds: composer's physics, which also draws, and those that an environment keeps."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from typing import Final

import mujoco
import numpy as np
from dm_control import mjcf
from dm_control.mjcf.physics import _EMPTY_BINDING
from dm_control.mujoco import engine, index, wrapper

from magical_mj.assets.world import World
from magical_mj.rendering.canvas import Picture
from magical_mj.rendering.renderer import Renderer


class Simulation(mjcf.Physics):
    """The simulation of a world, at rest in its scene after each reset."""

    is_changed: bool = False
    """Whether it was compiled from composer's tree, to which anything may have been added."""
    _renderer: Renderer | None = None
    _named: engine.NamedIndexStructs | None = None

    @classmethod
    def of(cls, world: World) -> Simulation:
        """Compiles a world: its text, or composer's tree where somebody asked for it."""
        if world.tree is not None:
            simulation = cls.from_mjcf_model(world.tree)
            simulation.is_changed = True
            return simulation
        return cls.from_xml_string(world.mjcf())

    def _reload_from_data(self, data: wrapper.MjData) -> None:
        """As dm_control's, but names are indexed only when somebody asks for them: that takes as long as compiling."""
        self._data = data
        self._warnings = data.warning.number
        self._warnings_before = np.empty_like(self._warnings)
        self._new_warnings = np.empty(len(self._warnings), bool)
        self._bindings = {(): _EMPTY_BINDING}
        self._named = self._renderer = None
        if self._contexts:
            self._free_rendering_contexts()
        self.after_reset()

    @property
    def named(self) -> engine.NamedIndexStructs:
        """The model's and the state's arrays, indexed by name."""
        if self._named is None:
            axes = index.make_axis_indexers(self.model)
            structures = ((self.model, "mjmodel"), (self.data, "mjdata"))
            self._named = engine.NamedIndexStructs(*(index.struct_indexer(*each, axes) for each in structures))
        return self._named

    def step(self, nstep: int = 1) -> None:
        """As dm_control's, with its check for new warnings in a fifth of the time.

        Raises:
            dm_control.rl.control.PhysicsError: if the simulation has become unstable.
        """
        before = self._warnings.tobytes()
        if self.legacy_step:
            self._step_with_up_to_date_position_velocity(nstep)
        else:
            mujoco.mj_step(self.model.ptr, self.data.ptr, nstep)
        after = self._warnings.tobytes()
        if after != before:
            self._warnings[:] = np.frombuffer(before, self._warnings.dtype)
            with self.check_invalid_state():  # complains, or only logs
                self._warnings[:] = np.frombuffer(after, self._warnings.dtype)

    def draw(self, view: str, size: int, out: Picture | None = None) -> Picture:
        """A picture of the present state, fresh or in `out`. Shape (size, size, 3), RGB, top row first."""
        if self._renderer is None:
            self._renderer = Renderer(self.model.ptr)
        return self._renderer.draw(self.data.ptr, view, size, out)

    def free(self) -> None:
        """Frees the simulation and what it drew with."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        super().free()


class SimulationCache:
    """The simulations of the last few structures of world, least recently used first.

    Compiling takes fifty times as long as rewriting a model, and most episodes differ in numbers only.
    """

    KEPT: Final = 4

    def __init__(self) -> None:
        self._kept: OrderedDict[Hashable, Simulation] = OrderedDict()
        self.compiled = 0
        """How many were compiled so far."""

    def simulation(self, world: World, *, fresh: bool = False) -> Simulation:
        """A simulation that is, to the bit, as if compiled from `world`; earlier ones may be gone.

        Args:
            world: what to simulate; where somebody asked for its tree, and may have changed it, it is compiled.
            fresh: compile in any case, so that nothing that was done to an earlier model stays.
        """
        structure = world.structure
        simulation = self._kept.pop(structure, None)
        if simulation is not None and (fresh or world.tree is not None or simulation.is_changed):
            simulation.free()
            simulation = None
        if simulation is None:
            simulation = Simulation.of(world)
            self.compiled += 1
        else:
            world.rewrite(simulation.model.ptr, simulation.data.ptr)
        self._kept[structure] = simulation
        while len(self._kept) > self.KEPT:
            self._kept.popitem(last=False)[1].free()
        return simulation

    def free(self) -> None:
        """Frees them all."""
        while self._kept:
            self._kept.popitem()[1].free()
