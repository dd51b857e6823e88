"""A policy network for states that is told what to do by a context: a sentence, or moments of demonstrations.

The context is one vector: attention between the words of a sentence, or the moments of all demonstrations, and then
the maxima over them. Moments are a set, as in set transformers (Lee et al. 2019, arXiv:1810.00825).
"""

from __future__ import annotations

import re
import zlib
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical_mj.learners.networks import (
    ENTITY_FEATURES,
    ONE_HOT,
    ROBOT_FEATURES,
    Attention,
    features_of,
    last_layers,
    maxima,
)
from magical_mj.policies.interface import HISTORY

SIZE: Final = 64
HIDDEN: Final = 256
WORDS: Final = 1024
"""The number of word vectors. A word's number is its checksum modulo this, so there is no vocabulary to keep."""
LENGTH: Final = 40
"""The most words of a sentence."""
MOMENTS: Final = 6
"""The number of moments of each demonstration."""


class Entities(nn.Module):
    """Maps histories of states to rows for blocks and regions, with attention between them."""

    def __init__(self, context: int, layers: int) -> None:
        super().__init__()
        self.first = nn.Sequential(
            nn.Linear(ROBOT_FEATURES + ENTITY_FEATURES + context, SIZE), nn.ReLU(), nn.Linear(SIZE, SIZE)
        )
        self.layers = nn.ModuleList(Attention(SIZE) for _ in range(layers))

    def forward(self, histories: Tensor, context: Tensor) -> Tensor:
        """Features (n, ROBOT_FEATURES + SIZE) of histories (n, HISTORY, names), given contexts (n, context)."""
        robot, entities, present = features_of(histories)
        every = torch.cat([robot, context], 1)[:, None].expand(-1, entities.shape[1], -1)
        rows = self.first(torch.cat([entities, every], 2))
        for layer in self.layers:
            rows = layer(rows, present)
        return torch.cat([robot, maxima(rows, present)], 1)


class Sentences(nn.Module):
    """Maps words to contexts."""

    def __init__(self) -> None:
        super().__init__()
        self.words, self.places = nn.Embedding(WORDS, SIZE, padding_idx=0), nn.Embedding(LENGTH, SIZE)
        self.layers = nn.ModuleList(Attention(SIZE) for _ in range(2))

    def forward(self, words: Tensor) -> Tensor:
        """Contexts (n, SIZE) of the numbers of words (n, LENGTH), 0 after the last one."""
        rows, present = self.words(words) + self.places.weight, words > 0
        for layer in self.layers:
            rows = layer(rows, present)
        return maxima(rows, present)


class Demonstrations(nn.Module):
    """Maps moments of demonstrations to contexts."""

    def __init__(self) -> None:
        super().__init__()
        self.moment = Entities(0, 1)
        self.first = nn.Linear(ROBOT_FEATURES + SIZE, SIZE)
        self.layers = nn.ModuleList(Attention(SIZE) for _ in range(2))

    def forward(self, moments: Tensor) -> Tensor:
        """Contexts (n, SIZE) of moments (n, k, HISTORY, names)."""
        flat = moments.flatten(0, 1)
        rows = self.first(self.moment(flat, flat.new_empty(len(flat), 0))).unflatten(0, moments.shape[:2])
        present = torch.ones(rows.shape[:2], dtype=torch.bool, device=rows.device)
        for layer in self.layers:
            rows = layer(rows, present)
        return maxima(rows, present)


class Conditioned(nn.Module):
    """The policy: logits of the 18 actions.

    Attributes:
        context: the part that maps what it is given to contexts.
    """

    def __init__(self, *, reads: bool) -> None:
        super().__init__()
        self.context: Sentences | Demonstrations = Sentences() if reads else Demonstrations()
        self.entities = Entities(SIZE, 2)
        self.last = nn.Sequential(last_layers(ROBOT_FEATURES + 2 * SIZE, HIDDEN, HIDDEN), nn.Linear(HIDDEN, ONE_HOT))

    def forward(self, histories: Tensor, context: Tensor) -> Tensor:
        """Logits (n, 18) for histories (n, HISTORY, names) and contexts (n, SIZE)."""
        return self.last(torch.cat([self.entities(histories, context), context], 1))


def words_of(sentence: str) -> NDArray[np.int64]:
    """The numbers of a sentence's words, shape (LENGTH,)."""
    numbers = [1 + zlib.crc32(word.encode()) % (WORDS - 1) for word in re.findall(r"\w+", sentence.lower())][:LENGTH]
    return np.array(numbers + [0] * (LENGTH - len(numbers)))


def moments_of(states: NDArray[np.float32]) -> NDArray[np.float32]:
    """Moments of a demonstration with these states (steps, names): shape (MOMENTS, HISTORY, names).

    Each is a history of the first state and, last, the state at this moment, so movements are since the start.
    """
    steps = np.linspace(0, len(states) - 1, MOMENTS).round().astype(int)
    moments = np.repeat(states[:1, None], MOMENTS, axis=0).repeat(HISTORY, axis=1)
    moments[:, -1] = states[steps]
    return moments
