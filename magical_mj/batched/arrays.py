"""Batched worlds as numpy arrays, for those who know no tensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import gymnasium
from torch import Tensor

if TYPE_CHECKING:
    from magical_mj.batched.environment import BatchedEnv


class Arrays(gymnasium.vector.VectorWrapper[Any, Any, Any, Any]):
    """A `BatchedEnv` whose observations, rewards, ends and infos are numpy arrays, copied from the device.

    States that are saved stay as they are.

    Args:
        env: the environment.
    """

    env: BatchedEnv  # pyright: ignore[reportIncompatibleVariableOverride]

    def __init__(self, env: BatchedEnv) -> None:
        super().__init__(env)

    @property
    def device(self) -> str:
        """Warp's name of the device that the worlds are on."""
        return self.env.device

    def reset(self, **given: Any) -> tuple[Any, dict[str, Any]]:
        """As the environment's own."""
        return arrays(self.env.reset(**given))

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """As the environment's own."""
        return arrays(self.env.step(actions))

    def get_state(self) -> dict[str, Any]:
        """The environment's own."""
        return self.env.get_state()

    def set_state(self, state: Mapping[str, Any]) -> Any:
        """As the environment's own."""
        return arrays(self.env.set_state(state))


def arrays(value: Any) -> Any:
    """The same with arrays instead of tensors, in dicts and tuples too."""
    if isinstance(value, Tensor):
        return value.cpu().numpy()
    if isinstance(value, dict):
        return {name: arrays(one) for name, one in value.items()}
    if isinstance(value, tuple):
        return tuple(arrays(one) for one in value)
    return value
