"""Wrappers for the Gymnasium environments."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from numpy.typing import ArrayLike, NDArray

from magical_mj.actions import ACTIONS, to_discrete, to_vector
from magical_mj.engine import Engine
from magical_mj.engine.episode import Setup
from magical_mj.shifts.registry import split_body
from magical_mj.utils.errors import InvalidActionError, SettingsError, as_integer, short_repr

__all__ = ["ContinuousActions", "ScoreAtTheEnd"]


def vectors(size: int = 3) -> spaces.Space[NDArray[np.float32]]:
    """A new space of actions as vectors. Spaces have a random generator, so they are not shared."""
    return spaces.Box(-1.0, 1.0, (size,), np.float32)


class ContinuousActions(gymnasium.ActionWrapper[Any, NDArray[np.float32], Any], gymnasium.utils.RecordConstructorArgs):
    """Actions as vectors (drive, turn, grip) in [-1, 1], for learners with continuous actions.

    Drive above 0.5 is forward, below -0.5 back. Turn above 0.5 is left, below -0.5 right. Grip above 0 closes the
    gripper, otherwise it opens. `to_vector(number)` converts one of the 18 actions, so demonstrations can be used in
    both forms.

    Example:
        >>> env = ContinuousActions(gymnasium.make("magical_mj/MoveToRegion-Demo-State-v0"))
        >>> observation, info = env.reset(seed=0)
        >>> observation, *_ = env.step([1.0, 0.0, -1.0])  # forward, with open fingers
        >>> env.to_vector(1).tolist()  # the same as a vector
        [1.0, 0.0, -1.0]

    Args:
        env: an environment with the 18 discrete actions, such as `gymnasium.make("magical_mj/...")`.

    Raises:
        InvalidActionError: if the environment has other actions. In `step`, if a vector has another shape or an entry
            that is not finite.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        if env.action_space != spaces.Discrete(len(ACTIONS)):
            raise InvalidActionError(
                f"ContinuousActions wraps environments with the {len(ACTIONS)} discrete actions, not {env.action_space}"
            )
        super().__init__(env)
        self.action_space = vectors()

    def action(self, action: ArrayLike) -> int:
        """The number of the discrete action for a vector."""
        return to_discrete(action)

    to_discrete = staticmethod(to_discrete)
    to_vector = staticmethod(to_vector)


class ScoreAtTheEnd(gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs):
    """Reports the score at the last step, even if `max_episode_steps` ends episodes before the task's horizon.

    `gymnasium.make` applies it to every environment. If a wrapper of yours ends episodes, apply this one outside it.

    If a `TimeLimit` is directly inside, its limit is set in the environment, and the `TimeLimit` is bypassed. The
    environment counts steps from the start of an episode. `TimeLimit` would count from the last reset, which differs
    after a state was restored.

    Example:
        >>> short = gymnasium.wrappers.TimeLimit(gymnasium.make("magical_mj/MoveToRegion-Demo-State-v0"), 3)
        >>> env = ScoreAtTheEnd(short)
        >>> observation, info = env.reset(seed=0)
        >>> steps = [env.step(0) for _ in range(3)]
        >>> float(steps[-1][4]["eval_score"]) == env.unwrapped.score()
        True

    Args:
        env: a `magical_mj` environment, with any wrappers.

    Raises:
        SettingsError: if `env` is another environment, if `max_episode_steps` is more than the task's horizon, or if an
            argument of `gymnasium.make` contradicts the id.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self._base: Any = self.unwrapped
        engine = getattr(self._base, "engine", None)
        if not isinstance(engine, Engine) or engine.task is None:
            raise SettingsError(f"ScoreAtTheEnd wraps only environments of magical_mj, not {self.unwrapped}")
        self._inner = env
        if env.spec is not None:
            check_id(env.spec.id, env.spec.kwargs)
        if env.spec is not None and env.spec.max_episode_steps is not None:
            limit = check_limit(env.spec.max_episode_steps, engine.setup)
            if isinstance(env, gymnasium.wrappers.TimeLimit):
                self._inner, self._base.limit = env.env, limit

    @property
    def spec(self) -> EnvSpec | None:
        """The spec of the wrapped environment, with the number of steps of its episodes."""
        spec = super().spec
        if spec is not None:
            spec.max_episode_steps = min(spec.max_episode_steps or self._base.limit, self._base.limit)
        return spec

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts an episode."""
        return self._inner.reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Executes one action."""
        observation, reward, terminated, truncated, info = self._inner.step(action)
        if (terminated or truncated) and not self._base.engine.over:  # a wrapper has ended the episode
            score = np.float64(self._base.score())
            info = info | {"eval_score": score, "is_success": bool(score == 1.0)}
            if getattr(self._base, "reward", "none") != "none":
                reward = float(reward) + float(score)
        return observation, reward, terminated, truncated, info


def check_id(id_: str, settings: Mapping[str, Any]) -> None:
    """Raises a `SettingsError` if the settings contradict the id of an environment, for example in its task or body."""
    named = gymnasium.registry[id_].kwargs if id_ in gymnasium.registry else {}
    given = {**named, **settings}
    if "body" in named and given.get("shifts"):
        given["body"] = split_body(given["shifts"], given["task"], given["body"])[1]
    for name, value in named.items():
        if value and given[name] != value:  # ids without a preset leave it open
            raise SettingsError(
                f"{id_} has {name}={value!r}, and not {short_repr(given[name])}: take the id of another environment, "
                "or leave the argument out"
            )


def check_limit(limit: int, setup: Setup) -> int:
    """The number of steps of an episode with this limit: the limit, or the horizon if that is smaller.

    The horizon can be smaller without an error if `limit` is the one in the id, and the environment has other rules.

    Raises:
        SettingsError: if the limit is not an integer of at least 1, or more than the horizon.
    """
    horizon = setup.horizon or 0
    if as_integer(limit, 1) is None:
        raise SettingsError(f"max_episode_steps must be an integer of at least 1, not {short_repr(limit)}")
    if limit > horizon and limit != Setup(setup.task, setup.variant, body=setup.body).horizon:
        raise SettingsError(
            f"max_episode_steps={limit} is more than the {horizon} steps of an episode of {setup.task}: give a smaller "
            "number, or omit it"
        )
    return min(limit, horizon)
