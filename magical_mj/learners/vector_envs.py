"""The vector environments for PPO. Their state can be saved and restored in mid-episode."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from magical_mj.envs.gymnasium_env import MagicalEnv
from magical_mj.envs.vector import VectorEnv
from magical_mj.learners.learner import device
from magical_mj.learners.settings import TrainingSettings
from magical_mj.policies.interface import HISTORY, History, histories
from magical_mj.scene.actions import ACTIONS
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.extras import check_extra

OBSERVATION: Final = "seen"
"""The key of an environment's stack of frames, shape (96, 96, 12) uint8; or history, shape (HISTORY, names) float32."""
TASK: Final = "task"
"""The key of an environment's task as a one-hot vector, shape (tasks,) float32."""

Observations = dict[str, NDArray[Any]]
_Outcome = tuple[NDArray[Any], NDArray[np.bool_], NDArray[Any], NDArray[np.float64], NDArray[np.bool_]]
"""A step's result: observations; which episodes ended; last observations of these; scores; which states are broken."""


class TrainingEnvs(VecEnv):
    """The environments of a run, for stable-baselines3: single environments on all cores, or one batch.

    `single` contains the spaces of one environment's observations and actions.

    Attributes:
        tasks: the numbers of the environments' tasks, ascending.
        scores: those of the episodes that have ended. `ExternalRewardPPO` empties the list before each rollout.
    """

    render_mode: str | None = None

    def __init__(self, settings: TrainingSettings, single: tuple[spaces.Space[Any], spaces.Space[Any]]) -> None:
        tasks, siblings = len(settings.tasks), settings.ppo.environments // len(settings.tasks)
        self.tasks = np.repeat(np.arange(tasks), siblings)
        self._one_hot = np.eye(tasks, dtype=np.float32)[self.tasks]
        # The number of random actions at the start of each environment's first episode: environments are spread over
        # the horizon, as in rlpyt, the paper's library, so that each batch contains all phases of the task.
        horizons = np.array([task_spec(task).horizon() for task in settings.tasks])[self.tasks]
        self._random_starts = np.arange(len(self.tasks)) % siblings * horizons // siblings
        self._seed, self._states = settings.seed, settings.states
        self._history: History | None = None
        self.scores: list[float] = []
        seen, actions = single
        if settings.states:
            seen = spaces.Box(-np.inf, np.inf, (HISTORY, *(seen.shape or ())), np.float32)
        space = spaces.Dict({OBSERVATION: seen, TASK: spaces.Box(0, 1, (tasks,), np.float32)})
        super().__init__(len(self.tasks), space, actions)

    @abstractmethod
    def get_state(self) -> Any:
        """The state of all environments."""

    @abstractmethod
    def set_state(self, state: Any) -> Observations:
        """Restores a state, and returns its observations, like `reset`."""

    @abstractmethod
    def _play(self, actions: NDArray[np.int64]) -> _Outcome:
        """One action in every environment. Where an episode ends, the next one begins."""

    def step_async(self, actions: NDArray[np.int64]) -> None:
        """Stores the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Observations, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """One action in every environment. The rewards are 0."""
        observations, ended, last, scores, broken = self._play(self._actions)
        if self._history:
            last = self._history.add(last)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for number in np.flatnonzero(ended):
            infos[number] = {
                "terminal_observation": {OBSERVATION: last[number], TASK: self._one_hot[number]},
                "TimeLimit.truncated": not broken[number],  # a broken state is a termination
            }
        self.scores += scores[ended].tolist()
        self._restart(ended, observations)
        return self._observations(observations), np.zeros(self.num_envs, np.float32), ended, infos

    def _restart(self, chosen: NDArray[np.bool_], observations: NDArray[Any]) -> None:
        if self._history:
            self._history.restart(chosen, observations)

    def _restored(self, latest: NDArray[Any]) -> Observations:
        """Continues with these observations, for states with their histories."""
        if self._states:
            self._history = History(latest[:, -1])
            self._history.states = latest
        return self._observations(latest)

    def _observations(self, observations: NDArray[Any]) -> Observations:
        return {OBSERVATION: self._history.states if self._history else observations, TASK: self._one_hot}

    def _refuse(self, *_: Any, **__: Any) -> Any:
        """Single environments are not accessible."""
        raise NotImplementedError

    set_attr = env_method = env_is_wrapped = _refuse

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the vector, repeated for each environment."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]


class LocalEnvs(TrainingEnvs):
    """Single environments on all cores, with identical results. Their state can be restored in mid-episode.

    The seed of an episode is a function of the run's seed, the environment's number and the episode's number.
    """

    def __init__(self, settings: TrainingSettings) -> None:
        variant = settings.reward.variant
        envs = [MagicalEnv(task, variant, settings.preset, renderer=settings.renderer) for task in tasks_of(settings)]
        self._envs = VectorEnv(envs, autoreset_mode=AutoresetMode.DISABLED)
        super().__init__(settings, (self._envs.single_observation_space, self._envs.single_action_space))
        self._episodes = np.full(self.num_envs, -1)
        self._taken = [list[int]() for _ in envs]

    def reset(self) -> Observations:
        """Begins the next episodes, the first ones with random actions."""
        self._episodes += 1
        counts = self._random_starts if not self._episodes.any() else np.zeros_like(self._random_starts)
        rngs = map(self._rng, range(self.num_envs))
        return self._replay([rng.integers(len(ACTIONS), size=n).tolist() for rng, n in zip(rngs, counts, strict=True)])

    def _play(self, actions: NDArray[np.int64]) -> _Outcome:
        last, _, _, ended, infos = self._envs.step(actions)
        for taken, action in zip(self._taken, actions.tolist(), strict=True):
            taken.append(action)
        observations = last
        if ended.any():
            self._episodes[ended] += 1
            for number in np.flatnonzero(ended):
                self._taken[number] = []
            seeds = [self._scene_seed(number) if ends else None for number, ends in enumerate(ended)]
            observations, _ = self._envs.reset(seed=seeds, options={"reset_mask": ended})
        return observations, ended, last, infos["eval_score"], np.zeros_like(ended)

    def get_state(self) -> list[dict[str, Any]]:
        """The number of each environment's episode, and the episode's actions so far."""
        pairs = zip(self._episodes.tolist(), self._taken, strict=True)
        return [{"episode": episode, "actions": np.array(taken, np.int64)} for episode, taken in pairs]

    def set_state(self, state: Sequence[dict[str, Any]]) -> Observations:
        """Restores a state by replaying its actions."""
        self._episodes = np.array([env["episode"] for env in state])
        return self._replay([env["actions"].tolist() for env in state])

    def close(self) -> None:
        """Frees the simulations."""
        self._envs.close()

    def _replay(self, actions: list[list[int]]) -> Observations:
        """Plays these actions in the environments' current episodes."""
        self._taken = actions
        latest: list[Any] = [None] * self.num_envs

        def replay(number: int) -> None:
            env = self._envs.envs[number]
            seen = [env.reset(seed=self._scene_seed(number))[0]]
            seen += [env.step(action)[0] for action in actions[number]]
            latest[number] = histories(np.array(seen))[-1] if self._states else seen[-1]

        self._envs.each_environment(replay)
        return self._restored(np.stack(latest))

    def _scene_seed(self, number: int) -> int:
        return int(self._rng(number).integers(2**63))

    def _rng(self, number: int) -> np.random.Generator:
        return np.random.default_rng([self._seed, number, int(self._episodes[number])])


