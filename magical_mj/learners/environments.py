"""What PPO plays, whatever kind of worlds it is."""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecTransposeImage

from magical_mj.learners.copies import Copies, Seen, task_number
from magical_mj.learners.settings import TrainingSettings
from magical_mj.learners.worlds import BatchedWorlds


class Environments(VecTransposeImage):
    """The environments of a run: copies of single environments, or batched worlds.

    Stable-baselines3 would move the channels of pictures first, which is slow; this wrapper, told to skip
    that, prevents it.

    Attributes:
        tasks: the number of the task of each environment, ascending. Shape (environments,).
    """

    def __init__(self, settings: TrainingSettings) -> None:
        self.tasks = np.array([task_number(settings, number) for number in range(settings.ppo.environments)])
        if settings.ppo.worlds == "batched":
            self._played: Copies | BatchedWorlds = BatchedWorlds(settings)
        else:
            self._played = Copies(settings)
        super().__init__(self._played, skip=True)

    def state(self) -> Any:
        """Where all of them are."""
        return self._played.state()

    def restore(self, state: Any) -> Seen:
        """Restores a `state`; returns all observations, as `reset` does."""
        return self._played.restore(state)
