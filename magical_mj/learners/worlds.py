"""Batched worlds as PPO plays them: the counterpart of the copies in `magical_mj.learners.copies`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from magical_mj.learners.copies import SEEN, TASK, Seen, random_start, space, task_number
from magical_mj.learners.learner import device
from magical_mj.learners.settings import TrainingSettings
from magical_mj.learners.states import History
from magical_mj.scene.actions import ACTIONS
from magical_mj.utils.extras import check_extra


class BatchedWorlds(VecEnv):
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

        tasks = [task_number(settings, number) for number in range(settings.ppo.environments)]
        self._batch = BatchedEnv(
            [(settings.tasks[task], "Demo") for task in tasks],
            preset=settings.preset,
            device=str(device(settings.device)),
            seed=settings.seed,
        )
        self._arrays = Arrays(self._batch)
        self._one_hot = np.eye(len(settings.tasks), dtype=np.float32)[tasks]
        self._random_starts = np.array([random_start(settings, number) for number in range(len(tasks))])
        self._seed, self._states = settings.seed, settings.states
        self._history: History | None = None
        seen = space(settings, self._batch.single_observation_space)
        super().__init__(len(tasks), seen, self._batch.single_action_space)

    def reset(self) -> Seen:
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
        return self._seen(observations)

    def step_async(self, actions: NDArray[np.int64]) -> None:
        """Takes the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Seen, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """One action in every world; where an episode ends, the next one begins."""
        observations, rewards, _, ended, info = self._arrays.step(self._actions)
        last, final = info.get("final_obs", observations), info.get("final_info", info)
        if self._history:
            last = self._history.add(last)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for world in np.flatnonzero(ended):
            infos[world] = {
                "terminal_observation": {SEEN: last[world], TASK: self._one_hot[world]},
                "TimeLimit.truncated": not final["broken"][world],  # nothing comes after a broken state
                "eval_score": float(final["eval_score"][world]),
            }
        self._restart(ended, observations)
        return self._seen(observations), rewards, ended, infos

    def state(self) -> dict[str, Any]:
        """Where all worlds are."""
        return {"worlds": self._batch.get_state(), "history": self._history and self._history.states}

    def restore(self, state: dict[str, Any]) -> Seen:
        """Restores a `state`; returns what is seen then, as `reset` does."""
        observations = self._arrays.set_state(state["worlds"])
        if state["history"] is not None:
            self._history = History(observations)
            self._history.states = state["history"]
        return self._seen(observations)

    def close(self) -> None:
        """Frees the simulation."""
        self._batch.close()

    def _restart(self, worlds: NDArray[np.bool_], observations: NDArray[Any]) -> None:
        if self._history:
            self._history.restart(worlds, observations)

    def _seen(self, observations: NDArray[Any]) -> Seen:
        return {SEEN: self._history.states if self._history else observations, TASK: self._one_hot}

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The batch's own attribute, for each world."""
        return [getattr(self._batch, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: worlds have no attributes of their own."""
        raise NotImplementedError

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Refused: worlds have no methods of their own."""
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No world is."""
        del wrapper_class
        return [False] * len(list(self._get_indices(indices)))
