"""Trains a policy on many intents: it is told which one by a sentence, or by demonstrations in other scenes.

python -m magical_intents.train sentence OUT
python -m magical_intents.train demonstrations OUT

Called again with the same folder, it continues. The demonstrations are made by the expert if they are not there yet.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from magical_intents.network import Conditioned, moments_of, words_of
from magical_intents.policy import POLICY
from magical_mj.demos import Transitions
from magical_mj.intents import SETS, Intent, dataset
from magical_mj.intents.expert_data import Example
from magical_mj.learners import checkpoint
from magical_mj.learners.learner import seeded
from magical_mj.policies.interface import histories
from magical_mj.policies.models import torch_settings
from magical_mj.scene.actions import NOOP
from magical_mj.utils.errors import DemonstrationError, TrainingError

VARIANTS: Final = ("Demo", "Layout", "All")
"""Of each intent one demonstration in each: so what varies in an intent is seen."""
INTENTS: Final = 200
UPDATES: Final = 4000
BATCH: Final = 16
"""The number of intents in a batch."""
STEPS: Final = 16
"""The number of steps of each of them, from one demonstration."""
LEARNING_RATE: Final = 1e-3
SAVED: Final = 200
"""The number of updates after which the policy is written."""


class Shown(NamedTuple):
    """A demonstration: the history before each action but no-ops, the actions, and moments."""

    histories: NDArray[np.float32]
    actions: NDArray[np.int64]
    moments: NDArray[np.float32]


class Lesson(NamedTuple):
    """An intent: the words of its sentences, and its demonstrations."""

    words: list[NDArray[np.int64]]
    shown: list[Shown]


def trained_intents(number: int = INTENTS) -> list[Intent]:
    """The first intents of the set `seen`, which are training intents, and then those of the training set."""
    return list(dict.fromkeys([*SETS["seen"][: number // 10], *SETS["train"]]))[:number]


def lessons(intents: Sequence[Intent], folder: Path | None = None, jobs: int | None = 1) -> list[Lesson]:
    """The intents with their demonstrations, which are kept in `folder`. Those that the expert fails are left out."""
    found = []
    for intent in intents:
        try:
            found.append(lesson(intent, dataset([str(intent)], 1, variants=VARIANTS, folder=folder, jobs=jobs)))
        except DemonstrationError as error:
            warnings.warn(f"left out: {error}", stacklevel=2)
    return found


def lesson(intent: Intent, examples: Iterable[Example | Transitions]) -> Lesson:
    """An intent with some demonstrations from states."""
    shown = []
    for example in examples:
        states = np.asarray(example.observations, np.float32)
        acts = np.flatnonzero(example.actions != NOOP)
        shown.append(Shown(histories(states)[acts], example.actions[acts].astype(np.int64), moments_of(states)))
    return Lesson([words_of(sentence) for sentence in intent.paraphrases], shown)


def train(
    data: Sequence[Lesson],
    out: Path,
    *,
    reads: bool,
    updates: int = UPDATES,
    saved: int = SAVED,
    watch: Callable[[int, float], object] = lambda _, __: None,
) -> None:
    """Minimises -E log pi(a | s, context), with a mean over intents; writes the policy into `out`.

    `watch` is called with the number of updates and the loss when the policy was written.

    Raises:
        TrainingError: if the folder holds another training.
    """
    path, training = out / POLICY, {"reads": reads, "updates": updates, "intents": len(data)}
    with seeded(0):
        network = Conditioned(reads=reads)
    optimizer = torch.optim.Adam(network.parameters(), LEARNING_RATE)
    rate = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.01, updates)
    done = 0
    if path.exists():
        state = checkpoint.read(path)
        if state["training"] != training:
            raise TrainingError(f"{path} is of another training, {state['training']}: give another folder")
        done = state["updates"]
        network.load_state_dict(state["weights"])
        optimizer.load_state_dict(state["optimizer"])
        rate.load_state_dict(state["rate"])
    out.mkdir(parents=True, exist_ok=True)
    for update in range(done, updates):
        loss = _loss(network, data, np.random.default_rng(update), reads=reads)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        rate.step()
        if (update + 1) % saved == 0 or update + 1 == updates:
            kept = {"weights": network.state_dict(), "optimizer": optimizer.state_dict(), "rate": rate.state_dict()}
            checkpoint.write(path, {"reads": reads, "training": training, "updates": update + 1, **kept})
            watch(update + 1, loss.item())


def _loss(network: Conditioned, data: Sequence[Lesson], rng: np.random.Generator, *, reads: bool) -> torch.Tensor:
    """The loss of a batch. The context is a sentence, or the demonstrations without the one that is cloned."""
    given, before, actions = [], [], []
    for number in rng.integers(len(data), size=BATCH):
        lesson = data[number]
        cloned, *others = (lesson.shown[place] for place in rng.permutation(len(lesson.shown)))
        given.append(
            lesson.words[rng.integers(len(lesson.words))] if reads else np.concatenate([o.moments for o in others])
        )
        steps = rng.integers(len(cloned.actions), size=STEPS)
        before.append(cloned.histories[steps])
        actions.append(cloned.actions[steps])
    context = network.context(torch.from_numpy(np.stack(given))).repeat_interleave(STEPS, 0)
    logits = network(torch.from_numpy(np.concatenate(before)), context)
    return nn.functional.cross_entropy(logits, torch.from_numpy(np.concatenate(actions)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("given", choices=["sentence", "demonstrations"])
    parser.add_argument("out", type=Path)
    parser.add_argument("--intents", type=int, default=INTENTS, help="the number of training intents")
    parser.add_argument("--updates", type=int, default=UPDATES, help="the number of updates")
    parser.add_argument("--folder", type=Path, help="where the demonstrations are kept; by default the user's cache")
    chosen = parser.parse_args()
    with torch_settings(1):
        train(
            lessons(trained_intents(chosen.intents), chosen.folder),
            chosen.out,
            reads=chosen.given == "sentence",
            updates=chosen.updates,
            watch=print,
        )
