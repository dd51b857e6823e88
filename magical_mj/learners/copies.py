"""Copies of the tasks' environments side by side, stopped and taken up in mid-episode; and what PPO sees of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import DummyVecEnv

from magical_mj.envs.gymnasium_env import MagicalEnv
from magical_mj.learners.settings import TrainingSettings
from magical_mj.learners.states import HISTORY, History
from magical_mj.scene.actions import ACTIONS
from magical_mj.tasks.registry import task_spec

SEEN: Final = "seen"
"""Of an observation: the stack of frames, shape (96, 96, 12) uint8; or the history, shape (HISTORY, names) float32."""
TASK: Final = "task"
"""Of an observation: the task as a one-hot vector, shape (tasks,) float32."""

Seen = dict[str, NDArray[Any]]


class Copy(gymnasium.Env[Any, Any]):
    """One copy of a task's environment. The seed of episode k is a function of the run's seed, the copy and k.

    The first episode starts with some random actions; see `random_start`.

    Args:
        settings: the settings of the run.
        number: the copy's number, from 0 to `ppo.environments` - 1; copies of the same task have successive numbers.
    """

    def __init__(self, settings: TrainingSettings, number: int) -> None:
        self._task = task_number(settings, number)
        self._env = MagicalEnv(settings.tasks[self._task], "Demo", settings.preset)
        self.observation_space = space(settings, self._env.observation_space)
        self.action_space = self._env.action_space
        self._one_hot = np.eye(len(settings.tasks), dtype=np.float32)[self._task]
        self._seed, self._number = settings.seed, number
        self._random_start = random_start(settings, number)
        self._states = settings.states
        self._history: History | None = None
        self._episode, self._actions = -1, list[int]()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Seen, dict[str, Any]]:  # noqa: ARG002
        """Starts the next episode. The arguments are not used: copies have their own seeds."""
        self._episode += 1
        first = self._rng().integers(len(ACTIONS), size=self._random_start) if self._episode == 0 else ()
        return self._replay(first), {}

    def step(self, action: Any) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """One action. The reward is 0; `info["eval_score"]` is the score, at an episode's last step."""
        self._actions.append(int(action))
        observation, reward, terminated, truncated, info = self._env.step(action)
        return self._seen(observation), reward, terminated, truncated, info

    def state(self) -> dict[str, Any]:
        """The episode's number and its actions so far."""
        return {"episode": self._episode, "actions": np.array(self._actions, np.int64)}

    def restore(self, state: dict[str, Any]) -> Seen:
        """Restores a `state` by replaying its actions; returns the observation."""
        self._episode = state["episode"]
        return self._replay(state["actions"])

    def close(self) -> None:
        """Frees the simulation."""
        self._env.close()

    def _replay(self, actions: Sequence[int] | NDArray[np.int64]) -> Seen:
        self._actions, self._history = [], None
        seen = self._seen(self._env.reset(seed=int(self._rng().integers(2**63)))[0])
        for action in actions:
            seen = self.step(action)[0]
        return seen

    def _rng(self) -> np.random.Generator:
        return np.random.default_rng([self._seed, self._number, self._episode])

    def _seen(self, observation: Any) -> Seen:
        if self._states:
            self._history = self._history or History(observation)
            observation = self._history.add(observation)
        return {SEEN: observation, TASK: self._one_hot}


class Copies(DummyVecEnv):
    """All copies of a run, in this process, since sending pictures takes longer than a step."""

    def __init__(self, settings: TrainingSettings) -> None:
        self._copies = [Copy(settings, number) for number in range(settings.ppo.environments)]
        super().__init__([lambda copy=copy: copy for copy in self._copies])

    def state(self) -> list[dict[str, Any]]:
        """Where all copies are."""
        return [copy.state() for copy in self._copies]

    def restore(self, state: Sequence[dict[str, Any]]) -> Seen:
        """Restores a `state`; returns the observations of all copies, as `reset` does."""
        seen = [copy.restore(one) for copy, one in zip(self._copies, state, strict=True)]
        return {key: np.stack([one[key] for one in seen]) for key in (SEEN, TASK)}


def space(settings: TrainingSettings, given: spaces.Space[Any]) -> spaces.Dict:
    """The space of PPO's observations, for environments with the observation space `given`."""
    if settings.states:
        given = spaces.Box(-np.inf, np.inf, (HISTORY, *(given.shape or ())), np.float32)
    return spaces.Dict({SEEN: given, TASK: spaces.Box(0, 1, (len(settings.tasks),), np.float32)})


def random_start(settings: TrainingSettings, number: int) -> int:
    """The number of random actions with which the first episode of an environment starts.

    If all environments started together, they would always be at the same step of their episodes, and each batch would
    contain only one phase of the task. So they are spread over the horizon, as rlpyt, the paper's library, does by
    default.
    """
    siblings = settings.ppo.environments // len(settings.tasks)
    return number % siblings * task_spec(settings.tasks[task_number(settings, number)]).horizon() // siblings


def task_number(settings: TrainingSettings, number: int) -> int:
    """The number of the task of an environment."""
    return number * len(settings.tasks) // settings.ppo.environments
