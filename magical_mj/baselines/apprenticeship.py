"""Apprenticeship learning by feature matching (appendix, "Apprenticeship learning baseline")."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import torch
from torch import Tensor, nn

from magical_mj.baselines.data import Rollout
from magical_mj.baselines.learner import restore_optimizer, seeded
from magical_mj.baselines.network import SHAPE, Torso, convolutions
from magical_mj.baselines.reinforced import RewardLearner
from magical_mj.baselines.settings import Network, TrainingSettings

FIGURES: Final[tuple[str, ...]] = ("reconstruction", "distance", "reward", "score", "entropy", "kl", "value loss")
"""What updates return, in this order."""

CHUNK: Final = 64
"""Samples at a time: the paper's first layer gives 2.4 MB for each."""


class Apprenticeship(RewardLearner):
    """Finds features on which the policy differs most from the demonstrations, and pays for more of them.

    The first `features.batches` updates train the features as an autoencoder, on demonstrations without augmentation.
    In all others, the best weight vector w of the unit ball for w . (E_demonstrations Phi - E_policy Phi) is known in
    closed form, and the reward w . Phi(s, a) is PPO's. (The paper's ball has the radius 2; rewards are normalised, so
    the radius is nothing to them.) For several tasks, which the paper did not try, each has its own w.

    If a rollout has fewer than `features.samples` samples, the policy's are the latest of several rollouts.
    """

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
        self.updates += settings.features.batches
        size, tasks = settings.features.size, len(settings.tasks)
        with seeded(settings.seed + 1):
            self._coder = Autoencoder(settings.network, size).to(self.device)
        self._optimizer = torch.optim.Adam(self._coder.parameters(), settings.features.learning_rate)
        self._batches = 0
        self._figures: dict[str, float] = dict.fromkeys(FIGURES, 0.0)
        self._weights = torch.zeros(tasks, size, device=self.device)
        self._latest = torch.zeros(tasks, 0, size, device=self.device)

    def update(self) -> Mapping[str, float]:
        """A batch for the autoencoder at first, then a rollout, the weights and PPO; the other's figures stay."""
        if self._batches < self.settings.features.batches:
            self._figures["reconstruction"] = self._reconstruct()
            self._batches += 1
        else:
            self._figures.update(self.play())
        return dict(self._figures)

    def study(self, rollout: Rollout) -> Mapping[str, float]:
        """New weights, and how far apart the mean features are: w . (E_demonstrations Phi - E_policy Phi)."""
        tasks = len(self._weights)
        each = self.settings.features.samples // tasks
        stacks, actions, _ = self.on_device(self._expert.sample(each * tasks, self._draw))
        expert = self._coder.features(stacks, actions).reshape(tasks, each, -1)
        played = (self.on_device(batch) for batch in rollout.batches(self.settings.ppo.minibatch))
        novice = torch.cat([self._coder.features(stacks, actions) for stacks, actions, _ in played])
        novice = novice.reshape(len(rollout.actions), tasks, -1, novice.shape[1]).transpose(0, 1).flatten(1, 2)
        order = torch.randperm(novice.shape[1], generator=self._draw)  # so that any part of the rollout may be left out
        self._latest = torch.cat([self._latest, novice[:, order]], dim=1)[:, -each:]
        difference = expert.mean(1) - self._latest.mean(1)
        self._weights = best_weights(difference)
        return {"distance": (self._weights * difference).sum(1).mean().item()}

    def reward(self, stacks: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """The features that count now, w . Phi(s, a), shape (n,)."""
        return (self._coder.features(stacks, actions) * self._weights[tasks]).sum(1)

    def state(self) -> dict[str, Any]:
        """Of all that plays, of the autoencoder, and the policy's latest features."""
        return {
            **super().state(),
            "coder": self._coder.state_dict(),
            "coder optimizer": self._optimizer.state_dict(),
            "batches": self._batches,
            "figures": self._figures,
            "latest": self._latest,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Takes up a `state`."""
        super().restore(state)
        self._coder.load_state_dict(state["coder"])
        restore_optimizer(self._optimizer, state["coder optimizer"])
        self._batches, self._figures = state["batches"], dict(state["figures"])
        self._latest = state["latest"].to(self.device)

    def _reconstruct(self) -> float:
        batch = self._expert.sample(self.settings.features.batch_size, self._draw)
        stacks, actions, _ = self.on_device(batch)
        loss = self._coder.train().loss(stacks, actions)
        self._optimizer.zero_grad()
        loss.backward()
        self._optimizer.step()
        return loss.item()


def best_weights(difference: Tensor) -> Tensor:
    """The w with ||w||_2 <= 1 and the greatest w . difference, for each row of shape (tasks, features)."""
    return nn.functional.normalize(difference, dim=1)


class Autoencoder(nn.Module):
    """The discriminator's network without its last layer, and its mirror image.

    The paper removes the layer of logits and narrows the one before it; that one keeps its ReLU, as nothing is said of
    removing it. The mirror image puts transposed convolutions for convolutions, and ends in a sigmoid, as pixels
    are in [0, 1]. It is not told the action, for the paper reconstructs pictures.

    Args:
        network: the layers' sizes.
        size: of the features.
    """

    def __init__(self, network: Network, size: int) -> None:
        super().__init__()
        self.encoder = Torso(network, batch_norm=True, actions=True, features=size)
        side, _, channels = SHAPE
        mirror: list[nn.Module] = []  # from the pictures inwards
        for outputs, kernel, stride in convolutions(network):
            inner = math.ceil(side / stride)
            extra = side - ((inner - 1) * stride - 2 * (kernel // 2) + kernel)
            grow = nn.ConvTranspose2d(outputs, channels, kernel, stride, kernel // 2, extra)
            mirror += [*([nn.ReLU(), nn.BatchNorm2d(channels)] if mirror else []), grow]
            side, channels = inner, outputs
        self.decoder = nn.Sequential(
            nn.Linear(size, network.hidden),
            nn.ReLU(),
            nn.Linear(network.hidden, self.encoder.flat),
            nn.ReLU(),
            nn.Unflatten(1, (channels, side, side)),
            *reversed(mirror),
            nn.Sigmoid(),
        )

    def forward(self, stacks: Tensor, actions: Tensor) -> Tensor:
        """The stacks (n, 12, 96, 96) as they come back."""
        return self.decoder(self.encoder(stacks, actions))

    def loss(self, stacks: Tensor, actions: Tensor) -> Tensor:
        """Mean squared error, of values in [0, 1]."""
        return nn.functional.mse_loss(self(stacks, actions), stacks)

    @torch.no_grad()
    def features(self, stacks: Tensor, actions: Tensor) -> Tensor:
        """Phi(s, a), shape (n, size): of each sample for itself, with batch norm's running statistics."""
        self.eval()
        parts = zip(stacks.split(CHUNK), actions.split(CHUNK), strict=True)
        return torch.cat([self.encoder(*part) for part in parts])
