"""Wrappers of the Gymnasium environments."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from numpy.typing import ArrayLike, NDArray

from magical_mj.engine import Engine
from magical_mj.engine.engine import Setup
from magical_mj.scene.actions import ACTIONS, to_discrete, to_vector
from magical_mj.utils.errors import InvalidActionError, SettingsError, as_integer, short_repr

__all__ = ["ContinuousActions", "ScoreAtTheEnd"]


def continuous_space() -> spaces.Space[NDArray[np.float32]]:
    """The space of the vectors (drive, turn, grip). A new one for each environment: spaces have random generators."""
    return spaces.Box(-1.0, 1.0, (3,), np.float32)


class ContinuousActions(gymnasium.ActionWrapper[Any, NDArray[np.float32], Any], gymnasium.utils.RecordConstructorArgs):
    """Actions as vectors (drive, turn, grip) in [-1, 1], for learners of continuous actions.

    Drive and turn command motion above 0.5 (forward, left) and below -0.5 (back, right); grip closes above 0 and opens
    below. Each of the 18 actions is the vector `to_vector(number)`, so demonstrations can be used in either form.

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
        self.action_space = continuous_space()

    def action(self, action: ArrayLike) -> int:
        """The number of the action that the vector commands."""
        return to_discrete(action)

    to_discrete = staticmethod(to_discrete)
    to_vector = staticmethod(to_vector)


class ScoreAtTheEnd(gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs):
    """Reports the score at the last step, also if `max_episode_steps` ends episodes before the task's horizon.

    `gymnasium.make` applies it to every environment. If another wrapper of yours ends episodes, apply this outside it.

    The limit of a `TimeLimit` directly inside becomes that of the environment, which counts an episode's steps since
    its start. `TimeLimit` itself would count those since the last reset, which differ after a state was restored, so
    its counter is passed by.

    Args:
        env: a `magical_mj` environment, with any wrappers.

    Raises:
        SettingsError: if `max_episode_steps` is longer than the episodes of the task, or it is another environment.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self._world: Any = self.unwrapped
        engine = getattr(self._world, "engine", None)
        if not isinstance(engine, Engine) or engine.task is None:
            raise SettingsError(f"ScoreAtTheEnd wraps the environments of magical_mj, not {self.unwrapped}")
        self._inner = env
        if env.spec is not None and env.spec.max_episode_steps is not None:
            limit = check_limit(env.spec.max_episode_steps, engine.setup)
            if isinstance(env, gymnasium.wrappers.TimeLimit):
                self._inner, self._world.limit = env.env, limit

    @property
    def spec(self) -> EnvSpec | None:
        """The spec of the wrapped environment, with the number of steps of its episodes."""
        spec = super().spec
        if spec is not None:
            spec.max_episode_steps = min(spec.max_episode_steps or self._world.limit, self._world.limit)
        return spec

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts an episode."""
        return self._inner.reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """One action."""
        observation, reward, terminated, truncated, info = self._inner.step(action)
        if (terminated or truncated) and not self._world.over:  # else the score is reported already
            score = np.float64(self._world.score())
            info = info | {"eval_score": score, "is_success": np.array(score == 1.0)}
            if getattr(self._world, "reward", "none") == "score":
                reward = float(score)
        return observation, reward, terminated, truncated, info


def check_limit(limit: int, setup: Setup) -> int:
    """The number of steps of a task's episodes if they may end after `limit` steps, which is not beyond the horizon."""
    horizon = setup.horizon or 0
    if as_integer(limit, 1) is None:
        raise SettingsError(f"max_episode_steps must be an integer of at least 1, not {short_repr(limit)}")
    if limit > horizon and limit != Setup(setup.task, setup.variant, body=setup.body).horizon:  # of the id
        raise SettingsError(
            f"max_episode_steps={limit} is more than the {horizon} steps after which every episode of {setup.task} "
            "ends; give a smaller number, or none for the task's own"
        )
    return min(limit, horizon)
