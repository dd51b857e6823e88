"""PPO on a learnt reward in the scenes of a variant: does a reward teach a task where its own policy fails?

The policy plays in scenes like those of the test, which no method of the paper does. Its results are test-time
training, and an entry must declare the privilege "other scenes".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import torch
from torch import Tensor

from magical_mj.learners.airl import AIRL
from magical_mj.learners.apprenticeship import Apprenticeship
from magical_mj.learners.config import announced_methods, from_toml, load_method
from magical_mj.learners.data import Rollout
from magical_mj.learners.gail import GAIL, WGAILGP
from magical_mj.learners.iq_learn import IQLearn
from magical_mj.learners.learner import Method
from magical_mj.learners.ppo import RewardLearner
from magical_mj.learners.run_folder import CONFIG, RunFolder
from magical_mj.learners.settings import TrainingSettings
from magical_mj.tasks.registry import environments
from magical_mj.utils.errors import SettingsError, TrainingError

REWARD_METHODS: Final[Mapping[str, type[Method]]] = {
    "gail": GAIL,
    "wgail-gp": WGAILGP,
    "airl": AIRL,
    "al": Apprenticeship,
    "iq-learn": IQLearn,
}
"""The methods of this package that learn a reward."""


def learns_reward(method: str) -> bool:
    """Whether a method learns a reward."""
    return method in REWARD_METHODS or (method in announced_methods() and load_method(method).learns_reward)


def settings_in(path: Path, trusted: Sequence[str] = ()) -> TrainingSettings:
    """The settings of the training in a folder.

    Raises:
        SettingsError: if the folder contains no training, or its settings are invalid.
    """
    if not (path / CONFIG).is_file():
        raise SettingsError(f"{path} is not the folder of a training: it has no {CONFIG}")
    return from_toml(path / CONFIG, trusted=trusted)


def learner_of_reward(path: Path, settings: TrainingSettings) -> Method:
    """The learner at the end of the training in a folder, for its `learnt_reward`.

    Raises:
        TrainingError: if the training is not finished, or its checkpoint cannot be used.
    """
    folder = RunFolder(path, settings, resume=True)
    last = folder.last_checkpoint()
    if last is None or last.update < last.updates:
        raise TrainingError(f"the training in {path} is not finished: --resume continues it")
    learner = (REWARD_METHODS.get(settings.method) or load_method(settings.method))(settings)
    try:
        learner.set_state(last.learner)
    except Exception as error:
        raise folder.unusable_checkpoint(error) from error
    return learner


class OnLearntReward(RewardLearner):
    """Trains a new policy, and does not change the reward. Both learn from states.

    Observations are histories with the following state, as in AIRL.
    """

    observes = "states"
    learns_reward = False

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
        self._rewarded = learner_of_reward(Path(settings.reward.run), _reward_settings(settings))
        self._rewarded.close()  # its environments are not used

    @classmethod
    def check_settings(cls, settings: TrainingSettings) -> None:
        """Checks that the reward fits the tasks, and that they have the variant."""
        super().check_settings(settings)
        environments(settings.tasks, settings.reward.variant)
        learnt = _reward_settings(settings)
        if not learns_reward(learnt.method):
            raise SettingsError(f"{settings.reward.run} is a training of {learnt.method}, which learns no reward")
        if learnt.preset != settings.preset or not set(settings.tasks) <= set(learnt.tasks):
            raise SettingsError(
                f"the reward in {settings.reward.run} is for {', '.join(learnt.tasks)} with the preset "
                f"{learnt.preset}, not for {', '.join(settings.tasks)} with {settings.preset}"
            )

    def collect(self) -> Rollout:
        """The rollout. Each step includes the following state."""
        rollout = super().collect()
        following = torch.as_tensor(self._ppo.successors()[..., -1:, :])
        return rollout._replace(observations=torch.cat([rollout.observations, following], -2))

    def learn_reward(self, rollout: Rollout) -> Mapping[str, float]:
        """Does nothing."""
        del rollout
        return {}

    def reward(self, observations: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """The learnt reward, shape (n,)."""
        known = self._rewarded.settings.tasks
        numbers = torch.tensor([known.index(task) for task in self.settings.tasks], device=tasks.device)[tasks]
        return self._rewarded.learnt_reward(observations[:, :-1], observations[:, 1:], actions, numbers)


def _reward_settings(settings: TrainingSettings) -> TrainingSettings:
    """The settings of the training that learnt the reward."""
    if not settings.reward.run:
        raise SettingsError("ppo needs a learnt reward: --set reward.run=RUN, with the folder of a training of gail")
    return settings_in(Path(settings.reward.run), settings.tasks)
