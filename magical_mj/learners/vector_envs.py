"""The vector environments for PPO. Their state can be saved and restored during an episode."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from magical_mj.actions import ACTIONS
from magical_mj.envs.gymnasium_env import MagicalEnv
from magical_mj.envs.vector import VectorEnv
from magical_mj.learners.learner import device
from magical_mj.learners.settings import TrainingSettings
from magical_mj.policies.interface import HISTORY, histories
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.extras import check_extra


class Step(NamedTuple):
    """The result of one action in every environment. After an episode has ended, the next one has begun."""

    observations: NDArray[Any]
    """Stacks of frames, shape (n, 96, 96, 12) uint8; or histories of states, shape (n, HISTORY, names) float32."""
    ended: NDArray[np.bool_]
    last: NDArray[Any]
    """The last observations of the episodes that have ended, in the same shape."""
    scores: NDArray[np.float64]
    """The scores of the episodes that have ended."""
    broken: NDArray[np.bool_]
    """Which episodes ended because their state was no longer finite."""


class TrainingEnvs(ABC):
    """The environments of a run, either single environments on all cores or one batch.

    Attributes:
        tasks: the numbers of the environments' tasks, ascending.
    """

    def __init__(self, settings: TrainingSettings) -> None:
        siblings = settings.ppo.environments // len(settings.tasks)
        self.tasks = np.repeat(np.arange(len(settings.tasks)), siblings)
        # The number of random actions at the start of each environment's first episode: environments are spread over
        # the horizon, as in rlpyt, the paper's library, so that each batch contains all phases of the task.
        horizons = np.array([task_spec(task).horizon() for task in settings.tasks])[self.tasks]
        self._random_starts = np.arange(len(self.tasks)) % siblings * horizons // siblings
        self._seed, self._states = settings.seed, settings.states
        self._latest: NDArray[Any]

    @abstractmethod
    def reset(self) -> NDArray[Any]:
        """Begins the episodes at different steps, and returns the observations."""

    @abstractmethod
    def get_state(self) -> Any:
        """The state of all environments."""

    @abstractmethod
    def set_state(self, state: Any) -> NDArray[Any]:
        """Restores a state, and returns its observations, like `reset`."""

    @abstractmethod
    def close(self) -> None:
        """Frees the simulations."""

    @abstractmethod
    def _play(self, actions: NDArray[np.int64]) -> Step:
        """One action in every environment, with states instead of their histories."""

    def step(self, actions: NDArray[np.int64]) -> Step:
        """One action in every environment."""
        step = self._play(actions)
        if self._states:
            last = np.concatenate([self._latest[:, 1:], step.last[:, None]], axis=1)
            step = step._replace(observations=_restarted(last, step.ended, step.observations), last=last)
        self._latest = step.observations
        return step


def _restarted(latest: NDArray[Any], begin: NDArray[np.bool_], states: NDArray[Any]) -> NDArray[Any]:
    """The histories after some environments have begun an episode. These repeat its first state."""
    return np.where(begin[:, None, None], states[:, None], latest)


class LocalEnvs(TrainingEnvs):
    """Single environments on all cores, with the same results on any number of cores.

    The seed of an episode is a function of the run's seed, the environment's number and the episode's number.
    """

    def __init__(self, settings: TrainingSettings) -> None:
        variant = settings.reward.variant
        envs = [MagicalEnv(task, variant, settings.preset, renderer=settings.renderer) for task in tasks_of(settings)]
        self._envs = VectorEnv(envs, autoreset_mode=AutoresetMode.DISABLED)
        super().__init__(settings)
        self._episodes = np.zeros(len(envs), np.int64)
        self._taken = [list[int]() for _ in envs]

    def reset(self) -> NDArray[Any]:
        """Begins the first episodes with random actions."""
        rngs = map(self._rng, range(len(self.tasks)))
        counts = self._random_starts
        return self._replay([rng.integers(len(ACTIONS), size=n).tolist() for rng, n in zip(rngs, counts, strict=True)])

    def _play(self, actions: NDArray[np.int64]) -> Step:
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
        return Step(observations, ended, last, infos["eval_score"], np.zeros_like(ended))

    def get_state(self) -> list[dict[str, Any]]:
        """The number of each environment's episode, and the episode's actions so far."""
        pairs = zip(self._episodes.tolist(), self._taken, strict=True)
        return [{"episode": episode, "actions": np.array(taken, np.int64)} for episode, taken in pairs]

    def set_state(self, state: Sequence[dict[str, Any]]) -> NDArray[Any]:
        """Restores a state by replaying its actions."""
        self._episodes = np.array([env["episode"] for env in state])
        return self._replay([env["actions"].tolist() for env in state])

    def close(self) -> None:
        """Frees the simulations."""
        self._envs.close()

    def _replay(self, actions: list[list[int]]) -> NDArray[Any]:
        """Plays these actions in the environments' current episodes."""
        self._taken = actions
        latest: list[Any] = [None] * len(actions)

        def replay(number: int) -> None:
            env = self._envs.envs[number]
            seen = [env.reset(seed=self._scene_seed(number))[0]]
            seen += [env.step(action)[0] for action in actions[number]]
            latest[number] = histories(np.array(seen))[-1] if self._states else seen[-1]

        self._envs.each_environment(replay)
        self._latest = np.stack(latest)
        return self._latest

    def _scene_seed(self, number: int) -> int:
        return int(self._rng(number).integers(2**63))

    def _rng(self, number: int) -> np.random.Generator:
        return np.random.default_rng([self._seed, number, int(self._episodes[number])])


