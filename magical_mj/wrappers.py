"""Wrappers of the Gymnasium environments."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from magical_mj.actions import ACTIONS, to_discrete, to_vector
from magical_mj.errors import InvalidActionError

CONTINUOUS_SPACE = spaces.Box(-1.0, 1.0, (3,), np.float32)


class ContinuousActions(gymnasium.ActionWrapper[Any, NDArray[np.float32], Any], gymnasium.utils.RecordConstructorArgs):
    """Actions as vectors (drive, turn, grip) in [-1, 1], for learners that know no discrete ones.

    Drive and turn command motion above 0.5 (forward, left) and below -0.5 (back, right); grip closes above 0 and opens
    below. Each of the 18 actions is the vector `to_vector(number)`, so demonstrations can be had in either form.

    Args:
        env: an environment with the 18 discrete actions, such as `gymnasium.make("magical_mj/...")`.

    Raises:
        InvalidActionError: if the environment's actions are not those; in `step`, for vectors of another shape or with
            entries that are not finite.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        if env.action_space != spaces.Discrete(len(ACTIONS)):
            raise InvalidActionError(
                f"ContinuousActions wraps environments with the {len(ACTIONS)} discrete actions, not {env.action_space}"
            )
        super().__init__(env)
        self.action_space = CONTINUOUS_SPACE

    def action(self, action: ArrayLike) -> int:
        """The number of the action that the vector commands."""
        return to_discrete(action)

    to_discrete = staticmethod(to_discrete)
    to_vector = staticmethod(to_vector)
