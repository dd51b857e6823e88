"""All that this package uses of dm_control's private names, with the reason for each; no other module touches any.

dm_control may change them without a word: `pyproject.toml` caps its version, and a test names the one that is gone.
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
    """Composer's physics, whose arrays are indexed by name when somebody first asks for that."""

    def _reload_from_data(self, data: wrapper.MjData) -> None:
        """As dm_control's, which indexes every array by name here: that takes as long as compiling the model."""
        self._data = data  # behind the properties `data` and `model`
        self.warning_counts = data.warning.number
        self._warnings = self.warning_counts  # with the next two: what `check_invalid_state` compares
        self._warnings_before = np.empty_like(self._warnings)
        self._new_warnings = np.empty(len(self._warnings), bool)
        self._bindings = {(): _EMPTY_BINDING}  # what `bind` has bound; that of nothing is there from the start
        self._named = None
        if self._contexts:  # what `render` drew another model with
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
    """Composer's environment, with names for the places where ours differs."""

    extra_hooks: frozenset[str] = frozenset()
    """The names of the moments at which users have functions of their own called."""

    def simulate(self) -> mjcf.Physics:
        """The simulation of the task's present world; the one before is not used any more."""
        raise NotImplementedError

    def make_updater(self) -> Any:
        """What keeps the observations up to date: composer's own updater, or something with its methods."""
        return super()._make_observation_updater()

    def add_extra_hook(self, hook_name: str, hook_callable: Callable[..., Any]) -> None:
        """Has `hook_callable` called at the moment of this name, as composer does, which hides what it calls."""
        super().add_extra_hook(hook_name, hook_callable)
        self.extra_hooks |= {hook_name}

    def user_hooks(self) -> frozenset[str]:
        """The same with the hooks of entities that users have attached."""
        entities = self.task.root_entity.iter_entities()
        return self.extra_hooks | {
            name
            for it in entities
            for name in HOOK_NAMES
            if getattr(type(it), name) is not getattr(composer.Entity, name)
        }

    def recompile(self) -> None:
        """Has the simulation of another world made and observed: composer does this only in the midst of a reset."""
        self._recompile_physics_and_update_observables()

    @property
    def over(self) -> bool:
        """Whether the next step starts an episode. Composer's own steps and resets read and write it too."""
        return self._reset_next_step

    @over.setter
    def over(self, over: bool) -> None:
        self._reset_next_step = over

    def close(self) -> None:
        """Frees nothing: who made the simulation frees it."""
        self._physics = None

    def _recompile_physics(self) -> None:
        """Composer's own builds and compiles the tree of elements, which takes a hundred times as long."""
        self._physics = self.simulate()

    def _make_observation_updater(self) -> Any:
        """Composer's own updater draws every picture twice in a reset, and plans every observable at every step."""
        return self.make_updater()
