"""Compiled worlds: composer's physics, which also draws, and those that an environment keeps."""

from __future__ import annotations

import threading
import weakref
from collections import OrderedDict
from collections.abc import Hashable
from typing import ClassVar, Final

import mujoco
import numpy as np
from dm_control import mjcf
from dm_control.mjcf.physics import _EMPTY_BINDING
from dm_control.mujoco import engine, index, wrapper

from magical_mj.assets.world import World, world_spec
from magical_mj.rendering.canvas import Picture
from magical_mj.rendering.renderer import Renderer

_RK4: Final = mujoco.mjtIntegrator.mjINT_RK4.value


class Simulation(mjcf.Physics):
    """The simulation of a world, at rest in its scene after each reset."""

    is_ours: bool = False
    """Whether it was compiled from our own spec; to composer's tree anything may have been added."""
    _renderer: Renderer | None = None
    _named: engine.NamedIndexStructs | None = None

    @classmethod
    def of(cls, world: World) -> Simulation:
        """Compiles a world: its spec, or composer's tree where somebody asked for it."""
        if world.tree is not None:
            return cls.from_mjcf_model(world.tree)
        model = wrapper.MjModel(world_spec(world.structure).compile())
        data = wrapper.MjData(model)
        world.rewrite(model.ptr, data.ptr)
        mujoco.mj_resetData(model.ptr, data.ptr)  # to the scene
        simulation = cls(data)
        simulation.is_ours = True
        return simulation

    def _reload_from_data(self, data: wrapper.MjData) -> None:
        """As dm_control's, but names are indexed only when somebody asks for them: that takes as long as compiling."""
        self._data = data
        self._warnings = data.warning.number
        self._warnings_before = np.empty_like(self._warnings)
        self._new_warnings = np.empty(len(self._warnings), bool)
        self._bindings = {(): _EMPTY_BINDING}
        self._named = self._renderer = None
        self.is_ours = False
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
        """As dm_control's, with less Python around the same physics.

        Raises:
            dm_control.rl.control.PhysicsError: if the simulation has become unstable.
        """
        model, data, before = self.model.ptr, self.data.ptr, self._warnings.tobytes()
        if self.legacy_step and model.opt.integrator != _RK4:
            mujoco.mj_step2(model, data)  # what comes before was done at the end of the last step
            mujoco.mj_step(model, data, nstep - 1)
        else:
            mujoco.mj_step(model, data, nstep)
        if self.legacy_step:
            mujoco.mj_step1(model, data)
        after = self._warnings.tobytes()
        if after != before:
            self._warnings[:] = np.frombuffer(before, self._warnings.dtype)
            with self.check_invalid_state():  # complains, or only logs
                self._warnings[:] = np.frombuffer(after, self._warnings.dtype)

    def draw(self, view: str, size: int, out: Picture | None = None) -> Picture:
        """A picture of the present state, fresh or in `out`. Shape (size, size, 3), RGB, top row first."""
        if self._renderer is None:
            self._renderer = Renderer(self.model.ptr, ours=self.is_ours)
        return self._renderer.draw(self.data.ptr, view, size, out)

    def free(self) -> None:
        """Frees the simulation and what it drew with."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        super().free()


class SimulationCache:
    """The simulations of an environment: the one in use, and idle ones of the last few structures of world.

    Compiling takes more than ten times as long as rewriting a model, and most episodes differ in numbers only. Each
    takes 0.8 MB, so how many are idle is bounded for all environments of the process too. The least recently used go
    first.
    """

    KEPT: Final = 4
    """For an environment, with the one in use."""
    IDLE: Final = 4
    """In the process."""

    _idle: ClassVar[OrderedDict[tuple[weakref.ref[SimulationCache], Hashable], None]] = OrderedDict()
    _lock: ClassVar = threading.Lock()

    def __init__(self) -> None:
        self._me: weakref.ref[SimulationCache] = weakref.ref(self)
        self._kept: dict[Hashable, Simulation] = {}
        self._current: Hashable = None
        self.compiled = 0
        """How many were compiled so far."""

    def simulation(self, world: World, *, fresh: bool = False) -> Simulation:
        """A simulation that is, to the bit, as if compiled from `world`; earlier ones may be gone.

        Args:
            world: what to simulate; where somebody asked for its tree, and may have changed it, it is compiled.
            fresh: compile in any case, so that nothing that was done to an earlier model stays.
        """
        structure = world.structure
        simulation = self._take(structure)
        if simulation is not None and (fresh or world.tree is not None or not simulation.is_ours):
            simulation.free()
            simulation = None
        if simulation is None:
            simulation = Simulation.of(world)
            self.compiled += 1
        else:
            world.rewrite(simulation.model.ptr, simulation.data.ptr)
        self._use(structure, simulation)
        return simulation

    def _take(self, structure: Hashable) -> Simulation | None:
        """The simulation of this structure, if it is kept; it is kept no longer."""
        with self._lock:
            self._idle.pop((self._me, structure), None)
            return self._kept.pop(structure, None)

    def _use(self, structure: Hashable, simulation: Simulation) -> None:
        """Keeps this one, now in use; the one before becomes idle."""
        surplus = []
        with self._lock:
            if self._current in self._kept:
                self._idle[self._me, self._current] = None
            self._kept[structure] = simulation
            self._current = structure
            if len(self._kept) > self.KEPT:
                self._idle.move_to_end((self._me, next(iter(self._kept))), last=False)
            while len(self._kept) > self.KEPT or len(self._idle) > self.IDLE:
                owner, oldest = self._idle.popitem(last=False)[0]
                cache = owner()
                if cache is not None:  # or they went with their environment
                    surplus.append(cache._kept.pop(oldest))
        for idle in surplus:
            idle.free()

    def free(self) -> None:
        """Frees them all."""
        for structure in list(self._kept):
            simulation = self._take(structure)
            if simulation is not None:
                simulation.free()
