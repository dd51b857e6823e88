"""The common part of GAIL, WGAIL-GP and AL: PPO with rewards that the learner computes."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.running_mean_std import RunningMeanStd
from torch import Tensor
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from magical_mj.learners.data import Batch, Dataset, Rollout
from magical_mj.learners.environments import Environments
from magical_mj.learners.learner import Learner, seeded
from magical_mj.learners.network import Actor, Heads, Torso, as_input, standardise
from magical_mj.learners.ppo import ExternalRewardPPO
from magical_mj.learners.settings import TrainingSettings
from magical_mj.utils.extras import check_extra

Samples = tuple[Tensor, Tensor, Tensor]
"""A batch on the device: observations as of `as_input`, actions (n,) and numbers of tasks (n,)."""


class RewardLearner(Learner):
    """Plays, computes rewards, and improves the policy by PPO.

    Policy and value look at pictures as they are, without augmentation (appendix). Demonstrations keep their no-ops.
    """

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
        settings.check_reinforcement()  # of whatever method
        self.updates = settings.ppo.total_steps // (settings.ppo.environments * settings.ppo.steps)
        self._expert = Dataset(settings, drop_noop=False)
        self._draw = torch.Generator().manual_seed(settings.seed)
        self._environments = Environments(settings)
        tasks = len(settings.tasks)
        with seeded(settings.seed):
            actor = Actor(settings.network, tasks, states=settings.states).to(self.device)
            if isinstance(actor.torso, Torso):
                first = self._expert.sample(256 // tasks * tasks, torch.Generator().manual_seed(settings.seed))
                standardise(actor.torso, self.on_device(first)[0])
            critic = Heads(tasks, actor.torso.features, 1).to(self.device)
            self._actor = actor
            self._average = AveragedModel(actor, multi_avg_fn=get_ema_multi_avg_fn(settings.ppo.averaging))
            self._ppo = ExternalRewardPPO(settings, self._environments, actor, critic, self._draw, self.device)
        self._normalise = RewardNormaliser(settings.ppo.reward_deviation, self._environments.tasks)

    @classmethod
    def check(cls, settings: TrainingSettings) -> None:
        """Also that batched worlds are installed, if these shall be played in."""
        super().check(settings)
        if settings.ppo.worlds == "batched":
            check_extra("batched worlds", "gpu")

    @property
    def actor(self) -> Actor:
        """The average of the policies so far, of which the latest weigh most; with `ppo.averaging` 0, the latest."""
        return cast("Actor", self._average.module)

    def play(self) -> Mapping[str, float]:
        """One rollout, its rewards and PPO's step; stable-baselines3's draws from global generators stay in here."""
        with seeded(int(torch.randint(2**62, (), generator=self._draw))):
            rollout = self._ppo.collect()
            metrics = dict(self.learn_reward(rollout))
            with torch.no_grad():
                parts = [self.reward(*self.on_device(batch)) for batch in rollout.batches(self.settings.ppo.minibatch)]
            rewards = torch.cat(parts).double().cpu().numpy().reshape(rollout.actions.shape)
            metrics |= {"reward": float(rewards.mean()), **self._ppo.improve(self._normalise(rewards))}
        self._average.update_parameters(self._actor)
        return metrics

    @abstractmethod
    def learn_reward(self, rollout: Rollout) -> Mapping[str, float]:
        """Learns from the policy's latest rollout, and returns metrics."""

    @abstractmethod
    def reward(self, observations: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """Rewards (n,) of samples, to be normalised."""

    def on_device(self, batch: Batch) -> Samples:
        """A batch as networks want it."""
        return as_input(batch.observations, self.device), batch.actions.to(self.device), batch.tasks.to(self.device)

    def state(self) -> dict[str, Any]:
        """Of the policy and its average, the environments, the rewards and the draws."""
        kept = {"ppo": self._ppo.state(), "average": self._average.state_dict()}
        return {**kept, "rewards": self._normalise.state(), "draw": self._draw.get_state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Restores a `state`."""
        self._ppo.restore(state["ppo"])
        self._average.load_state_dict(state["average"])
        self._normalise.restore(state["rewards"])
        self._draw.set_state(state["draw"])

    def close(self) -> None:
        """Closes the environments."""
        self._environments.close()


class RewardNormaliser:
    """Normalises each task's rewards to mean 0 and a given standard deviation, using its rewards so far.

    The paper normalises rewards (appendix), but does not say whether jointly for several tasks. If it were joint, a
    task whose samples are easy to discriminate would determine the scale of the other tasks' rewards.

    Args:
        deviation: the standard deviation.
        tasks: number of each environment's task, ascending from 0, shape (environments,).
    """

    def __init__(self, deviation: float, tasks: NDArray[np.int64]) -> None:
        self._deviation, self._tasks = deviation, tasks
        self._seen = [RunningMeanStd() for _ in range(int(tasks[-1]) + 1)]

    def __call__(self, rewards: NDArray[np.float64]) -> NDArray[np.float32]:
        """Takes in rewards of shape (steps, environments), and returns them normalised."""
        normalised = np.empty(rewards.shape, np.float32)
        for task, seen in enumerate(self._seen):
            own = self._tasks == task
            seen.update(rewards[:, own].ravel())
            spread = np.sqrt(seen.var + 1e-12)  # rewards that are all the same are all 0
            normalised[:, own] = (rewards[:, own] - seen.mean) / spread * self._deviation
        return normalised

    def state(self) -> dict[str, Any]:
        """Means, variances and numbers of the rewards so far, by task."""
        return {name: [float(getattr(seen, name)) for seen in self._seen] for name in ("mean", "var", "count")}

    def restore(self, state: dict[str, Any]) -> None:
        """Restores a `state`."""
        for task, seen in enumerate(self._seen):
            seen.mean, seen.var = np.array(state["mean"][task]), np.array(state["var"][task])
            seen.count = state["count"][task]
