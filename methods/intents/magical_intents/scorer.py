"""The scorer: a network that predicts the score of a final scene, from demonstrations or a sentence.

Scenes are graphs of objects, which attend to each other. In an initial scene they also attend to a context: the
words of a sentence, or the objects of all demonstrations. So the network can find the blocks that an intent names. The
final scene adds the objects' new places, and attention between them; then follows a score.

Demonstrations pass through the same network, without a context. The minima, means and maxima of facts about each, over
the demonstrations, show what is common to all, and what varies. They are also part of the context.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from magical_intents.network import SIZE, Objects, Sentences, graph
from magical_mj.intents.intent import MOST_CONJUNCTS
from magical_mj.learners.networks import maxima

FACTS: Final = 128
COMMON: Final = 4
"""The number of rows that tell what demonstrations have in common."""
CONTEXT: Final = 96
"""The number of rows of a context. Rows of zeros do not exist, and further objects of demonstrations are left out."""
HIDDEN: Final = 128


class Encoded(NamedTuple):
    """Initial scenes, encoded with a context.

    Attributes:
        states: shape (n, names).
        rows: of the objects, shape (n, k, SIZE).
        named: the logits of whether the intent names them, shape (n, k).
    """

    states: Tensor
    rows: Tensor
    named: Tensor

    def repeated(self, times: int) -> Encoded:
        """Each several times, one after the other."""
        return Encoded(*(part.repeat_interleave(times, 0) for part in self))


class Scored(NamedTuple):
    """Logits of the scores (n,) of final scenes, and of the shares (n, MOST_CONJUNCTS) of an intent's relations."""

    scores: Tensor
    shares: Tensor


class Scorer(nn.Module):
    """Predicts scores of final scenes, as logits."""

    def __init__(self) -> None:
        super().__init__()
        self.starts, self.ends, self.sentences = Objects(3), Objects(2), Sentences()
        self.facts = nn.Linear(SIZE, FACTS)
        self.common = nn.Sequential(nn.Linear(9 * FACTS, 2 * HIDDEN), nn.ReLU(), nn.Linear(2 * HIDDEN, COMMON * SIZE))
        self.named = nn.Linear(SIZE, 1)
        self.last = nn.Sequential(nn.Linear(5 * SIZE, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, 1 + MOST_CONJUNCTS))

    def shown(self, starts: Tensor, ends: Tensor) -> Tensor:
        """The context of m demonstrations, shape (n, CONTEXT, SIZE), with states (n, m, names)."""
        rows, present = self._ended(self.encoded(starts.flatten(0, 1)), ends.flatten(0, 1))
        facts = _pooled(self.facts(rows), present).unflatten(0, starts.shape[:2])
        common = self.common(torch.cat([facts.amin(1), facts.mean(1), facts.amax(1)], 1))
        rows = (rows * present[..., None]).unflatten(0, starts.shape[:2]).flatten(1, 2)
        return _padded(torch.cat([common.unflatten(1, (COMMON, SIZE)), rows], 1))

    def read(self, words: Tensor) -> Tensor:
        """The context of sentences (n, LENGTH), shape (n, CONTEXT, SIZE)."""
        rows, known = self.sentences(words)
        return _padded(rows * known[..., None])

    def encoded(self, states: Tensor, context: Tensor | None = None) -> Encoded:
        """Initial scenes (n, names), with a context (n, CONTEXT, SIZE) or without."""
        if context is not None:
            context = context[:, : int((context != 0).any(2).any(0).nonzero().max()) + 1]
        rows = self.starts(graph(states, states), context=context)
        return Encoded(states, rows, self.named(rows)[..., 0])

    def scored(self, encoded: Encoded, ends: Tensor) -> Scored:
        """The logits of final scenes (n, names)."""
        rows, present = self._ended(encoded, ends)
        named = encoded.named.sigmoid() * present
        means = [_mean(rows, weights) for weights in (named, present - named)]
        scores, shares = self.last(torch.cat([_pooled(rows, present), *means], 1)).split([1, MOST_CONJUNCTS], 1)
        return Scored(scores[:, 0], shares)

    def _ended(self, encoded: Encoded, ends: Tensor) -> tuple[Tensor, Tensor]:
        """The rows of objects in final scenes, and which exist, as 0 and 1."""
        seen = graph(encoded.states, ends)
        return self.ends(seen, encoded.rows), seen.present.float()


def _padded(rows: Tensor) -> Tensor:
    return pad(rows[:, :CONTEXT], (0, 0, 0, max(0, CONTEXT - rows.shape[1])))


def _pooled(rows: Tensor, present: Tensor) -> Tensor:
    """The minima, the means and the maxima over the rows that exist, shape (n, 3 size)."""
    there = present > 0
    return torch.cat([maxima(rows, there), -maxima(-rows, there), _mean(rows, present)], 1)


def _mean(rows: Tensor, weights: Tensor) -> Tensor:
    """The weighted means of rows (n, k, size), shape (n, size)."""
    return (rows * weights[..., None]).sum(1) / (weights.sum(1, keepdim=True) + 0.01)
