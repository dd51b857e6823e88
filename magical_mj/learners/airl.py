"""AIRL, adversarial inverse reinforcement learning (Fu et al. 2018, arXiv:1710.11248), from states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import torch
from torch import Tensor, nn

from magical_mj.learners.data import Batch, Dataset
from magical_mj.learners.gail import GAIL, Discriminator
from magical_mj.learners.networks import Heads, StateTorso
from magical_mj.learners.settings import NetworkSettings, TrainingSettings


class AIRL(GAIL):
    """GAIL with a discriminator that contains a reward function f: its logits are log pi(a | s) - f(s, a, s').

    f(s, a, s') = g(s, a) + discount h(s') - h(s), with PPO's discount. In the paper, D is near 1 for the demonstrator
    and the reward is log D - log(1 - D). Here D is near 1 for the policy, so the same reward is log(1 - D) - log D,
    which equals f - log pi. The paper finally lets g depend on the state alone, so that the reward transfers to other
    dynamics. Here no policy is retrained on the reward, and g also depends on the action, as the paper first defines
    it.

    Observations are histories with the following state, (n, HISTORY + 1, names): the first HISTORY states are s, the
    last HISTORY are s'. The last step of an episode or demonstration has no following state: its own state is repeated.
    """

    observes = "states"
    pairs = True

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
        self._expert = Steps(settings, drop_noop=False)

    def discriminator(self) -> nn.Module:
        """A new network for f."""
        return Shaped(self.settings.network, len(self.settings.tasks), self.settings.ppo.discount)

    def logits(self, observations: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """The logits of D, log pi(a | s) - f(s, a, s'), shape (n,)."""
        with torch.no_grad():
            chances = self._actor(observations[:, :-1], tasks).log_softmax(1)
        return chances.gather(1, actions[:, None])[:, 0] - self._discriminator(observations, actions, tasks)

    @torch.no_grad()
    def learnt_reward(self, observations: Tensor, following: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """g(s, a), shape (n,): the reward function without the potentials that shape it."""
        del following
        return cast("Shaped", self._discriminator).reward(observations, actions, tasks)

    def reward(self, observations: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """f(s, a, s') - log pi(a | s), shape (n,)."""
        return -self.logits(observations, actions, tasks)


class Shaped(nn.Module):
    """f(s, a, s'): a reward g(s, a), and potentials h that shape it."""

    def __init__(self, network: NetworkSettings, tasks: int, discount: float) -> None:
        super().__init__()
        self.discount = discount
        self.reward = Discriminator(network, tasks, states=True)
        self.torso = StateTorso(network)
        self.head = Heads(tasks, self.torso.features, 1)

    def forward(self, steps: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """The values of f, shape (n,), for steps (n, HISTORY + 1, names), actions (n,) and tasks (n,)."""
        before, after = steps[:, :-1], steps[:, 1:]
        shaping = self.discount * self.potential(after, tasks) - self.potential(before, tasks)
        return self.reward(before, actions, tasks) + shaping

    def potential(self, histories: Tensor, tasks: Tensor) -> Tensor:
        """h(s), shape (n,)."""
        return self.head(self.torso(histories), tasks)[:, 0]


class Steps(Dataset):
    """Demonstrations whose rows also contain the following state."""

    def rows(self, numbers: Sequence[Tensor]) -> Batch:
        """The rows with these numbers, observations (n, HISTORY + 1, names)."""
        batch = super().rows(numbers)
        following = []
        for rows, lengths in zip(numbers, self.lengths, strict=True):
            last = torch.tensor(lengths).cumsum(0) - 1
            following.append(torch.where(torch.isin(rows, last), rows, rows + 1))
        after = super().rows(following).observations[:, -1:]
        return batch._replace(observations=torch.cat([batch.observations, after], 1))
