"""The vector environments that PPO plays: they can be stopped and taken up in mid-episode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from magical_mj.envs.gymnasium_env import MagicalEnv
from magical_mj.learners.learner import device
from magical_mj.learners.settings import TrainingSettings
from magical_mj.learners.state_features import HISTORY, History
from magical_mj.scene.actions import ACTIONS
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.extras import check_extra

OBSERVATION: Final = "seen"
"""Of an observation: the stack of frames, shape (96, 96, 12) uint8; or the history, shape (HISTORY, names) float32."""
TASK: Final = "task"
"""Of an observation: the task as a one-hot vector, shape (tasks,) float32."""

Observations = dict[str, NDArray[Any]]


class TaskEnv(gymnasium.Env[Any, Any]):
    """One of the environments of a task. The seed of episode k is a function of the run's seed, its number and k.

    The first episode starts with some random actions; see `random_start`.

    Args:
        settings: the settings of the run.
        number: from 0 to `ppo.environments` - 1; environments of the same task have successive numbers.
    """

    def __init__(self, settings: TrainingSettings, number: int) -> None:
        task = task_numbers(settings)[number]
        self._env = MagicalEnv(settings.tasks[task], "Demo", settings.preset)
        self.observation_space = space(settings, self._env.observation_space)
        self.action_space = self._env.action_space
        self._one_hot = np.eye(len(settings.tasks), dtype=np.float32)[task]
        self._seed, self._number = settings.seed, number
        self._random_start = random_start(settings, number)
        self._states = settings.states
        self._history: History | None = None
        self._episode, self._actions = -1, list[int]()

    def reset(self, **_: Any) -> tuple[Observations, dict[str, Any]]:
        """Starts the next episode. Arguments are not used: each environment has its own seeds."""
        self._episode += 1
        first = self._rng().integers(len(ACTIONS), size=self._random_start) if self._episode == 0 else ()
        return self._replay(first), {}

    def step(self, action: Any) -> tuple[Observations, float, bool, bool, dict[str, Any]]:
        """One action. The reward is 0; `info["eval_score"]` is the score, at an episode's last step."""
        self._actions.append(int(action))
        observation, reward, terminated, truncated, info = self._env.step(action)
        return self._observations(observation), reward, terminated, truncated, info

    def get_state(self) -> dict[str, Any]:
        """The episode's number and its actions so far."""
        return {"episode": self._episode, "actions": np.array(self._actions, np.int64)}

    def set_state(self, state: dict[str, Any]) -> Observations:
        """Goes back to a state by replaying its actions; returns the observation."""
        self._episode = state["episode"]
        return self._replay(state["actions"])

    def close(self) -> None:
        """Frees the simulation."""
        self._env.close()

    def _replay(self, actions: Sequence[int] | NDArray[np.int64]) -> Observations:
        self._actions, self._history = [], None
        observation = self._observations(self._env.reset(seed=int(self._rng().integers(2**63)))[0])
        for action in actions:
            observation = self.step(action)[0]
        return observation

    def _rng(self) -> np.random.Generator:
        return np.random.default_rng([self._seed, self._number, self._episode])

    def _observations(self, observation: Any) -> Observations:
        if self._states:
            self._history = self._history or History(observation)
            observation = self._history.add(observation)
        return {OBSERVATION: observation, TASK: self._one_hot}


class SerialVecEnv(DummyVecEnv):
    """All environments of a run, in this process, since sending pictures takes longer than a step."""

    def __init__(self, settings: TrainingSettings) -> None:
        self.tasks = task_numbers(settings)
        self._task_envs = [TaskEnv(settings, number) for number in range(settings.ppo.environments)]
        super().__init__([lambda env=env: env for env in self._task_envs])

    def get_state(self) -> list[dict[str, Any]]:
        """Where all of them are."""
        return [env.get_state() for env in self._task_envs]

    def set_state(self, state: Sequence[dict[str, Any]]) -> Observations:
        """Goes back to a state; returns all observations, as `reset` does."""
        each = [env.set_state(part) for env, part in zip(self._task_envs, state, strict=True)]
        return {key: np.stack([observation[key] for observation in each]) for key in (OBSERVATION, TASK)}