class BatchedEnvs(TrainingEnvs):
    """All environments of a run in one batch, on the learner's device.

    Observations are copied to the host, where stable-baselines3 keeps rollouts.
    """

    def __init__(self, settings: TrainingSettings) -> None:
        check_extra("batched environments", "gpu")
        from magical_mj.batched.environment import Arrays, BatchedEnv

        self._batch = BatchedEnv(
            [(task, settings.reward.variant) for task in tasks_of(settings)],
            preset=settings.preset,
            device=str(device(settings.device)),
            seed=settings.seed,
        )
        self._arrays = Arrays(self._batch)
        super().__init__(settings, (self._batch.single_observation_space, self._batch.single_action_space))

    def reset(self) -> Observations:
        """Starts the environments at different steps, so that their random actions end together."""
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

    def _play(self, actions: NDArray[np.int64]) -> _Outcome:
        observations, _, _, ended, info = self._arrays.step(actions)
        last, final = info.get("final_obs", observations), info.get("final_info", info)
        return observations, ended, last, final["eval_score"], final["broken"]

    def get_state(self) -> dict[str, Any]:
        """The state of all environments."""
        return {"worlds": self._arrays.get_state(), "history": self._history and self._history.states}

    def set_state(self, state: dict[str, Any]) -> Observations:
        """Restores a state, and returns its observations, like `reset`."""
        observations = self._arrays.set_state(state["worlds"])
        return self._restored(state["history"] if self._states else observations)

    def close(self) -> None:
        """Frees the simulation."""
        self._batch.close()


def training_envs(settings: TrainingSettings) -> TrainingEnvs:
    """The environments of a run: on all cores, or in one batch."""
    return BatchedEnvs(settings) if settings.ppo.simulator == "warp" else LocalEnvs(settings)


def tasks_of(settings: TrainingSettings) -> list[str]:
    """The task of each environment; all tasks have the same number of consecutive environments."""
    return [task for task in settings.tasks for _ in range(settings.ppo.environments // len(settings.tasks))]
