"""The state of an episode as plain data that can be restored: for search, for an expert's corrections, for resets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene import Scene
from magical_mj.utils.errors import StateError, as_integer, short_repr


@dataclass(frozen=True, eq=False)
class State:
    """Everything that determines how an episode continues: `get_state` returns it, `set_state` restores it exactly.

    It holds numbers only, so it can be copied, pickled, sent to another process, or saved in a file field by field (the
    scene as `scene.to_json()`). It can be restored in every environment that runs the same task, or the same scene
    without a task, whatever that environment observes. The generator that draws the scenes of later episodes is not
    part of it.

    Attributes:
        scene: the scene in which the episode started.
        steps: number of control steps since then.
        simulation: MuJoCo's state, a vector with the same length for all states of episodes with this scene:
            positions, velocities, actuators, the solver's warm start, and which blocks sleep.
        frames: the stacks of pictures of a Gymnasium environment, by their names; empty elsewhere.
    """

    scene: Scene
    steps: int
    simulation: NDArray[np.float64]
    frames: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict[str, NDArray[np.uint8]])

    def __eq__(self, other: object) -> bool:
        """Whether the simulations are in exactly the same state. Pictures are not compared: they follow from it."""
        if not isinstance(other, State):
            return NotImplemented
        return (self.scene, self.steps, self.simulation.tobytes()) == (
            other.scene,
            other.steps,
            other.simulation.tobytes(),
        )

    def __hash__(self) -> int:
        return hash((self.steps, self.simulation.tobytes()))


def check_state(state: object) -> None:
    """Raise `StateError` unless it is a `State`, whose simulation may still not fit."""
    if not isinstance(state, State):
        raise StateError(f"set_state() takes what get_state() gave, not {type(state).__name__}")
    if as_integer(state.steps) is None:
        raise StateError(f"the steps of a state are an integer from 0 up, not {short_repr(state.steps)}")
    if not isinstance(state.scene, Scene):
        raise StateError(f"the scene of a state is a magical_mj.Scene, not {short_repr(state.scene)}")
    if not isinstance(state.frames, Mapping):
        raise StateError(f"the frames of a state are a mapping of names to pictures, not {short_repr(state.frames)}")
