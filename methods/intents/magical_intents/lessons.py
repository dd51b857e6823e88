"""Training of the scorer: intents with final scenes, batches of them, and the loss."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits as chance
from torch.nn.functional import softplus

from magical_intents.ends import RIGHT, Judged, judged
from magical_intents.scorer import Encoded, Scored, Scorer
from magical_intents.symmetries import changed, drawn, renamed, words_of
from magical_mj.intents import Intent
from magical_mj.learners import checkpoint
from magical_mj.learners.networks import blocks_of

SAMPLES: Final = "samples.safetensors"
GROUPS: Final = 64
"""The number of intents in a batch."""
SENTENCES: Final = 24
"""For this number of them, the scorer reads the sentence. For the others it receives demonstrations."""
MOST_SHOWN: Final = 4
"""The largest number of demonstrations."""
REPEATED: Final = 0.25
"""The share of batches whose intents each have all demonstrations in one scene."""
ENDS: Final = 6
"""The number of final scenes for each intent, in an initial scene that is not demonstrated. The first is right."""
ORDER, PARTS = 0.5, 1.0
"""The weights in the loss: of the order of scores, and of the shares and the named blocks."""
SAME: Final = 0.01
"""Scores that differ by less have no order."""


class Lesson(NamedTuple):
    """An intent: the words of its sentences, shape (sentences, LENGTH), and final scenes."""

    words: NDArray[np.int64]
    scenes: list[Judged]


def lessons(intents: Sequence[Intent]) -> list[Lesson]:
    """The intents with final scenes, without simulation. Those with fewer scenes than a batch needs are left out."""
    every = [Lesson(words_for(intent), judged(intent, np.random.default_rng(k))) for k, intent in enumerate(intents)]
    return [one for one in every if len(one.scenes) > MOST_SHOWN]


def kept_lessons(intents: Sequence[Intent], folder: Path) -> list[Lesson]:
    """The same, from a file in a folder. The first call writes it."""
    path = folder / SAMPLES
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        checkpoint.write(path, {"lessons": [list(lesson) for lesson in lessons(intents)]})
    return [Lesson(words, [Judged(*scene) for scene in scenes]) for words, scenes in checkpoint.read(path)["lessons"]]


def words_for(intent: Intent) -> NDArray[np.int64]:
    """The words of an intent's sentences, shape (sentences, LENGTH)."""
    return np.stack([words_of(sentence) for sentence in intent.paraphrases])


class Batch(NamedTuple):
    """Final scenes for a scorer.

    Attributes:
        shown: the starts and the ends of m demonstrations of each intent, each of shape (groups, m, names).
        words: a sentence of each, shape (groups, LENGTH).
        start: the states before the scenes to score, shape (groups, names).
        ends: the scenes, shape (groups, ends, names).
        scores: their scores, shape (groups, ends).
        shares: the shares of the intent's relations, shape (groups, ends, MOST_CONJUNCTS).
        named: the blocks that the intent names, shape (groups, MAX_BLOCKS).
    """

    shown: tuple[Tensor, Tensor]
    words: Tensor
    start: Tensor
    ends: Tensor
    scores: Tensor
    shares: Tensor
    named: Tensor


def batch(data: Sequence[Lesson], rng: np.random.Generator, *, symmetries: bool = True) -> Batch:
    """A batch. All its intents have the same number of demonstrations, from 1 to `MOST_SHOWN`, in one scene or more."""
    number, repeated, groups = int(rng.integers(1, MOST_SHOWN + 1)), rng.random() < REPEATED, []
    for _ in range(GROUPS):
        lesson = data[int(rng.integers(len(data)))]
        order = rng.permutation(len(lesson.scenes)).tolist()
        first = [order[0]] * number if repeated else order[:number]
        shown, asked = [lesson.scenes[k] for k in first], lesson.scenes[order[number]]
        others = RIGHT + rng.permutation(len(asked.ends) - RIGHT)[: ENDS - 1]
        chosen = np.concatenate([rng.integers(RIGHT, size=1), others])
        groups.append((
            np.stack([one.start for one in shown]),
            np.stack([one.ends[int(rng.integers(RIGHT))] for one in shown]),
            asked.start[None],
            asked.ends[chosen],
            asked.scores[chosen],
            asked.shares[chosen],
            asked.named,
            lesson.words[int(rng.integers(len(lesson.words)))],
        ))  # fmt: skip
    *parts, words = (np.stack(part) for part in zip(*groups, strict=True))
    before, after, start, ends, scores, shares, named = map(torch.from_numpy, parts)
    if symmetries:
        by = drawn(GROUPS, rng)
        before, after, start, ends = (changed(states, by) for states in (before, after, start, ends))
        words = renamed(words, by)
    return Batch((before, after), torch.from_numpy(words), start[:, 0], ends, scores, shares, named)


def scored_in(network: Scorer, seen: Batch) -> tuple[Encoded, Scored]:
    """A batch's scenes. The network reads the sentences of the first `SENTENCES` intents, not of the others."""
    shown = network.shown(*(part[SENTENCES:] for part in seen.shown))
    encoded = network.encoded(seen.start, torch.cat([network.read(seen.words[:SENTENCES]), shown]))
    return encoded, network.scored(encoded.repeated(ENDS), seen.ends.flatten(0, 1))


def scorer_loss(network: Scorer, data: Sequence[Lesson], rng: np.random.Generator) -> Tensor:
    """The cross-entropies of scores, their order, the relations' shares, and the named blocks."""
    seen = batch(data, rng)
    encoded, scored = scored_in(network, seen)
    scores, shares = (part.unflatten(0, (-1, ENDS)) for part in scored)
    better = seen.scores[:, :, None] > seen.scores[:, None] + SAME
    wrong = softplus(scores[:, None] - scores[:, :, None]) * better
    order = (wrong.sum((1, 2)) / better.sum((1, 2)).clamp(min=1)).mean()
    known, count = seen.shares >= 0, int(blocks_of(seen.start)[..., 0].sum(1).max())
    parts = chance(shares[known], seen.shares[known]) + chance(encoded.named[:, :count], seen.named[:, :count])
    return chance(scores, seen.scores) + ORDER * order + PARTS * parts
