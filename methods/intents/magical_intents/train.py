"""Trains policies for many intents: a skill, sight, and a scorer that receives a sentence, or demonstrations.

python -m magical_intents.train OUT

It writes the networks into OUT/skill, OUT/sight and OUT/scorer, and the folders of policies: OUT/sentence and
OUT/demonstrations with the scorer, and OUT/inference and OUT/pictures, which infer the intent. A second call with the
same folder continues the training.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical_intents import inferring
from magical_intents.ends import RIGHT, Judged, judged
from magical_intents.policy import DEMONSTRATIONS, POLICY, SENTENCE
from magical_intents.practice import practised
from magical_intents.scenery import views
from magical_intents.scorer import Scorer
from magical_intents.sight import Sight, sight_loss
from magical_intents.skill import Skill, skill_loss
from magical_intents.symmetries import changed, drawn, renamed, words_of
from magical_mj.intents import SETS, Intent
from magical_mj.learners import checkpoint
from magical_mj.learners.learner import seeded
from magical_mj.policies.models import torch_settings
from magical_mj.utils.errors import TrainingError

NOVICE, SKILL, SIGHT, SCORER = "novice", "skill", "sight", "scorer"
"""The trainings. The novice is a skill that acts in a part of the practice of the final one."""
UPDATES: Final = {NOVICE: 4000, SKILL: 4000, SIGHT: 2200, SCORER: 1500}
PRACTICE: Final = {NOVICE: 17, SKILL: 6}
"""The number of files of practice that each adds."""
VIEWS: Final = 12
"""The number of files of pictures."""
LEARNING_RATE: Final = {NOVICE: 1e-3, SKILL: 1e-3, SIGHT: 2.5e-3, SCORER: 1e-3}
LARGEST: Final = 1.0
"""The largest norm of a gradient."""
SAVED: Final = 100
"""The number of updates between two writes of the network."""
GROUPS: Final = 32
"""The number of intents in the scorer's batch."""
MOST_SHOWN: Final = 4
"""The largest number of demonstrations."""
ENDS: Final = 8
"""The number of final scenes for each intent, in an initial scene that is not demonstrated. The first is right."""
FIRST: Final = 0.3
"""The share of intents whose demonstrations include the scene that the rivals are consistent with."""
CONTRAST: Final = 0.3
"""The weight of the choice between ends in the scorer's loss."""
READING: Final = 0.5
"""The weight of the scorer's loss with the sentence."""


class Lesson(NamedTuple):
    """An intent: the words of its sentences, shape (sentences, LENGTH), and final scenes."""

    words: NDArray[np.int64]
    scenes: list[Judged]


def lessons(intents: Sequence[Intent]) -> list[Lesson]:
    """The intents with final scenes, without simulation. Those with fewer scenes than a batch needs are left out."""
    every = [Lesson(words_for(intent), judged(intent, np.random.default_rng(k))) for k, intent in enumerate(intents)]
    return [one for one in every if len(one.scenes) > MOST_SHOWN]


def words_for(intent: Intent) -> NDArray[np.int64]:
    """The words of an intent's sentences, shape (sentences, LENGTH)."""
    return np.stack([words_of(sentence) for sentence in intent.paraphrases])


def train(
    data: Sequence[Any],
    out: Path,
    kind: str,
    *,
    updates: int | None = None,
    saved: int = SAVED,
    seed: int = 0,
    watch: Callable[[int, float], object] = lambda _, __: None,
) -> None:
    """Trains a skill with `Steps`, sight with `View`s, or the scorer with `Lesson`s, and writes it into `out`.

    After each writing of the network, `watch` is called with the number of updates and the mean loss.

    Raises:
        TrainingError: if the folder holds another training.
    """
    updates = updates or UPDATES[kind]
    path, training = out / POLICY, {"kind": kind, "updates": updates, "samples": len(data), "seed": seed}
    with seeded(seed):
        network: Any = {SCORER: Scorer, SIGHT: Sight}.get(kind, Skill)()
    optimizer = torch.optim.Adam(network.parameters(), LEARNING_RATE[kind])
    rate = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.01, updates)
    done, losses = 0, []
    if path.exists():
        state = checkpoint.read(path)
        if state["training"] != training:
            raise TrainingError(f"{path} is of another training, {state['training']}: give another folder")
        done = state["updates"]
        network.load_state_dict(state["weights"])
        optimizer.load_state_dict(state["optimizer"])
        rate.load_state_dict(state["rate"])
    out.mkdir(parents=True, exist_ok=True)
    loss_of: Callable[..., Tensor] = {SCORER: scorer_loss, SIGHT: sight_loss}.get(kind, skill_loss)
    for update in range(done, updates):
        loss = loss_of(network, data, np.random.default_rng([seed, update]))
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), LARGEST)
        optimizer.step()
        rate.step()
        losses.append(loss.item())
        if (update + 1) % saved == 0 or update + 1 == updates:
            kept = {"weights": network.state_dict(), "optimizer": optimizer.state_dict(), "rate": rate.state_dict()}
            checkpoint.write(path, {"training": training, "updates": update + 1, **kept})
            watch(update + 1, float(np.mean(losses)))
            losses.clear()


def skilled(out: Path, seed: int = 0) -> None:
    """Trains the skill, with the practice in a folder. The novice acts first in the last part of the practice."""
    steps = practised(out / "practice", PRACTICE[NOVICE])
    train(steps, out / NOVICE, NOVICE, seed=seed, watch=_print)
    novice = Skill()
    novice.load_state_dict(checkpoint.read(out / NOVICE / POLICY)["weights"])
    steps += practised(out / "recovery", PRACTICE[SKILL], novice.eval())
    train(steps, out / SKILL, SKILL, seed=seed, watch=_print)


