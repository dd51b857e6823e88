"""The environments as LeRobot's commands make them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from magical_mj.demos.export.lerobot import (
    FINGERS,
    IMAGE_SIZE,
    NO_STATE,
    STATE_VECTOR,
    VIEWS,
    image_keys,
    missing_lerobot,
    state,
)
from magical_mj.envs.gymnasium_env import MagicalEnv
from magical_mj.envs.presets import STATE_BOUND
from magical_mj.scene import constants as c
from magical_mj.scene.state_vector import FINGERS as WHERE_FINGERS
from magical_mj.scene.state_vector import STATE_NAMES
from magical_mj.tasks.registry import environments, task_spec
from magical_mj.utils.errors import SettingsError, check_name, shown

try:
    from lerobot.configs import FeatureType, PolicyFeature  # pyright: ignore[reportMissingImports]
    from lerobot.envs.configs import EnvConfig  # pyright: ignore[reportMissingImports]
except ImportError:
    raise missing_lerobot() from None


class LeRobotEnv(gymnasium.ObservationWrapper[dict[str, Any], NDArray[np.float32], NDArray[np.float32]]):
    """One environment with the names and shapes that LeRobot reads.

    Args:
        task: a task's name.
        variant: a variant's name.
        views: "ego", "allo" or "both"; with "state", ``environment_state`` is the state vector, without pictures.
        fingers: whether ``agent_pos`` holds the angles of the fingers (rad), shape (2,), or zeros, shape (3,).

    Raises:
        UnknownNameError: if there is no such task, variant or choice of views.
    """

    def __init__(self, task: str, variant: str, views: str = "ego", *, fingers: bool = False) -> None:
        check_name("choice of views", views, VIEWS)
        env = MagicalEnv(task, variant, "State", reward="score", action="continuous", render_mode="rgb_array")
        super().__init__(cast("gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]", env))
        self._engine, self._views, self._with_fingers = env.engine, VIEWS[views], fingers
        self.task = task
        self.task_description = task_spec(task).summary
        self._max_episode_steps = task_spec(task).horizon()
        seen: dict[str, spaces.Space[Any]] = {"environment_state": env.observation_space}
        if self._views:
            picture = spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
            several = spaces.Dict(dict.fromkeys(self._views, picture))
            seen = {"pixels": picture if len(self._views) == 1 else several}
        state_shape = (len(FINGERS if fingers else NO_STATE),)
        self.observation_space = spaces.Dict(
            {**seen, "agent_pos": spaces.Box(-STATE_BOUND, STATE_BOUND, state_shape, np.float32)}
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Starts an episode; of the options only "scene" is ours, LeRobot passes others of its own."""
        ours = {name: value for name, value in (options or {}).items() if name == "scene"}
        return super().reset(seed=seed, options=ours)

    def observation(self, observation: NDArray[np.float32]) -> dict[str, Any]:
        """The pictures of the present state, or its vector, and the fingers from the vector."""
        seen: dict[str, Any] = {"environment_state": observation}
        if self._views:
            pictures = {view: self._engine.render(view, IMAGE_SIZE) for view in self._views}
            seen = {"pixels": pictures if len(pictures) > 1 else pictures[self._views[0]]}
        return {**seen, "agent_pos": state(observation[WHERE_FINGERS] if self._with_fingers else None)}


@EnvConfig.register_subclass("magical")
@dataclass
class MagicalConfig(EnvConfig):
    """``--env.type=magical``: which environments, and what is observed."""

    task: str | None = "MoveToRegion"
    variant: str = "Demo"
    views: str = "ego"
    fingers: bool = False
    fps: int = c.CONTROL_RATE
    features: dict[str, Any] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        picture = PolicyFeature(type=FeatureType.VISUAL, shape=(IMAGE_SIZE, IMAGE_SIZE, 3))
        keys = image_keys(self.views)
        seen = {"pixels" if len(keys) == 1 else f"pixels/{view}": key for view, key in keys.items()}
        self.features = {
            "action": PolicyFeature(type=FeatureType.ACTION, shape=(3,)),
            "agent_pos": PolicyFeature(type=FeatureType.STATE, shape=(len(FINGERS if self.fingers else NO_STATE),)),
            **dict.fromkeys(seen, picture),
        }
        if not seen:
            seen = {"environment_state": STATE_VECTOR}
            self.features["environment_state"] = PolicyFeature(type=FeatureType.ENV, shape=(len(STATE_NAMES),))
        self.features_map = {"action": "action", "agent_pos": "observation.state", **seen}

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Of no use: `create_envs` makes the environments."""
        return {}

    def create_envs(
        self, n_envs: int, use_async_envs: bool = False
    ) -> dict[str, dict[int, gymnasium.vector.VectorEnv[Any, Any, Any]]]:
        """Suite (the task) -> number of the variant -> vector of environments.

        Raises:
            UnknownNameError: if there is no such task or variant.
            SettingsError: if `n_envs` is less than 1.
        """
        if n_envs < 1:
            raise SettingsError(f"n_envs must be at least 1, not {shown(n_envs)}")
        mode = gymnasium.vector.AutoresetMode.SAME_STEP
        suites: dict[str, dict[int, gymnasium.vector.VectorEnv[Any, Any, Any]]] = {}
        for task, variant in environments(self.task or "all", self.variant):
            make = [partial(LeRobotEnv, task, variant, self.views, fingers=self.fingers)] * n_envs
            suite = suites.setdefault(task, {})
            if use_async_envs and n_envs > 1:  # spawned: OpenGL does not survive a fork
                made: Any = gymnasium.vector.AsyncVectorEnv(make, context="spawn", autoreset_mode=mode)
            else:
                made = gymnasium.vector.SyncVectorEnv(make, autoreset_mode=mode)
            suite[len(suite)] = made
        return suites
