"""The latest states of episodes, for policies that look at more than the present one."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

HISTORY: Final = 4
"""States in an observation, as many as there are frames in the paper's pictures."""


def histories(states: NDArray[np.float32]) -> NDArray[np.float32]:
    """The latest states at each step, (steps, HISTORY, names), of states (steps, names); the first one is repeated."""
    steps = np.arange(len(states))[:, None] + np.arange(1 - HISTORY, 1)
    return states[np.maximum(steps, 0)]


class History:
    """Keeps the latest HISTORY states of one or several episodes."""

    def __init__(self, states: NDArray[np.float32]) -> None:
        """Episodes begin with `states`, which are repeated."""
        self.states = np.repeat(states[..., None, :], HISTORY, axis=-2)
        """Shape (..., HISTORY, names), oldest first; a new array after each change."""

    def add(self, states: NDArray[np.float32]) -> NDArray[np.float32]:
        """Takes in what came next, shape (..., names); returns `states`."""
        self.states = np.concatenate([self.states[..., 1:, :], states[..., None, :]], axis=-2)
        return self.states

    def restart(self, which: NDArray[np.bool_], states: NDArray[np.float32]) -> None:
        """Other episodes begin in some rows, `which` (n,), with their rows of `states` (n, names)."""
        self.states = np.where(which[:, None, None], states[:, None], self.states)