class BatchedVecEnv(VecEnv):
    """All environments of a run as worlds of one batch, on the learner's device.

    Observations are copied to the host, where stable-baselines3 keeps rollouts.

    Args:
        settings: of the run.

    Raises:
        MissingExtraError: if the extra `gpu` is not installed.
        SettingsError: if Warp has no such device.
    """

    def __init__(self, settings: TrainingSettings) -> None:
        check_extra("batched worlds", "gpu")
        from magical_mj.batched.environment import Arrays, BatchedEnv

        self.tasks = task_numbers(settings)
        self._batch = BatchedEnv(
            [(settings.tasks[task], "Demo") for task in self.tasks],
            preset=settings.preset,
            device=str(device(settings.device)),
            seed=settings.seed,
        )
        self._arrays = Arrays(self._batch)
        self._one_hot = np.eye(len(settings.tasks), dtype=np.float32)[self.tasks]
        self._random_starts = np.array([random_start(settings, number) for number in range(len(self.tasks))])
        self._seed, self._states = settings.seed, settings.states
        self._history: History | None = None
        observed = space(settings, self._batch.single_observation_space)
        super().__init__(len(self.tasks), observed, self._batch.single_action_space)

    def reset(self) -> Observations:
        """All worlds begin so that their random actions end together."""
        rng = np.random.default_rng(self._seed)
        observations, _ = self._arrays.reset()
        self._history = History(observations) if self._states else None
        for left in range(int(self._random_starts.max()), -1, -1):
            begin = self._random_starts == left
            if begin.any():
                observations, _ = self._arrays.reset(options={"reset_mask": begin})
                self._restart(begin, observations)
            if left:
                self.step(rng.integers(len(ACTIONS), size=self.num_envs))
        return self._observations(observations)

    def step_async(self, actions: NDArray[np.int64]) -> None:
        """Takes the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Observations, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """One action in every world; where an episode ends, the next one begins."""
        observations, rewards, _, ended, info = self._arrays.step(self._actions)
        last, final = info.get("final_obs", observations), info.get("final_info", info)
        if self._history:
            last = self._history.add(last)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for world in np.flatnonzero(ended):
            infos[world] = {
                "terminal_observation": {OBSERVATION: last[world], TASK: self._one_hot[world]},
                "TimeLimit.truncated": not final["broken"][world],  # nothing comes after a broken state
                "eval_score": float(final["eval_score"][world]),
            }
        self._restart(ended, observations)
        return self._observations(observations), rewards, ended, infos

    def get_state(self) -> dict[str, Any]:
        """Where all worlds are."""
        return {"worlds": self._arrays.get_state(), "history": self._history and self._history.states}

    def set_state(self, state: dict[str, Any]) -> Observations:
        """Goes back to a state; returns what is seen then, as `reset` does."""
        observations = self._arrays.set_state(state["worlds"])
        if state["history"] is not None:
            self._history = History(observations)
            self._history.states = state["history"]
        return self._observations(observations)

    def close(self) -> None:
        """Frees the simulation."""
        self._batch.close()

    def _restart(self, worlds: NDArray[np.bool_], observations: NDArray[Any]) -> None:
        if self._history:
            self._history.restart(worlds, observations)

    def _observations(self, observations: NDArray[Any]) -> Observations:
        return {OBSERVATION: self._history.states if self._history else observations, TASK: self._one_hot}

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The batch's own attribute, for each world."""
        return [getattr(self._batch, attr_name) for _ in self._get_indices(indices)]

    def _refuse(self, *_: Any, **__: Any) -> Any:
        """Worlds have no attributes, methods and wrappers of their own."""
        raise NotImplementedError

    set_attr = env_method = env_is_wrapped = _refuse


TrainingEnvs = SerialVecEnv | BatchedVecEnv
"""Vector environments with the numbers of their tasks, ascending, as `tasks`, and with `get_state` and `set_state`."""


def training_envs(settings: TrainingSettings) -> TrainingEnvs:
    """The environments of a run: each for itself, or all in one batch."""
    return BatchedVecEnv(settings) if settings.ppo.worlds == "batched" else SerialVecEnv(settings)


def task_numbers(settings: TrainingSettings) -> NDArray[np.int64]:
    """The number of the task of each environment, ascending; all tasks have the same number of environments."""
    return np.repeat(np.arange(len(settings.tasks)), settings.ppo.environments // len(settings.tasks))


def space(settings: TrainingSettings, single: spaces.Space[Any]) -> spaces.Dict:
    """The space of PPO's observations, for environments with the observation space `single`."""
    if settings.states:
        single = spaces.Box(-np.inf, np.inf, (HISTORY, *(single.shape or ())), np.float32)
    return spaces.Dict({OBSERVATION: single, TASK: spaces.Box(0, 1, (len(settings.tasks),), np.float32)})


def random_start(settings: TrainingSettings, number: int) -> int:
    """The number of random actions with which the first episode of an environment starts.

    If all environments started together, they would always be at the same step of their episodes, and each batch would
    contain only one phase of the task. So they are spread over the horizon, as rlpyt, the paper's library, does by
    default.
    """
    siblings = settings.ppo.environments // len(settings.tasks)
    return number % siblings * task_spec(settings.tasks[number // siblings]).horizon() // siblings
