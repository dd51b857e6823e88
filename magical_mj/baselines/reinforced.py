"""What GAIL, WGAIL-GP and AL share: PPO on rewards that the learner makes itself."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.running_mean_std import RunningMeanStd
from torch import Tensor

from magical_mj.baselines.data import Batch, Dataset, Rollout
from magical_mj.baselines.environments import Environments
from magical_mj.baselines.learner import Learner, seeded
from magical_mj.baselines.network import Actor, Heads, Torso, as_input, standardise
from magical_mj.baselines.ppo import Improver
from magical_mj.baselines.settings import TrainingSettings

Samples = tuple[Tensor, Tensor, Tensor]
"""A batch on the device: observations as of `as_input`, actions (n,) and numbers of tasks (n,)."""


class RewardLearner(Learner):
    """Plays, makes rewards for what was done, and improves the policy by PPO.

    Policy and value look at pictures as they are, without augmentation (appendix). Demonstrations keep their no-ops.
    """

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
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
            self._ppo = Improver(settings, self._environments, actor, critic, self._draw, self.device)
        self._normalise = RewardNormaliser(settings.ppo.reward_deviation)

    @property
    def actor(self) -> Actor:
        """The policy as it is now."""
        return self._actor

    def play(self) -> Mapping[str, float]:
        """One rollout, its rewards and PPO's step; stable-baselines3's draws from global generators stay in here."""
        with seeded(int(torch.randint(2**62, (), generator=self._draw))):
            rollout = self._ppo.collect()
            figures = dict(self.study(rollout))
            with torch.no_grad():
                parts = [self.reward(*self.on_device(batch)) for batch in rollout.batches(self.settings.ppo.minibatch)]
            rewards = torch.cat(parts).double().cpu().numpy().reshape(rollout.actions.shape)
            return {**figures, "reward": float(rewards.mean()), **self._ppo.improve(self._normalise(rewards))}

    @abstractmethod
    def study(self, rollout: Rollout) -> Mapping[str, float]:
        """Learns from what the policy has just done, and returns figures about it."""

    @abstractmethod
    def reward(self, observations: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """Rewards (n,) of samples, to be normalised."""

    def on_device(self, batch: Batch) -> Samples:
        """A batch as networks want it."""
        return as_input(batch.observations, self.device), batch.actions.to(self.device), batch.tasks.to(self.device)

    def state(self) -> dict[str, Any]:
        """Of the policy, the environments, the rewards and the draws."""
        return {"ppo": self._ppo.state(), "rewards": self._normalise.state(), "draw": self._draw.get_state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Takes up a `state`."""
        self._ppo.restore(state["ppo"])
        self._normalise.restore(state["rewards"])
        self._draw.set_state(state["draw"])

    def close(self) -> None:
        """Closes the environments."""
        self._environments.close()


class RewardNormaliser:
    """Brings rewards to mean 0 and a given standard deviation, by those of all rewards so far (appendix).

    Args:
        deviation: the standard deviation.
    """

    def __init__(self, deviation: float) -> None:
        self._deviation = deviation
        self._seen = RunningMeanStd()

    def __call__(self, rewards: NDArray[np.float64]) -> NDArray[np.float32]:
        """Takes in rewards of any shape, and returns them normalised."""
        self._seen.update(rewards.ravel())
        spread = np.sqrt(self._seen.var + 1e-12)  # rewards that are all the same are all 0
        return ((rewards - self._seen.mean) / spread * self._deviation).astype(np.float32)

    def state(self) -> dict[str, Any]:
        """Mean, variance and number of the rewards so far."""
        return {"mean": float(self._seen.mean), "var": float(self._seen.var), "count": float(self._seen.count)}

    def restore(self, state: dict[str, Any]) -> None:
        """Takes up a `state`."""
        self._seen.mean, self._seen.var = np.array(state["mean"]), np.array(state["var"])
        self._seen.count = state["count"]
