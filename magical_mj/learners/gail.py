"""GAIL, WGAIL-GP and AIRL: the discriminator's output determines the policy's reward (section 4.1).

The discriminator D is near 1 for the policy's samples and near 0 for the demonstrator's, as in the paper.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, cast

import torch
from torch import Tensor, nn

from magical_mj.learners.augmentation import augmentation
from magical_mj.learners.data import Batch, Rollout, TrainingData, joined
from magical_mj.learners.learner import seeded
from magical_mj.learners.networks import Heads, StateTorso, Torso
from magical_mj.learners.ppo import RewardLearner, Samples
from magical_mj.learners.settings import NetworkSettings, TrainingSettings

Samplewise = Callable[[Tensor, Tensor, Tensor], Tensor]
"""A discriminator: a function of observations, actions (n,) and tasks (n,) with one output for each sample, (n,)."""


class Discriminator(nn.Module):
    """The paper's network with batch norm, or the one for states; it also receives actions and has a head per task."""

    def __init__(self, network: NetworkSettings, tasks: int, *, states: bool = False) -> None:
        super().__init__()
        self.torso = StateTorso(network, actions=True) if states else Torso(network, batch_norm=True, actions=True)
        self.head = Heads(tasks, self.torso.features, 1)

    def forward(self, observations: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """Logits (GAIL) or values (WGAIL-GP) of D, shape (n,)."""
        return self.head(self.torso(observations, actions), tasks)[:, 0]


class Adversarial(RewardLearner):
    """Trains the `discriminator` on the latest rollouts and the demonstrations, and PPO on its rewards."""

    parts = ("network", "ppo", "discriminator")
    unused: ClassVar[tuple[str, ...]] = ("precision", "discriminator.gradient_penalty")

    def __init__(self, settings: TrainingSettings) -> None:
        self._augment = augmentation(settings)  # first, so that errors are raised before environments are made
        super().__init__(settings)
        self.latest: list[Rollout] = []
        self.noise_rng = torch.Generator(self.device).manual_seed(settings.seed)
        with seeded(settings.seed + 1):
            self.discriminator = self.new_discriminator().to(self.device)
        rate = settings.discriminator.learning_rate
        self._optimizer = torch.optim.Adam(self.discriminator.parameters(), rate, fused=True)
        self.stateful |= {"discriminator": self.discriminator, "discriminator optimizer": self._optimizer}
        self.stateful |= {"noise": self.noise_rng}

    def new_discriminator(self) -> nn.Module:
        """A new discriminator, a `Samplewise`."""
        return Discriminator(self.settings.network, len(self.settings.tasks), states=self.settings.states)

    def learn_reward(self, rollout: Rollout) -> Mapping[str, float]:
        """The discriminator's steps; returns the means of their metrics."""
        steps = self.settings.discriminator.steps
        self.latest = [*self.latest, rollout][-self.settings.discriminator.rollouts :]
        played = joined(self.latest)
        metrics = [self.train_discriminator(played) for _ in range(steps)]
        return {name: sum(step[name] for step in metrics) / steps for name in metrics[0]}

    @abstractmethod
    def loss(self, samples: Samples) -> tuple[Tensor, Mapping[str, float]]:
        """The discriminator's loss and metrics. The first half of the samples are the policy's."""

    def get_state(self) -> dict[str, Any]:
        """The state of the base class, and the rollouts that later updates use again."""
        earlier = self.settings.discriminator.rollouts - 1
        latest = self.latest[-earlier:] if earlier else []
        arrays = [{name: values.numpy() for name, values in rollout._asdict().items()} for rollout in latest]
        return {**super().get_state(), "latest": arrays}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restores a state from `get_state`."""
        super().set_state(state)
        arrays = ([rollout[name] for name in Rollout._fields] for rollout in state["latest"])
        self.latest = [Rollout(*map(torch.as_tensor, values)) for values in arrays]

    def train_discriminator(self, rollout: Rollout) -> Mapping[str, float]:
        """One step of the discriminator on samples of this rollout and of the demonstrations; returns its metrics."""
        half = self.settings.discriminator.batch_size // 2
        sides = [self.on_device(side.sample(half, self.rng)) for side in (rollout, self.expert)]
        observations, actions, tasks = (torch.cat(pair) for pair in zip(*sides, strict=True))
        self.discriminator.train()
        loss, metrics = self.loss((self._augment(observations, self.noise_rng), actions, tasks))
        self._optimizer.zero_grad()
        loss.backward()
        self._optimizer.step()
        return {"loss": loss.item(), **metrics}


class GAIL(Adversarial):
    """Minimises -E_policy log D - E_demonstrations log(1 - D); the policy's reward is -log D."""

    def loss(self, samples: Samples) -> tuple[Tensor, Mapping[str, float]]:
        """The loss, and the share of correctly classified samples."""
        policy, expert = self.logits(*samples).chunk(2)
        right = torch.cat([policy > 0, expert < 0]).float().mean().item()
        return gail_loss(policy, expert), {"accuracy": right}

    def reward(self, observations: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """-log D, shape (n,)."""
        self.discriminator.eval()
        return nn.functional.softplus(-self.logits(observations, actions, tasks))

    def logits(self, observations: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """The logits of D, shape (n,)."""
        return self.discriminator(observations, actions, tasks)


class WGAILGP(Adversarial):
    """Minimises E_demonstrations D - E_policy D and a penalty on gradients; the policy's reward is -D.

    The penalty's samples are those of the batch, half the policy's and half the demonstrator's, as in the paper's
    formula (WGAN-GP interpolates between them). No gradient flows into the policy.
    """

    unused = ("precision",)

    def loss(self, samples: Samples) -> tuple[Tensor, Mapping[str, float]]:
        """The loss, the difference between the two means of D, and the penalty without its weight."""
        policy, expert = self.discriminator(*samples).chunk(2)
        distance = policy.mean() - expert.mean()
        penalty = gradient_penalty(self.discriminator.eval(), *samples)
        metrics = {"distance": distance.item(), "penalty": penalty.item()}
        return self.settings.discriminator.gradient_penalty * penalty - distance, metrics

    def reward(self, observations: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """-D, shape (n,)."""
        return -self.discriminator.eval()(observations, actions, tasks)


def gail_loss(policy: Tensor, expert: Tensor) -> Tensor:
    """-mean log D(policy) - mean log(1 - D(expert)), for logits of D."""
    return nn.functional.softplus(-policy).mean() + nn.functional.softplus(expert).mean()


def gradient_penalty(discriminator: Samplewise, observations: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
    """Mean of (||gradient of D with respect to the stack||_2 - 1)^2.

    The gradient is that of each sample's D with respect to its own stack. So the discriminator must treat samples
    independently: if it has batch norm, it must use the running statistics (eval mode), as it does for the rewards.
    With the statistics of the batch, each D would depend on all samples.
    """
    observations = observations.detach().requires_grad_()
    values = discriminator(observations, actions, tasks)
    (gradient,) = torch.autograd.grad(values.sum(), observations, create_graph=True)
    return (gradient.flatten(1).norm(dim=1) - 1).square().mean()


class AIRL(GAIL):
    """AIRL, adversarial inverse reinforcement learning (Fu et al. 2018, arXiv:1710.11248), from states.

    It is GAIL with a discriminator that contains a reward function f: its logits are log pi(a | s) - f(s, a, s').

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
        self.expert = SuccessiveData(settings, drop_noop=False)

    def new_discriminator(self) -> nn.Module:
        """A new network for f."""
        return Shaped(self.settings.network, len(self.settings.tasks), self.settings.ppo.discount)

    def logits(self, observations: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """The logits of D, log pi(a | s) - f(s, a, s'), shape (n,)."""
        with torch.no_grad():
            chances = self._actor(observations[:, :-1], tasks).log_softmax(1)
        return chances.gather(1, actions[:, None])[:, 0] - self.discriminator(observations, actions, tasks)

    @torch.no_grad()
    def learnt_reward(self, observations: Tensor, following: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """g(s, a), shape (n,): the reward function without the potentials that shape it."""
        del following
        return cast("Shaped", self.discriminator).reward(observations, actions, tasks)

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


class SuccessiveData(TrainingData):
    """Demonstrations whose rows also contain the following state."""

    def rows(self, indices: Sequence[Tensor]) -> Batch:
        """The rows with these indices, observations (n, HISTORY + 1, names)."""
        batch = super().rows(indices)
        following = [rows + ~last[rows] for rows, last in zip(indices, self.last, strict=True)]
        after = super().rows(following).observations[:, -1:]
        return batch._replace(observations=torch.cat([batch.observations, after], 1))
