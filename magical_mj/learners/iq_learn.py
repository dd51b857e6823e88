"""Inverse soft Q-learning from states, in its offline form."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from magical_mj.learners.bc import BehaviouralCloning
from magical_mj.learners.data import Dataset, shares
from magical_mj.learners.settings import InverseSettings, TrainingSettings
from magical_mj.scene.actions import NOOP


class IQLearn(BehaviouralCloning):
    """Inverse soft Q-learning (Garg et al. 2021, arXiv:2106.12142) in its offline form: cloning with another loss.

    One network represents a soft Q function. It determines a policy, pi(a | s) = exp((Q(s, a) - V(s)) / temperature),
    where V is the temperature times the log of the sum of exp(Q / temperature) over actions. It also determines a
    reward, r(s, a) = Q(s, a) - discount V(s'). With its regulariser chi^2, the paper maximises over the demonstrations

        E[r - r^2 / (4 alpha)] - E[V(s) - discount V(s')].

    Without the square this is behavioural cloning. The square keeps the rewards that explain the demonstrator small, so
    that the values of successive states have to agree. No episodes are played. The actor's logits are Q / temperature,
    so that it draws actions from pi.

    As in behavioural cloning, steps with the no-op are left out, but they may be successors. The last step of each
    demonstration is also left out, since it has no successor.
    """

    observes = "states"
    drop_noop = False
    learns_reward = True

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
        self._usable = [usable(self._data, task) for task in range(len(settings.tasks))]

    def loss(self) -> tuple[Tensor, Tensor, Tensor, Mapping[str, float]]:
        """Also the mean reward in the batch."""
        counts = shares(self.settings.bc.batch_size, len(self._usable), self._draw)
        rows = [
            numbers[torch.randint(len(numbers), (count,), generator=self._draw)]
            for numbers, count in zip(self._usable, counts, strict=True)
        ]
        observations, actions, tasks = self._data.rows(rows)
        following, _, _ = self._data.rows([numbers + 1 for numbers in rows])
        actions, tasks = actions.to(self.device), tasks.to(self.device)
        logits, next_logits = (
            self._actor(self._augmented(states, self._noise), tasks) for states in (observations, following)
        )
        loss, rewards = iq_loss(logits, next_logits, actions, self.settings.iq)
        return loss, logits, actions, {"reward": rewards.mean().item()}

    @torch.no_grad()
    def learnt_reward(self, observations: Tensor, following: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """Q(s, a) - discount V(s'), shape (n,)."""
        self._actor.eval()
        logits, next_logits = self._actor(observations, tasks), self._actor(following, tasks)
        return soft_rewards(logits, next_logits, actions, self.settings.iq)


def soft_rewards(logits: Tensor, next_logits: Tensor, actions: Tensor, settings: InverseSettings) -> Tensor:
    """The rewards Q(s, a) - discount V(s'), shape (n,). Arguments: see `iq_loss`."""
    chosen = logits.gather(1, actions[:, None])[:, 0]
    return settings.temperature * (chosen - settings.discount * next_logits.logsumexp(1))


def usable(data: Dataset, task: int) -> Tensor:
    """The numbers of a task's rows that have a successor and an action other than the no-op."""
    actions, lengths = data.actions(task), torch.tensor(data.lengths[task])
    last = torch.zeros(len(actions), dtype=torch.bool)
    last[lengths.cumsum(0) - 1] = True
    return (~last & (actions != NOOP)).nonzero()[:, 0]


def iq_loss(logits: Tensor, next_logits: Tensor, actions: Tensor, settings: InverseSettings) -> tuple[Tensor, Tensor]:
    """The loss divided by the temperature, comparable with behavioural cloning's, and the rewards (n,).

    Args:
        logits: Q / temperature, shape (n, 18).
        next_logits: Q / temperature of the successors, shape (n, 18).
        actions: the demonstrator's, shape (n,).
        settings: the method's settings.
    """
    rewards = soft_rewards(logits, next_logits, actions, settings)
    # E[r] - E[V(s) - discount V(s')] = E[Q(s, a) - V(s)] = temperature E[log pi(a | s)]
    cloning = nn.functional.cross_entropy(logits, actions)
    return cloning + rewards.square().mean() / (4 * settings.alpha * settings.temperature), rewards.detach()
