"""A yardstick for the machine: another simulated pushing task with 96 px pictures, gym-pusht, if it is installed."""

from __future__ import annotations

from importlib.util import find_spec
from time import perf_counter
from typing import Any, Final

import gymnasium
import numpy as np

STEPS: Final = 100
"""At a time, in turn with what is measured."""


class Yardstick:
    """gym-pusht's pixels under random actions, resets included.

    Attributes:
        problem: why it cannot be used though it is installed; None if it can, or is not there.
    """

    def __init__(self) -> None:
        self.steps, self.seconds = 0, 0.0
        self.problem: str | None = None
        self._env: gymnasium.Env[Any, Any] | None = None
        self._actions = np.random.default_rng(0)
        if find_spec("gym_pusht"):
            try:
                self._env = gymnasium.make("gym_pusht:gym_pusht/PushT-v0", obs_type="pixels")
                self._env.reset(seed=0)
            except Exception as error:  # noqa: BLE001  # whatever is wrong with it, ours can be measured
                self._env, self.problem = None, f"{type(error).__name__}: {error}"

    def run(self) -> None:
        """Takes a few more steps."""
        if self._env is None:
            return
        targets = self._actions.uniform(0, 512, (STEPS, 2)).astype(np.float32)
        start = perf_counter()
        for target in targets:
            _, _, terminated, truncated, _ = self._env.step(target)
            if terminated or truncated:
                self._env.reset()
        self.seconds += perf_counter() - start
        self.steps += STEPS

    @property
    def rate(self) -> float | None:
        """Steps per second; None if it is not installed."""
        return self.steps / self.seconds if self.steps else None
