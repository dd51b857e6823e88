"""Observables for composer's environment that are computed from the present state, and only when they are needed."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from dm_control.composer.observation import observable
from dm_env import specs

from magical_mj.engine.simulation import Simulation
from magical_mj.scene.state_vector import STATE_NAMES


class CurrentObservable(observable.Generic):
    """An observable with a known spec, so that reading the spec draws nothing. It is enabled by default."""

    def __init__(self, function: Callable[[Simulation], Any], spec: specs.Array) -> None:
        super().__init__(function)
        self._spec = spec
        self.enabled = True

    @property
    def array_spec(self) -> specs.Array:
        """Shape and type."""
        return self._spec

    @property
    def is_immediate(self) -> bool:
        """Whether it is observed once per control step, without delay, buffer or aggregation."""
        timing = (self.update_interval, self.buffer_size, self.delay)
        return timing == (1, None, None) and self.aggregator is None


def picture(view: str, size: int) -> CurrentObservable:
    """A picture of side `size` in pixels."""
    spec = specs.BoundedArray((size, size, 3), np.uint8, 0, 255, view)
    return CurrentObservable(lambda physics: physics.draw(view, size), spec)


def state(function: Callable[[Simulation], Any]) -> CurrentObservable:
    """The state vector that `function` computes."""
    return CurrentObservable(function, specs.Array((len(STATE_NAMES),), np.float32, "state"))


class CurrentUpdater:
    """Replaces composer's updater if all observables are immediate: observed once per control step, without delay.

    Args:
        observables: the enabled observables by name.
    """

    def __init__(self, observables: Mapping[str, CurrentObservable]) -> None:
        self._observables = observables
        self._see: list[tuple[str, Callable[[], Any]]] = []

    def reset(self, physics: Simulation, random_state: np.random.RandomState) -> None:
        """Observes this simulation from now on."""
        self._see = [
            (name, entry.observation_callable(physics, random_state)) for name, entry in self._observables.items()
        ]

    def prepare_for_next_control_step(self) -> None:
        """Does nothing: there is no schedule."""

    def update(self) -> None:
        """Does nothing: there are no buffers."""

    def get_observation(self) -> OrderedDict[str, Any]:
        """The present observation."""
        return OrderedDict((name, see()) for name, see in self._see)

    def observation_spec(self) -> OrderedDict[str, specs.Array]:
        """Name, shape and type of each observation."""
        return OrderedDict((name, entry.array_spec) for name, entry in self._observables.items())
