"""Trains policies for many intents: a skill, and planners that receive a sentence, or demonstrations in other scenes.

python -m magical_intents.train OUT

It writes OUT/skill, OUT/sentence and OUT/demonstrations. The last two are folders of policies. A second call with
the same folder continues the training.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical_intents.network import Planner, Skill
from magical_intents.plans import SCENES, planned, wrong_end
from magical_intents.policy import KINDS, POLICY
from magical_intents.subgoals import DONE, UNDONE, Labels, Shown, labels_of
from magical_intents.symmetries import MIRRORED, Symmetry, changed, drawn, moved, renamed, words_of
from magical_mj import demos
from magical_mj.demos import Transitions
from magical_mj.demos.learning import stream
from magical_mj.intents import EIGHT, SETS, Intent, dataset
from magical_mj.intents.expert_data import Example
from magical_mj.learners import checkpoint
from magical_mj.learners.learner import seeded
from magical_mj.learners.settings import STATE
from magical_mj.policies.models import torch_settings
from magical_mj.utils.errors import DemonstrationError, TrainingError

VARIANTS: Final = ("Demo", "Layout", "All")
"""Each intent has one demonstration in each of these variants, so that its demonstrations differ."""
INTENTS: Final = 1000
"""The number of intents of the plans."""
UPDATES: Final = {"skill": 8000, "sentence": 1200, "demonstrations": 1200}
LEARNING_RATE: Final = 1e-3
LARGEST: Final = 1.0
"""The largest norm of a gradient."""
SAVED: Final = 100
"""The number of updates between two writes of the network."""
GROUPS: Final = 48
"""The number of contexts in a planner's batch."""
STEPS: Final = 4
"""The number of steps for each context, from demonstrations that are not part of it."""
ALIKE: Final = 0.3
"""The share of contexts that repeat one demonstration, as if all were in one scene."""
DECISIVE: Final = 0.5
"""The share of decisive steps, when the object changes. The other steps are random."""
REST: Final = 6
"""The number of learnt steps after the last object was brought."""
MOST_SHOWN: Final = 4
"""The largest number of demonstrations in a context."""
SKILLS: Final = 512
"""The number of steps in a batch of the skill."""
NOISE: Final = (0.01, 0.01, 0.02)
"""The standard deviation of noise on the robot's pose: units, units, rad."""
PLACE_NOISE: Final = 0.02
"""The standard deviation of noise on the targets that the skill receives (units)."""
WEIGHT: Final = 0.3
"""The weight of targets in the planner's loss."""


class Lesson(NamedTuple):
    """An intent: the words of its sentences, shape (sentences, LENGTH), and its demonstrations."""

    words: NDArray[np.int64]
    shown: list[Shown]


class Quality(NamedTuple):
    """The quality of a planner's predictions in steps of demonstrations."""

    loss: float
    objects: float
    """The share of states with the correct object."""
    places: float
    """Among these steps, the share of targets with an error of at most 0.15 units."""