class BatchedEnvs(TrainingEnvs):
    """All environments of a run in one batch, on the learner's device.

    Observations are copied to the host, where rollouts are kept.

    Attributes:
        batch: the environments.
    """

    def __init__(self, settings: TrainingSettings) -> None:
        check_extra("batched environments", "gpu")
        from magical_mj.batched.environment import Arrays, BatchedEnv

        self.batch = BatchedEnv(
            [(task, settings.reward.variant) for task in tasks_of(settings)],
            preset=settings.preset,
            device=str(device(settings.device)),
            seed=settings.seed,
        )
        self._arrays = Arrays(self.batch)
        super().__init__(settings)

    def reset(self) -> NDArray[Any]:
        """Begins the environments at different times, so that they end their random actions at the same time."""
        rng = np.random.default_rng(self._seed)
        first, _ = self._arrays.reset()
        self._latest = np.repeat(first[:, None], HISTORY, axis=1) if self._states else first
        for remaining in range(int(self._random_starts.max()), -1, -1):
            begin = self._random_starts == remaining
            if begin.any():
                first, _ = self._arrays.reset(options={"reset_mask": begin})
                self._latest = _restarted(self._latest, begin, first) if self._states else first
            if remaining:
                self.step(rng.integers(len(ACTIONS), size=len(self.tasks)))
        return self._latest

    def _play(self, actions: NDArray[np.int64]) -> Step:
        observations, _, _, ended, info = self._arrays.step(actions)
        last, final = info.get("final_obs", observations), info.get("final_info", info)
        return Step(observations, ended, last, final["eval_score"], final["broken"])

    def get_state(self) -> dict[str, Any]:
        """The state of all environments."""
        return {"worlds": self._arrays.get_state(), "history": self._latest if self._states else None}

    def set_state(self, state: dict[str, Any]) -> NDArray[Any]:
        """Restores a state, and returns its observations, like `reset`."""
        observations = self._arrays.set_state(state["worlds"])
        self._latest = state["history"] if self._states else observations
        return self._latest

    def close(self) -> None:
        """Frees the simulation."""
        self.batch.close()


def training_envs(settings: TrainingSettings) -> TrainingEnvs:
    """The environments of a run: on all cores, or in one batch."""
    return BatchedEnvs(settings) if settings.ppo.simulator == "warp" else LocalEnvs(settings)


def tasks_of(settings: TrainingSettings) -> list[str]:
    """The task of each environment; all tasks have the same number of consecutive environments."""
    return [task for task in settings.tasks for _ in range(settings.ppo.environments // len(settings.tasks))]
