"""Batched worlds as numpy arrays, for those who know no tensors."""

from __future__ import annotations

from typing import Any

import gymnasium
from torch import Tensor


class Arrays(gymnasium.vector.VectorWrapper[Any, Any, Any, Any]):
    """A `BatchedEnv` whose observations, rewards, ends and infos are numpy arrays, copied from the device."""

    def reset(self, **given: Any) -> tuple[Any, dict[str, Any]]:
        """As the environment's own."""
        return arrays(self.env.reset(**given))

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """As the environment's own."""
        return arrays(self.env.step(actions))


def arrays(value: Any) -> Any:
    """The same with arrays instead of tensors, in dicts and tuples too."""
    if isinstance(value, Tensor):
        return value.cpu().numpy()
    if isinstance(value, dict):
        return {name: arrays(one) for name, one in value.items()}
    if isinstance(value, tuple):
        return tuple(arrays(one) for one in value)
    return value