def trained_intents(number: int = INTENTS) -> list[Intent]:
    """The first intents of the set `seen`, which are training intents, and then those of the training set."""
    return list(dict.fromkeys([*SETS["seen"][: number // 10], *SETS["train"]]))[:number]


def demonstrated(
    intents: Iterable[Intent], preset: str, folder: Path | None = None
) -> Iterator[tuple[Intent, list[Example]]]:
    """The intents, each with a demonstration in each of `VARIANTS`. Intents that the expert fails are left out.

    The demonstrations are kept in `folder`.
    """
    for intent in intents:
        try:
            yield intent, list(dataset([str(intent)], 1, preset, variants=VARIANTS, folder=folder, jobs=1))
        except DemonstrationError as error:
            warnings.warn(f"left out: {error}", stacklevel=2)


def shipped_lessons() -> list[Lesson]:
    """The intents of the benchmark's eight tasks, with the demonstrations that come with the package."""
    return [lesson(intent, stream(demos.load(task), STATE, drop_noop=False)) for task, intent in EIGHT.items()]


def lesson(intent: Intent, examples: Iterable[Example | Transitions]) -> Lesson:
    """An intent with some demonstrations from states."""
    shown = []
    for example in examples:
        states, actions = np.asarray(example.observations, np.float32), np.asarray(example.actions, np.int64)
        labels = labels_of(states, actions)
        if (labels.objects == DONE).all():  # all motions were too small
            continue
        last = int(np.flatnonzero(labels.objects != DONE).max(initial=0)) + 1
        rows = slice(min(len(actions), last + REST))
        cut = Labels(labels.objects[rows], labels.places[rows])
        first = np.flatnonzero(np.diff(cut.objects, prepend=-1))
        shown.append(Shown(states[rows], actions[rows], cut, states[-1], first))
    return Lesson(words_for(intent), shown)


def planned_lessons(intents: Sequence[Intent], scenes: int = SCENES) -> list[Lesson]:
    """The intents with plans of the expert, without simulation. Intents with fewer than two plans are left out."""
    every = [Lesson(words_for(one), planned(one, np.random.default_rng(k), scenes)) for k, one in enumerate(intents)]
    return [one for one in every if len(one.shown) > 1]


def words_for(intent: Intent) -> NDArray[np.int64]:
    """The words of an intent's sentences, shape (sentences, LENGTH)."""
    return np.stack([words_of(sentence) for sentence in intent.paraphrases])


def train(
    data: Sequence[Lesson],
    out: Path,
    kind: str,
    *,
    skill: Path | None = None,
    updates: int | None = None,
    saved: int = SAVED,
    seed: int = 0,
    watch: Callable[[int, float], object] = lambda _, __: None,
) -> None:
    """Trains one of `KINDS`, and writes it into `out`. A planner's folder also gets the skill, and is a policy.

    The skill learns from demonstrations, the planners from plans.

    After each writing of the network, `watch` is called with the number of updates and the mean loss.

    Raises:
        TrainingError: if the folder holds another training.
    """
    updates = updates or UPDATES[kind]
    path, training = out / POLICY, {"kind": kind, "updates": updates, "intents": len(data), "seed": seed}
    with seeded(seed):
        network: Any = Skill() if kind == "skill" else Planner(reads=kind == "sentence")
    optimizer = torch.optim.Adam(network.parameters(), LEARNING_RATE)
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
    skill_weights = checkpoint.read(skill / POLICY)["weights"] if skill else None
    out.mkdir(parents=True, exist_ok=True)
    for update in range(done, updates):
        rng = np.random.default_rng([seed, update])
        loss = skill_loss(network, data, rng) if kind == "skill" else planner_loss(network, data, rng)
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), LARGEST)
        optimizer.step()
        rate.step()
        losses.append(loss.item())
        if (update + 1) % saved == 0 or update + 1 == updates:
            kept = {"weights": network.state_dict(), "optimizer": optimizer.state_dict(), "rate": rate.state_dict()}
            checkpoint.write(path, {"training": training, "updates": update + 1, "skill": skill_weights, **kept})
            watch(update + 1, float(np.mean(losses)))
            losses.clear()


def skill_loss(network: Skill, data: Sequence[Lesson], rng: np.random.Generator) -> Tensor:
    """-E log pi(a | s, object, target) in steps of all demonstrations before `DONE`."""
    states, actions, objects, places = [], [], [], []
    for number in rng.integers(len(data), size=SKILLS // 8):
        shown = data[number].shown[rng.integers(len(data[number].shown))]
        (steps,) = np.nonzero(shown.labels.objects != DONE)
        steps = steps[rng.integers(len(steps), size=8)]
        states.append(shown.states[steps])
        actions.append(shown.actions[steps])
        objects.append(shown.labels.objects[steps])
        places.append(shown.labels.places[steps])
    by = drawn(SKILLS, rng)
    now = torch.from_numpy(np.concatenate(states))
    now[:, :3] += torch.from_numpy(rng.normal(0.0, NOISE, (SKILLS, 3))).float()
    wanted = (
        torch.from_numpy(np.concatenate(places))
        + PLACE_NOISE * torch.from_numpy(rng.standard_normal((SKILLS, 2))).float()
    )
    right = torch.from_numpy(np.concatenate(actions))
    logits = network(changed(now[:, None], by)[:, 0], torch.from_numpy(np.concatenate(objects)), moved(wanted, by))
    return nn.functional.cross_entropy(logits, torch.where(by.mirrored, MIRRORED[right], right))


class Batch(NamedTuple):
    """Steps for a planner: the states at the start and now (n, names), the context's input, and the labels."""

    initial: Tensor
    now: Tensor
    given: Tensor
    objects: Tensor
    places: Tensor


def batch(
    data: Sequence[Lesson],
    rng: np.random.Generator,
    *,
    reads: bool,
    symmetries: bool = True,
) -> Batch:
    """A batch. The context is a sentence, or demonstrations, and the steps are from other demonstrations.

    The last row of each context is a wrong end, with the label `UNDONE`.
    """
    initial, now, given, objects, places = [], [], [], [], []
    for _ in range(GROUPS):
        lesson = data[int(rng.integers(len(data)))]
        order = rng.permutation(len(lesson.shown))
        number = min(int(rng.integers(1, MOST_SHOWN + 1)), len(order) - 1)
        context, others = order[:number], order[number:]
        for index in rng.choice(others, STEPS).tolist():
            cloned = lesson.shown[index]
            step = rng.choice(cloned.decisive) if rng.random() < DECISIVE else rng.integers(len(cloned.states))
            initial.append(cloned.states[0])
            now.append(cloned.states[step])
            objects.append(cloned.labels.objects[step])
            places.append(cloned.labels.places[step])
        wrong = lesson.shown[int(others[0])]
        initial.append(wrong.states[0])
        now.append(wrong_end(wrong, rng))
        objects.append(UNDONE)
        places.append(np.zeros(2, np.float32))
        if reads:
            given.append(lesson.words[rng.integers(len(lesson.words))])
            continue
        if rng.random() < ALIKE:
            context = np.repeat(context[:1], number)
        ends = np.zeros((MOST_SHOWN, 2, len(initial[0])), np.float32)
        for row, index in enumerate(context.tolist()):
            ends[row] = lesson.shown[index].states[0], lesson.shown[index].final
        given.append(ends)
    start, current, wanted = (
        torch.from_numpy(np.stack(rows)).unflatten(0, (GROUPS, STEPS + 1)) for rows in (initial, now, places)
    )
    context = np.stack(given)
    if symmetries:
        by = drawn(GROUPS, rng)
        start, current, wanted = changed(start, by), changed(current, by), moved(wanted, by)
        context = renamed(context, by) if reads else _changed_ends(context, by)
    return Batch(
        start.flatten(0, 1),
        current.flatten(0, 1),
        torch.as_tensor(context),
        torch.from_numpy(np.array(objects)),
        wanted.flatten(0, 1),
    )


def _changed_ends(ends: NDArray[np.float32], by: Symmetry) -> Tensor:
    return changed(torch.from_numpy(ends).flatten(1, 2), by).unflatten(1, ends.shape[1:3])


def planner_loss(network: Planner, data: Sequence[Lesson], rng: np.random.Generator) -> Tensor:
    """The negative log-likelihood of objects and targets, averaged over the batch."""
    seen = batch(data, rng, reads=network.reads)
    objects, places = network(seen.initial, seen.now, network.context(seen.given)).likelihood(seen.objects, seen.places)
    return -(objects + WEIGHT * places).mean()


@torch.inference_mode()
def quality(network: Planner, data: Sequence[Lesson], batches: int = 10) -> Quality:
    """A planner's quality in random steps."""
    found = []
    for number in range(batches):
        seen = batch(data, np.random.default_rng(number), reads=network.reads, symmetries=False)
        plan = network(seen.initial, seen.now, network.context(seen.given))
        objects, places = plan.best()
        loss = -(plan.likelihood(seen.objects, seen.places)[0]).mean()
        right = torch.where(seen.objects == UNDONE, objects != DONE, objects == seen.objects)
        near = (places - seen.places).norm(dim=1)[right & (seen.objects != UNDONE) & (objects < DONE)] <= 0.15
        found.append((loss, right.float().mean(), near.float().mean()))
    return Quality(*(float(np.mean(values)) for values in zip(*found, strict=True)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--intents", type=int, default=INTENTS, help="the number of intents of the plans")
    parser.add_argument("--seed", type=int, default=0, help="of the networks and the batches")
    chosen = parser.parse_args()
    with torch_settings(1):
        skills, plans = shipped_lessons(), planned_lessons(trained_intents(chosen.intents))
        for kind in KINDS:
            train(
                skills if kind == "skill" else plans,
                chosen.out / kind,
                kind,
                skill=None if kind == "skill" else chosen.out / "skill",
                seed=chosen.seed,
                watch=lambda updates, loss, kind=kind: sys.stdout.write(f"{kind} {updates} {loss:.4f}\n"),
            )
