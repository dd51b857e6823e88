"""The scorer: a network that predicts the score of a final scene, from demonstrations or a sentence.

Each pair of an initial and a final scene is a graph of objects, which attend to each other. A demonstration becomes
facts, the maxima and means over its objects. The minima, means and maxima of the facts over the demonstrations show
what is common to all, and what varies. They set the scales of a last layer, which scores final scenes. A sentence sets
the same scales.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor, nn

from magical_intents.network import SIZE, Objects, Sentences, graph
from magical_mj.learners.networks import maxima

LAYERS: Final = 2
FACTS: Final = 128
TOLD: Final = 256
"""The size of what demonstrations or a sentence tell."""
HIDDEN: Final = 128
"""The size of the last layer."""
SCALES: Final = 4 * HIDDEN + 1
"""The scales: a factor and an offset of each hidden unit, a weight of its maximum and its mean, and the bias."""


class Scorer(nn.Module):
    """Predicts scores of final scenes, as logits. Computes in bfloat16."""

    def __init__(self) -> None:
        super().__init__()
        self.objects, self.norm = Objects(LAYERS), nn.LayerNorm(SIZE)
        self.facts = nn.Linear(SIZE, FACTS)
        self.common = nn.Sequential(nn.Linear(6 * FACTS, 2 * TOLD), nn.ReLU(), nn.Linear(2 * TOLD, TOLD))
        self.sentences, self.read = Sentences(), nn.Linear(SIZE, TOLD)
        self.scales = nn.Sequential(nn.LayerNorm(TOLD), nn.ReLU(), nn.Linear(TOLD, SCALES))
        self.last = nn.Linear(SIZE, HIDDEN)

    def forward(self, starts: Tensor, ends: Tensor, scales: Tensor) -> Tensor:
        """Logits (n,) of pairs of states (n, names), each with its scales (n, SCALES)."""
        return self.scored(*self.encoded(starts, ends), scales)

    @torch.autocast("cpu", torch.bfloat16)
    def encoded(self, starts: Tensor, ends: Tensor) -> tuple[Tensor, Tensor]:
        """Rows (n, k, SIZE) for the objects of pairs of states (n, names), and which exist, shape (n, k)."""
        seen = graph(starts, ends)
        return self.norm(self.objects(seen)), seen.present

    @torch.autocast("cpu", torch.bfloat16)
    def shown(self, starts: Tensor, ends: Tensor) -> Tensor:
        """The scales (n, SCALES) that m demonstrations each set, with states (n, m, names)."""
        rows, present = self.encoded(starts.flatten(0, 1), ends.flatten(0, 1))
        facts = _pooled(self.facts(rows), present).unflatten(0, starts.shape[:2])
        return self.scales(self.common(torch.cat([facts.amin(1), facts.mean(1), facts.amax(1)], 1))).float()

    @torch.autocast("cpu", torch.bfloat16)
    def told(self, words: Tensor) -> Tensor:
        """The scales (n, SCALES) that sentences (n, LENGTH) set."""
        rows, known = self.sentences(words)
        mean = (rows * known[..., None]).sum(1) / known.sum(1, keepdim=True)
        return self.scales(self.read(mean)).float()

    @torch.autocast("cpu", torch.bfloat16)
    def scored(self, rows: Tensor, present: Tensor, scales: Tensor) -> Tensor:
        """Logits (n,) of encoded pairs, each with its scales (n, SCALES)."""
        factor, offset, weight, bias = scales.split([HIDDEN, HIDDEN, 2 * HIDDEN, 1], 1)
        hidden = (self.last(rows) * (1 + factor)[:, None] + offset[:, None]).relu()
        return (_pooled(hidden, present) * weight).sum(1) / HIDDEN**0.5 + bias[:, 0]


def _pooled(rows: Tensor, present: Tensor) -> Tensor:
    """The maxima and the means over the rows that exist, shape (n, 2 size)."""
    there = present[..., None]
    return torch.cat([maxima(rows, present), (rows * there).sum(1) / there.sum(1)], 1).float()
