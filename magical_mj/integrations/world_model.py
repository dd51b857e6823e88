"""The environments in stable-worldmodel's `World`: variations, goals, recording and both kinds of evaluation.

Give `WorldEnv` as the last of the `pre_wrappers`, and ``max_episode_steps=None``, so that episodes have the task's
number of steps; see docs/integrations.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from magical_mj.envs.gymnasium_env import MagicalEnv
from magical_mj.envs.variation import MAX_SEED
from magical_mj.utils.errors import MissingExtraError, SettingsError, StateError, short_repr
from magical_mj.variants import check_seed

try:
    from stable_worldmodel import spaces as world_spaces  # pyright: ignore[reportMissingImports]
except ImportError:
    raise MissingExtraError("this needs stable-worldmodel, 0.1 or newer: pip install stable-worldmodel") from None

__all__ = ["WorldEnv"]

STATE_SIZE: Final = 768
"""The length of `info["simulation"]`: the number of MuJoCo's numbers, these numbers, and zeros. Arrays in `World` have
fixed shapes, and scenes with the most blocks and pebbles have fewer numbers."""


class WorldEnv(gymnasium.Env[Any, Any]):
    """An environment of this package, possibly wrapped, as `World` expects an environment.

    - An episode terminates at the task's horizon if its score is 1, and is truncated otherwise. So `World`'s
      `success_rate` is the share of episodes with score 1.
    - ``options["variation"]`` of `reset` are names of factors to draw, and ``options["variation_values"]`` a dict from
      names such as "camera.zoom" or "scene.robot" to values. `variation_space` holds the values of the episode.
    - ``info["scene_seed"]`` is the seed of the episode's scene, or -1. `restore` takes it with ``info["steps"]`` and
      ``info["simulation"]``, so episodes of a recording can be continued from any step: exactly, or with the precision
      of float32 if the format of the recording (such as Lance) has no other.

    Args:
        env: the environment. Its `GoalPicture`, if any, is inside.

    Raises:
        SettingsError: if it is not an environment of this package.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        base = env.unwrapped
        if not isinstance(base, MagicalEnv):
            raise SettingsError(f"WorldEnv needs an environment of magical_mj, not {base}")
        self.env, self._base = env, base
        self.action_space, self.observation_space = env.action_space, env.observation_space
        self.metadata, self.render_mode, self.spec = env.metadata, env.render_mode, env.spec
        self.variation_space = _with_values(base.variation_space, base.variation_space.default)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts an episode. The other options are those of `magical_mj.MagicalEnv.reset`.

        Raises:
            InvalidSeedError: if the seed is negative or not an integer.
            SettingsError, UnknownNameError: if a factor does not exist, or a value is not in its space.
        """
        super().reset(seed=None if seed is None else check_seed(seed))
        options = dict(options or {})
        values = options.pop("variation_values", None)
        if values is not None:
            drawn: Mapping[str, Any] = {}
            if names := options.get("variation"):
                number = int(self.np_random.integers(MAX_SEED)) if seed is None else seed
                drawn = self._base.variation_space.draw(names, number)
            options["variation"] = _nested(drawn, values)
        observation, info = self.env.reset(seed=seed, options=options)
        _set_values(self.variation_space, self._base.variation)
        return observation, self._info(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Performs an action."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        solved = bool(info["is_success"])
        return observation, reward, terminated or solved, truncated and not solved, self._info(info)

    def restore(self, scene_seed: ArrayLike, steps: ArrayLike, simulation: ArrayLike) -> None:
        """Continues an episode from one of its steps. The arguments are those of its info, as numbers or arrays.

        Raises:
            InvalidSeedError: if the scene has no seed.
            StateError: if the state does not belong to this scene.
        """
        self._base.reset(seed=_whole(scene_seed))
        now, numbers = self._base.get_state(), np.asarray(simulation, np.float64).ravel()
        size = len(now.simulation)
        if len(numbers) != STATE_SIZE or numbers[0] != size:
            raise StateError(f"this is not a state of the scene of seed {scene_seed}: {short_repr(simulation)}")
        self._base.set_state(replace(now, simulation=numbers[1 : size + 1], steps=_whole(steps)))

    def render(self) -> Any:
        """The picture that `World` adds as ``pixels``."""
        return self.env.render()

    def close(self) -> None:
        """Frees the simulation."""
        self.env.close()

    def _info(self, info: dict[str, Any]) -> dict[str, Any]:
        now, seed = self._base.get_state(), self._base.engine.seed
        numbers = np.zeros(STATE_SIZE)
        numbers[0] = size = len(now.simulation)
        numbers[1 : size + 1] = now.simulation
        start = np.int64(-1 if seed is None else seed)
        return {**info, "scene_seed": start, "steps": now.steps, "simulation": numbers}


def _whole(value: ArrayLike) -> Any:
    """The number in an array with one entry, as an int if it is whole."""
    number = np.asarray(value).item()
    return int(number) if isinstance(number, float) and number.is_integer() else number


def _with_values(space: Any, start: Any) -> Any:
    """The space of stable-worldmodel with the same values, which holds a value."""
    if isinstance(space, spaces.Dict):
        return world_spaces.Dict({name: _with_values(part, start[name]) for name, part in space.spaces.items()})
    if isinstance(space, spaces.Discrete):
        return world_spaces.Discrete(int(space.n), init_value=start, start=int(space.start))
    if isinstance(space, spaces.MultiDiscrete):
        return world_spaces.MultiDiscrete(space.nvec, init_value=start)
    return world_spaces.Box(space.low, space.high, space.shape, init_value=start, dtype=space.dtype)


def _set_values(space: Any, values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        if isinstance(value, Mapping):
            _set_values(space[name], value)
        else:
            space[name].set_value(value)


def _nested(drawn: Mapping[str, Any], values: Any) -> dict[str, Any]:
    """A variation with some values, whose names contain dots."""
    if not isinstance(values, Mapping):
        raise SettingsError(f'variation_values must be a dict such as {{"camera.zoom": 0.5}}, not {short_repr(values)}')
    variation = {name: dict(part) if isinstance(part, Mapping) else part for name, part in drawn.items()}
    for name, value in values.items():
        group, _, factor = str(name).partition(".")
        if factor:
            variation[group] = {**variation.get(group, {}), factor: value}
        else:
            variation[group] = value
    return variation
