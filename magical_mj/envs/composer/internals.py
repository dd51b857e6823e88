"""All uses of dm_control's private names, with the reason for each; no other module of this package uses any.

dm_control may change them without notice: `pyproject.toml` caps its version, and a test names those that are missing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from dm_control import composer, mjcf
from dm_control.composer.environment import HOOK_NAMES
from dm_control.mjcf.physics import _EMPTY_BINDING
from dm_control.mujoco import engine, index, wrapper


class UnindexedPhysics(mjcf.Physics):
    """Composer's physics, but its index of names is built only when it is first used."""

    def _reload_from_data(self, data: wrapper.MjData) -> None:
        """As dm_control's, without indexing all arrays by name, which takes as long as compiling the model."""
        self._data = data  # read by the properties `data` and `model`
        self.warning_counts = data.warning.number
        self._warnings = self.warning_counts  # this and the next two are compared by `check_invalid_state`
        self._warnings_before = np.empty_like(self._warnings)
        self._new_warnings = np.empty(len(self._warnings), bool)
        self._bindings = {(): _EMPTY_BINDING}  # the cache of `bind`; dm_control starts it with the empty binding
        self._named = None
        if self._contexts:  # with which `render` drew another model
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


class OpenEnvironment(composer.Environment):
    """Composer's environment with public methods in the places where ours differs from it."""

    extra_hooks: frozenset[str] = frozenset()
    """The names of the hooks to which users have added functions."""

    def simulate(self) -> mjcf.Physics:
        """The simulation of the task's present world; the previous one is not used any more."""
        raise NotImplementedError

    def make_updater(self) -> Any:
        """The object that updates the observations: composer's own updater, or one with the same methods."""
        return super()._make_observation_updater()

    def add_extra_hook(self, hook_name: str, hook_callable: Callable[..., Any]) -> None:
        """Adds a function to a hook, as composer does, and remembers the hook's name, which composer hides."""
        super().add_extra_hook(hook_name, hook_callable)
        self.extra_hooks |= {hook_name}

    def user_hooks(self) -> frozenset[str]:
        """`extra_hooks`, and the hooks that attached entities implement."""
        entities = self.task.root_entity.iter_entities()
        return self.extra_hooks | {
            name
            for it in entities
            for name in HOOK_NAMES
            if getattr(type(it), name) is not getattr(composer.Entity, name)
        }

    def recompile(self) -> None:
        """Makes the simulation of the task's new world and observes it. Composer does this only during a reset."""
        self._recompile_physics_and_update_observables()

    @property
    def over(self) -> bool:
        """Whether the next step starts an episode. Composer's `step` and `reset` read and write it too."""
        return self._reset_next_step

    @over.setter
    def over(self, over: bool) -> None:
        self._reset_next_step = over

    def close(self) -> None:
        """Frees nothing: the subclass owns the simulation and frees it."""
        self._physics = None

    def _recompile_physics(self) -> None:
        """Calls `simulate`. Composer's own method builds and compiles the tree of elements, a hundred times slower."""
        self._physics = self.simulate()

    def _make_observation_updater(self) -> Any:
        """Calls `make_updater`. Composer's updater draws pictures twice per reset and schedules every observable."""
        return self.make_updater()
