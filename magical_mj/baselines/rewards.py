"""Rewards of a known size, whatever the discriminator or the features make of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.running_mean_std import RunningMeanStd


class RewardNormaliser:
    """Brings rewards to mean 0 and a given standard deviation, by those of all rewards so far (appendix).

    Args:
        deviation: the standard deviation.
    """

    def __init__(self, deviation: float) -> None:
        self._deviation = deviation
        self._seen = RunningMeanStd()

    def __call__(self, rewards: NDArray[np.float64]) -> NDArray[np.float32]:
        """Takes in rewards of any shape, and returns them normalised."""
        self._seen.update(rewards.ravel())
        spread = np.sqrt(self._seen.var + 1e-12)  # rewards that are all the same are all 0
        return ((rewards - self._seen.mean) / spread * self._deviation).astype(np.float32)

    def state(self) -> dict[str, Any]:
        """Mean, variance and number of the rewards so far."""
        return {"mean": float(self._seen.mean), "var": float(self._seen.var), "count": float(self._seen.count)}

    def restore(self, state: dict[str, Any]) -> None:
        """Takes up a `state`."""
        self._seen.mean, self._seen.var = np.array(state["mean"]), np.array(state["var"])
        self._seen.count = state["count"]
