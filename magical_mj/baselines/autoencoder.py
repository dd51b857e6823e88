"""The features of AL, by an autoencoder of the demonstrations (appendix, "Apprenticeship learning baseline")."""

from __future__ import annotations

import math
from typing import Final

import torch
from torch import Tensor, nn

from magical_mj.baselines.network import SHAPE, Torso, convolutions
from magical_mj.baselines.settings import Network

CHUNK: Final = 64
"""Samples at a time: the paper's first layer gives 2.4 MB for each."""


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