def write_policies(out: Path) -> None:
    """Writes the folders of the policies, with the networks in `out`."""
    skill, sight, scorer = (checkpoint.read(out / kind / POLICY)["weights"] for kind in (SKILL, SIGHT, SCORER))
    for name, contents in {"inference": {}, "pictures": {"sight": sight}}.items():
        (out / name).mkdir(exist_ok=True)
        checkpoint.write(out / name / inferring.POLICY, {"skill": skill, **contents})
    for given in (SENTENCE, DEMONSTRATIONS):
        (out / given).mkdir(exist_ok=True)
        checkpoint.write(out / given / POLICY, {"given": given, "skill": skill, "scorer": scorer})


class Batch(NamedTuple):
    """Final scenes for a scorer.

    Attributes:
        shown: the starts and the ends of m demonstrations of each intent, each of shape (groups, m, names).
        words: a sentence of each, shape (groups, LENGTH).
        start, ends: pairs of states to score, each of shape (groups, ends, names).
        scores: their scores, shape (groups, ends).
    """

    shown: tuple[Tensor, Tensor]
    words: Tensor
    start: Tensor
    ends: Tensor
    scores: Tensor


def batch(data: Sequence[Lesson], rng: np.random.Generator, *, symmetries: bool = True) -> Batch:
    """A batch. All its intents have the same number of demonstrations, from 1 to `MOST_SHOWN`, in different scenes."""
    number, groups = int(rng.integers(1, MOST_SHOWN + 1)), []
    for _ in range(GROUPS):
        lesson = data[int(rng.integers(len(data)))]
        order = rng.permutation(len(lesson.scenes)).tolist()
        if rng.random() < FIRST:
            order.insert(0, order.pop(order.index(0)))
        shown, asked = [lesson.scenes[k] for k in order[:number]], lesson.scenes[order[number]]
        others = RIGHT + rng.permutation(len(asked.ends) - RIGHT)[: ENDS - 1]
        chosen = np.concatenate([rng.integers(RIGHT, size=1), others])
        groups.append((
            np.stack([one.start for one in shown]),
            np.stack([one.ends[int(rng.integers(RIGHT))] for one in shown]),
            np.repeat(asked.start[None], ENDS, 0),
            asked.ends[chosen],
            asked.scores[chosen],
            lesson.words[int(rng.integers(len(lesson.words)))],
        ))  # fmt: skip
    *states, scores, words = (np.stack(part) for part in zip(*groups, strict=True))
    tensors = [torch.from_numpy(part) for part in states]
    if symmetries:
        by = drawn(GROUPS, rng)
        tensors, words = [changed(part, by) for part in tensors], renamed(words, by)
    before, after, start, ends = tensors
    return Batch((before, after), torch.from_numpy(words), start, ends, torch.from_numpy(scores))


def scorer_loss(network: Scorer, data: Sequence[Lesson], rng: np.random.Generator) -> Tensor:
    """The cross-entropy of scores, and of the choice of the right end, with demonstrations and with sentences."""
    seen = batch(data, rng)
    shown, told = logits_of(network, seen)
    return _loss(shown, seen.scores) + READING * _loss(told, seen.scores)


def logits_of(network: Scorer, seen: Batch) -> tuple[Tensor, Tensor]:
    """The logits of a batch's ends with demonstrations, and with sentences, each of shape (groups, ends)."""
    encoded = network.encoded(seen.start.flatten(0, 1), seen.ends.flatten(0, 1))
    scales = network.shown(*seen.shown), network.told(seen.words)
    shown, told = (network.scored(*encoded, each.repeat_interleave(ENDS, 0)).view(-1, ENDS) for each in scales)
    return shown, told


def _loss(logits: Tensor, scores: Tensor) -> Tensor:
    chance = nn.functional.binary_cross_entropy_with_logits(logits, scores)
    choice = nn.functional.cross_entropy(without_right(logits, scores), torch.zeros(len(scores), dtype=torch.int64))
    return chance + CONTRAST * choice


def without_right(logits: Tensor, scores: Tensor) -> Tensor:
    """The logits of ends, without those after the first that also reach the intent."""
    right = scores == 1.0
    right[:, 0] = False
    return logits.masked_fill(right, -1e4)


@torch.inference_mode()
def quality(network: Scorer, data: Sequence[Lesson], batches: int = 10) -> tuple[float, float]:
    """How often the right end has the largest logit, with demonstrations and with sentences."""
    found = []
    for number in range(batches):
        seen = batch(data, np.random.default_rng(number), symmetries=False)
        both = [without_right(logits, seen.scores).argmax(1) == 0 for logits in logits_of(network, seen)]
        found.append([float(right.float().mean()) for right in both])
    shown, told = np.mean(found, axis=0).tolist()
    return shown, told


def _print(updates: int, loss: float) -> None:
    sys.stdout.write(f"{updates} {loss:.4f}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=0, help="of the networks and the batches")
    chosen = parser.parse_args()
    with torch_settings(1):
        skilled(chosen.out, chosen.seed)
        train(views(chosen.out / "views", VIEWS), chosen.out / SIGHT, SIGHT, seed=chosen.seed, watch=_print)
        train(lessons(SETS["train"]), chosen.out / SCORER, SCORER, seed=chosen.seed, watch=_print)
        write_policies(chosen.out)
