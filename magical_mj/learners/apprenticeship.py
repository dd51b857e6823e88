"""Apprenticeship learning by feature matching (appendix, "Apprenticeship learning baseline")."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

import torch
from torch import Tensor, nn

from magical_mj.learners.data import Rollout
from magical_mj.learners.learner import seeded
from magical_mj.learners.networks import SHAPE, StateTorso, Torso, convolutions
from magical_mj.learners.ppo import RewardLearner
from magical_mj.learners.settings import NetworkSettings, TrainingSettings
from magical_mj.observations import STATE_NAMES
from magical_mj.policies.interface import HISTORY

METRICS: Final[tuple[str, ...]] = ("reconstruction", "distance", "reward", "score", "entropy", "kl", "value loss")
"""The names of the metrics that updates return, in this order."""

CHUNK: Final = 64
"""Samples processed at once. The output of the paper's first layer takes 2.4 MB for each."""
RECONSTRUCTED: Final = [number for number, name in enumerate(STATE_NAMES) if "velocity" not in name]
"""The columns of states that the autoencoder receives and reconstructs."""
RESTART: Final = 100
"""Batches of the autoencoder between two checks for features that are always 0."""


class Apprenticeship(RewardLearner):
    """Learns features, and rewards their largest differences between demonstrations and policy.

    The first `features.batches` updates train the features as an autoencoder, on demonstrations without augmentation.
    Each later update finds the weight vector w in the unit ball that maximises w . (E_demonstrations Phi - E_policy
    Phi). It has a closed form. PPO's reward is w . Phi(s, a). (The paper's ball has radius 2, which has no effect,
    since rewards are normalised.) With several tasks, which the paper did not try, each has its own w.

    If a rollout has fewer than `features.samples` samples, the latest samples of several rollouts are used. The paper
    draws the same number of samples from the demonstrations. Here all steps of the demonstrations are used.

    Attributes:
        autoencoder: its encoder computes the features Phi.
        weights: w of each task, shape (tasks, size).
        latest: the features of the policy's latest samples of each task, shape (tasks, samples, size).
    """

    parts = ("network", "ppo", "features")
    short = MappingProxyType(
        # the paper's PPO settings: the rewards change more between updates than those of other methods
        {"ppo.learning_rate": 6e-5, "ppo.entropy": 1e-5, "ppo.clip": 0.01, "features.samples": 4096}
    )

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
        self.updates += settings.features.batches
        size, tasks = settings.features.size, len(settings.tasks)
        with seeded(settings.seed + 1):
            self.autoencoder = Autoencoder(settings.network, size, states=settings.states).to(self.device)
        self._optimizer = torch.optim.Adam(self.autoencoder.parameters(), settings.features.learning_rate, fused=True)
        self.stateful |= {"autoencoder": self.autoencoder, "autoencoder optimizer": self._optimizer}
        self._batches = 0
        self._metrics: dict[str, float] = dict.fromkeys(METRICS, 0.0)
        self._demonstrated: Tensor | None = None
        self.weights = torch.zeros(tasks, size, device=self.device)
        self.latest = torch.zeros(tasks, 0, size, device=self.device)

    def update(self) -> Mapping[str, float]:
        """Trains the autoencoder first, and later weights and policy. Metrics of the other phase stay constant."""
        if self._batches < self.settings.features.batches:
            self._metrics["reconstruction"] = self._reconstruct()
            self._batches += 1
        else:
            self._metrics.update(super().update())
        return dict(self._metrics)

    def learn_reward(self, rollout: Rollout) -> Mapping[str, float]:
        """Computes new weights; returns the difference of mean features, w . (E_demonstrations Phi - E_policy Phi)."""
        tasks = len(self.weights)
        each = self.settings.features.samples // tasks
        played = (self.on_device(batch) for batch in rollout.batches(self.settings.ppo.minibatch))
        novice = torch.cat([self.autoencoder.features(observations, actions) for observations, actions, _ in played])
        novice = novice.reshape(len(rollout.actions), tasks, -1, novice.shape[1]).transpose(0, 1).flatten(1, 2)
        # in random order, so that random samples are dropped
        order = torch.randperm(novice.shape[1], generator=self.rng)
        self.latest = torch.cat([self.latest, novice[:, order]], dim=1)[:, -each:]
        difference = self._weigh()
        return {"distance": (self.weights * difference).sum(1).mean().item()}

    def reward(self, observations: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """The rewards w . Phi(s, a), shape (n,)."""
        return (self.autoencoder.features(observations, actions) * self.weights[tasks]).sum(1)

    def get_state(self) -> dict[str, Any]:
        """The state of the base class, and the policy's latest features."""
        own = {"batches": self._batches, "metrics": self._metrics, "latest": self.latest}
        return {**super().get_state(), **own}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restores a state from `get_state`."""
        super().set_state(state)
        self._batches, self._metrics = state["batches"], dict(state["metrics"])
        self.latest, self._demonstrated = state["latest"].to(self.device), None
        if self.latest.shape[1]:  # the reward of the last update, also for those who do not train on
            self._weigh()

    def _weigh(self) -> Tensor:
        """Computes the weights. Returns E_demonstrations Phi - E_policy Phi, shape (tasks, features)."""
        if self._demonstrated is None:
            self._demonstrated = self._demonstrated_means()
        difference = self._demonstrated - self.latest.mean(1)
        self.weights = best_weights(difference)
        return difference

    def _demonstrated_means(self) -> Tensor:
        """The mean features of each task's demonstrations, shape (tasks, features), after the features are trained."""
        sums = torch.zeros_like(self.weights)
        for batch in self.expert.batches(CHUNK):
            observations, actions, tasks = self.on_device(batch)
            sums.index_add_(0, tasks, self.autoencoder.features(observations, actions))
        return sums / torch.tensor(self.expert.sizes, device=self.device)[:, None]

    def _reconstruct(self) -> float:
        batch = self.expert.sample(self.settings.features.batch_size, self.rng)
        observations, actions, _ = self.on_device(batch)
        loss = self.autoencoder.train().loss(observations, actions)
        self._optimizer.zero_grad()
        loss.backward()
        self._optimizer.step()
        if (self._batches + 1) % RESTART == 0 and self._batches + RESTART < self.settings.features.batches:
            observations, actions, _ = self.on_device(self.expert.sample(512, self.rng))
            with seeded(self.settings.seed + self._batches):
                self.autoencoder.restart(self.autoencoder.features(observations, actions))
        return loss.item()


def best_weights(difference: Tensor) -> Tensor:
    """The w with ||w||_2 <= 1 and the greatest w . difference, for each row of shape (tasks, features)."""
    return nn.functional.normalize(difference, dim=1)


class Autoencoder(nn.Module):
    """The discriminator's network without its last layer as encoder, with a decoder of observations.

    The paper removes the layer of logits and narrows the layer before it. That layer keeps its ReLU here, since the
    paper does not say otherwise. The decoder of pictures mirrors the encoder, with transposed convolutions and a final
    sigmoid, as pixels are in [0, 1]. The decoder of states has two linear layers. As in the paper, actions are not
    reconstructed: features that reconstruct actions mostly describe actions, and matching them does not help.
    """

    def __init__(self, network: NetworkSettings, size: int, *, states: bool = False) -> None:
        super().__init__()
        if states:
            encoder = StateTorso(network, actions=True, features=size)
        else:
            encoder = Torso(network, batch_norm=True, actions=True, features=size)
        self.encoder = encoder
        self.columns = RECONSTRUCTED if states else slice(None)
        inner: list[nn.Module] = [nn.Linear(size, network.hidden), nn.ReLU()]
        if isinstance(encoder, Torso):
            inner += mirror(network, encoder.flat)
        else:
            inner += [nn.Linear(network.hidden, HISTORY * len(RECONSTRUCTED)), nn.Unflatten(1, (HISTORY, -1))]
        self.decoder = nn.Sequential(*inner)

    def forward(self, observations: Tensor, actions: Tensor) -> Tensor:
        """The reconstructed pictures, shaped as by `as_input`, or states (n, HISTORY, len(RECONSTRUCTED))."""
        return self.decoder(self.encoder(observations, actions))

    def loss(self, observations: Tensor, actions: Tensor) -> Tensor:
        """Mean squared error of the reconstruction."""
        return nn.functional.mse_loss(self(observations, actions), observations[..., self.columns])

    @torch.no_grad()
    def features(self, observations: Tensor, actions: Tensor) -> Tensor:
        """Phi(s, a), shape (n, size), each sample independently: with batch norm's running statistics."""
        self.eval()
        parts = zip(observations.split(CHUNK), actions.split(CHUNK), strict=True)
        return torch.cat([self.encoder(*part) for part in parts])

    @torch.no_grad()
    def restart(self, features: Tensor) -> int:
        """Re-initialises the weights of features that are 0 in all samples (n, size); returns their number.

        A ReLU that is 0 everywhere has no gradient and would stay 0.
        """
        weight, bias = self.encoder.linear[2].parameters()
        dead = (features <= 0).all(0)
        weight[dead] = nn.init.kaiming_uniform_(torch.empty_like(weight), math.sqrt(5))[dead]  # nn.Linear's default
        bias[dead] = 1.0
        return int(dead.sum())


def mirror(network: NetworkSettings, flat: int) -> list[nn.Module]:
    """The layers from the first linear one of a `Torso`, which has `flat` inputs, back to the pictures."""
    side, _, channels = SHAPE
    layers: list[nn.Module] = []  # in the encoder's order
    for outputs, kernel, stride in convolutions(network):
        inner = math.ceil(side / stride)
        extra = side - ((inner - 1) * stride - 2 * (kernel // 2) + kernel)
        grow = nn.ConvTranspose2d(outputs, channels, kernel, stride, kernel // 2, extra)
        layers += [*([nn.ReLU(), nn.BatchNorm2d(channels)] if layers else []), grow]
        side, channels = inner, outputs
    first = [nn.Linear(network.hidden, flat), nn.ReLU(), nn.Unflatten(1, (channels, side, side))]
    return [*first, *reversed(layers), nn.Sigmoid()]
