"""Draws the sets of intents.

    python -m tools.intent_sets draw JOBS    writes magical_mj/intents/sets.jsonl, with this number of processes; called
                                             again, it continues. It takes about an hour of a core
    python -m tools.intent_sets check 5      examines every fifth member of the file again. A third of a second each
    python -m tools.intent_sets show 200     prints random intents with their sentences

Which intents are accepted is in tools/intent_criteria.py. Two were drawn apart. selector/8 is the first accepted of
more proposals with the same random numbers, since that of `draw` means the same as seen/8. relation/30 has other demo
scenes, of seed 6, since the expert cannot solve those of seed 0. Then `python -m tools.intents leave-out` replaced
scenes.
"""

from __future__ import annotations

import hashlib
import itertools
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import islice
from typing import Any, Final

import msgspec
import numpy as np

from magical_mj.intents import EIGHT
from magical_mj.intents.draws import FILE, Draws
from magical_mj.intents.intent import Intent, intent_of, parse
from magical_mj.intents.names import NAMES
from magical_mj.intents.relations import RELATIONS, Conjunct
from magical_mj.intents.selectors import ALL, REGION, REST, ROBOT, Selector, Test, names_one
from magical_mj.intents.tasks import (
    Task,
    spec_of,
    task_of,
)
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.tasks.rules import pick, uniform_integer
from magical_mj.utils.errors import IntentError
from tools.intent_criteria import MATCHED, alike, check, examined, twin
from tools.pages import ROOT

Rng = np.random.Generator
ONE_OF_BOTH: Final = (*COLOURS, *SHAPES)
SELECTORS: Final[dict[str, tuple[float, Callable[[Rng], Selector]]]] = {
    "all": (1.5, lambda _: ALL),
    "colour": (3.0, lambda rng: (Test("colour", pick(rng, COLOURS), rng.random() < 0.75),)),
    "shape": (3.0, lambda rng: (Test("shape", pick(rng, SHAPES), rng.random() < 0.75),)),
    "both": (2.0, lambda rng: (Test("colour", pick(rng, COLOURS)), Test("shape", pick(rng, SHAPES)))),
    "region": (1.5, lambda rng: (Test("colour", REGION, rng.random() < 0.7),)),
    "like": (1.5, lambda rng: (Test("like", pick(rng, ("colour", "shape", "both")), rng.random() < 0.7),)),
    "starts": (1.0, lambda rng: (Test("starts", pick(rng, ("in", "out", "matched", "mismatched"))),)),
    "nearest": (1.5, lambda rng: (Test("nearest", pick(rng, (REGION, ROBOT, *ONE_OF_BOTH))),)),
    "odd": (1.5, lambda rng: (Test("odd", pick(rng, ("colour", "shape"))),)),
    "farthest": (1.5, lambda rng: (Test("farthest", pick(rng, (REGION, ROBOT, *ONE_OF_BOTH))),)),
}
"""Kind of selector -> its weight, and what draws one."""
ARRANGEMENTS: Final = ("clustered", "line", "apart")
"""An intent has at most one of these relations."""
ONE: Final = ("nearest", "farthest", "odd")
"""The kinds that select one block."""
RELATIONS_DRAWN: Final = {
    "in": 4.0, "out": 2.0, "exactly": 2.0, "wall": 3.0, "near": 4.0, "line": 1.5, "clustered": 0.1, "robot in": 0.5,
    "robot wall": 0.5, "robot near": 1.0, "corner": 2.0, "apart": 1.5,
}  # fmt: skip
TRAIN, DEV, TEST = 1000, 50, 50
TRAIN_SLOTS, DEV_SLOTS, SLOTS = 1400, 70, 52
"""The numbers of draws of training and of test intents. There are more than needed, since some repeat others."""
SPARE: Final = range(52, 58)
"""The numbers of further draws of long intents, since some find none."""
SEED: Final = 2026
TRIES: Final = 60
"""The number of proposals for one intent."""
FEWER: Final = 20
"""The same for the counterpart of an intent in another set."""
FORMS: Final = {"1": 0.25, "2": 0.25, "1 rest": 0.2, "2 rest": 0.3}
"""The number of relations of a training intent, and whether all other blocks are untouched -> probability."""
UNTOUCHED: Final = Conjunct("untouched", REST)
MOST_COST: Final = 90.0
"""The largest cost of matched intents, in actions."""
NEVER_TRAINED_SELECTORS: Final = ("odd", "farthest")
NEVER_TRAINED_RELATIONS: Final = ("corner", "apart", "robot near")


def weighted(rng: Rng, weights: dict[str, float]) -> str:
    """One of the keys, with a probability in proportion to its weight."""
    names = list(weights)
    return names[int(np.searchsorted(np.cumsum(list(weights.values())), rng.random() * sum(weights.values())))]


def conjunct(rng: Rng, relations: Sequence[str], selectors: Sequence[str]) -> Conjunct:
    """A random relation about random blocks."""
    name = weighted(rng, {name: RELATIONS_DRAWN[name] for name in relations})
    relation = RELATIONS[name]
    argument = pick(rng, [value for value in relation.arguments if value != "home"])
    if not relation.of_blocks or name == "clustered":
        return Conjunct(name, argument=argument)
    kinds = {kind: SELECTORS[kind][0] for kind in selectors if relation.each or kind not in ONE}
    selector = SELECTORS[weighted(rng, kinds)][1](rng)
    number = uniform_integer(rng, 1, 3) if name == "exactly" else 0
    any_of = relation.quantified and not names_one(selector) and rng.random() < 0.2
    return Conjunct(name, selector, argument, number, any_of)


def proposals(rng: Rng, relations: Sequence[str], selectors: Sequence[str]) -> Iterator[Intent]:
    """Random intents of one relation or two, half of them with `untouched(others)`."""
    while True:
        form = weighted(rng, FORMS)
        conjuncts = [conjunct(rng, relations, selectors) for _ in range(int(form[0]))]
        if form.endswith("rest"):
            conjuncts.append(UNTOUCHED)
        try:
            intent = intent_of(conjuncts)
        except IntentError:
            continue
        arranged = [one for one in conjuncts if one.relation in ARRANGEMENTS]
        if len(intent.conjuncts) == len(conjuncts) and len(arranged) < 2 and all(map(has_sense, conjuncts)):
            yield intent


def has_sense(one: Conjunct) -> bool:
    """Whether a relation wants something that does not hold anyway by what the selector says."""
    starts = {test.value == "out" for test in one.selector if test.name == "starts"}
    return not starts or (one.relation, starts) not in (("in", {False}), ("out", {True}))


# The sets


Group = dict[str, Draws]
"""Set -> draws of an intent; {} if none was accepted."""


def train_slot(number: int) -> Group:
    """An intent like those of the training set; none if `TRIES` proposals are not accepted."""
    rng = np.random.Generator(np.random.PCG64([SEED, 0, number]))
    known = [kind for kind in SELECTORS if kind not in NEVER_TRAINED_SELECTORS]
    trained = [name for name in RELATIONS_DRAWN if name not in NEVER_TRAINED_RELATIONS]
    for intent in islice(proposals(rng, trained, known), TRIES):
        if not isinstance(found := examined(Task(intent)), str):
            return {"train": found[0]}
    return {}


def dev_slot(work: tuple[Draws, Sequence[str]]) -> Group:
    """An intent of the set dev, unless a training intent means the same."""
    draws, texts = work
    task = task_of(draws.task)
    if twin(task.intent, spec_of(task, draws), map(parse, texts)):
        return {}
    return {"dev": msgspec.structs.replace(draws, set="dev")}


class Words:
    """The relations of the training intents."""

    def __init__(self, train: Sequence[Intent]) -> None:
        self.train = train
        self.moving = sorted({one for intent in train for one in intent.conjuncts if one.relation != "untouched"})
        simple = [one for one in self.moving if one.definition.each and one.definition.least]
        self.ones = [one for one in simple if names_one(one.selector)]
        self.others = [one for one in simple if one.selector != ALL and not names_one(one.selector)]
        self.together = {frozenset(pair) for intent in train for pair in itertools.combinations(intent.conjuncts, 2)}


def matched_slot(work: tuple[int, Sequence[str]]) -> Group:
    """Four intents that differ in one respect: of seen, combined, selector and relation.

    They have two relations and `untouched(others)`. The second to fourth have another pair of relations, another
    selector, or another relation than the first; everything else is equal, and their plans are about as long.
    """
    number, texts = work
    rng, words = np.random.Generator(np.random.PCG64([SEED, 1, number])), Words(list(map(parse, texts)))
    for _ in range(TRIES):
        seen = _pair(rng, words)
        found = examined(Task(seen, seed=1), test=True)
        if isinstance(found, str) or found[0].cost > MOST_COST or isinstance(first := examined(Task(seen)), str):
            continue
        model, result = found[0], {"train": first[0], "seen": found[0]}
        for name, variants in (("combined", combined), ("selector", selected), ("relation", related)):
            for intent in islice(variants(rng, seen, words), FEWER):
                other = examined(Task(intent), test=True)
                if isinstance(other, str) or not alike(model, other[0]):
                    continue
                if twin(intent, other[1], [*words.train, seen]):
                    continue
                result[name] = other[0]
                break
            else:
                break
        if len(result) == 5:
            return result
    return {}


def _pair(rng: Rng, words: Words) -> Intent:
    """An intent of two relations of training intents and `untouched(others)`. The first is about one block."""
    while True:
        try:
            intent = intent_of([pick(rng, words.ones), pick(rng, words.others), UNTOUCHED])
        except IntentError:
            continue
        if len(intent.conjuncts) == 3:
            return intent


def _with(seen: Intent, old: Conjunct, new: Conjunct) -> Iterator[Intent]:
    try:
        intent = intent_of([new if one == old else one for one in seen.conjuncts])
    except IntentError:
        return
    if len(intent.conjuncts) == 3 and sum(one.relation in ARRANGEMENTS for one in intent.conjuncts) < 2:
        yield intent


def _moving(rng: Rng, seen: Intent) -> Conjunct:
    """One of the two relations that ask for a change."""
    return pick(rng, [one for one in seen.conjuncts if one != UNTOUCHED])


def combined(rng: Rng, seen: Intent, words: Words) -> Iterator[Intent]:
    """Intents with one relation of a training intent, and one of another with the same word."""
    while True:
        old = _moving(rng, seen)
        (kept,) = (one for one in seen.conjuncts if one not in (old, UNTOUCHED))
        alike = [one for one in words.moving if one.relation == old.relation]
        new = pick(rng, [one for one in alike if names_one(one.selector) == names_one(old.selector)])
        if frozenset((kept, new)) not in words.together:
            yield from _with(seen, old, new)


def selected(rng: Rng, seen: Intent, _: Words) -> Iterator[Intent]:
    """Intents with a selector that no training intent has."""
    while True:
        old = _moving(rng, seen)
        if not old.definition.each:
            continue
        kind = weighted(rng, {name: SELECTORS[name][0] for name in NEVER_TRAINED_SELECTORS})
        yield from _with(seen, old, replace(old, selector=SELECTORS[kind][1](rng), any_of=False))


def related(rng: Rng, seen: Intent, _: Words) -> Iterator[Intent]:
    """Intents with a relation that no training intent has."""
    while True:
        old = _moving(rng, seen)
        names = NEVER_TRAINED_RELATIONS[:2] if old.definition.of_blocks else NEVER_TRAINED_RELATIONS[2:]
        name = pick(rng, names)
        relation = RELATIONS[name]
        selector, any_of = old.selector, old.any_of and relation.quantified
        if name == "apart" and (names_one(selector) or old.any_of):
            continue
        yield from _with(seen, old, Conjunct(name, selector, pick(rng, relation.arguments), 0, any_of))


def long_slot(work: tuple[int, Sequence[str], str]) -> Group:
    """The two relations of an intent of `seen`, and a third one of a training intent."""
    number, texts, seen = work
    rng, words = np.random.Generator(np.random.PCG64([SEED, 2, number])), Words(list(map(parse, texts)))
    both = [one for one in task_of(seen).intent.conjuncts if one != UNTOUCHED]
    for _ in range(TRIES):
        try:
            intent = intent_of([*both, pick(rng, words.others)])
        except IntentError:
            continue
        if len(intent.conjuncts) == 3 and not isinstance(found := examined(Task(intent), test=True), str):
            return {"long": found[0]}
    return {}


def spread(what: str, function: Callable[[Any], Group], work: Sequence[Any], jobs: int) -> list[Group]:
    """The results of a function, in the order of the work. They are kept in out/intents, so a second call continues."""
    path = ROOT / "out" / "intents" / f"{what}.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = path.read_bytes().splitlines() if path.exists() else []
    results: list[Group] = [msgspec.json.decode(line, type=Group) for line in lines]
    with ProcessPoolExecutor(jobs) as pool, path.open("ab") as file:
        for result in pool.map(function, work[len(results) :]):
            results.append(result)
            file.write(msgspec.json.encode(result) + b"\n")
            file.flush()
    return results


def draw(jobs: int) -> list[Draws]:
    """The tasks of all sets."""
    taken = set(map(str, EIGHT.values()))

    def new(name: str, every: Iterable[Draws]) -> Iterator[Draws]:
        for draws in every:
            if draws.task not in taken:
                taken.add(draws.task)
                yield msgspec.structs.replace(draws, set=name)

    slots = [slot["train"] for slot in spread("train", train_slot, range(TRAIN_SLOTS), jobs) if slot]
    both = list(new("train", slots))
    train, texts = both[: TRAIN - TEST], [draws.task for draws in both[: TRAIN - TEST]]
    spare = [(draws, texts) for draws in both[TRAIN - TEST :][:DEV_SLOTS]]
    dev = [slot["dev"] for slot in spread("dev", dev_slot, spare, jobs) if slot][:DEV]
    found = spread("matched", matched_slot, [(k, texts) for k in range(SLOTS)], jobs)
    seen = {number: group["seen"].task for number, group in enumerate(found) if group}
    work = [(k, texts, seen[k]) for k in seen] + [(k, texts, seen[k - TEST]) for k in SPARE]
    found = [group for group in found if group]
    long = [slot["long"] for slot in spread("long", long_slot, work, jobs) if slot]
    print(f"{len(both)} train and dev, {len(found)} matched, {len(long)} long", file=sys.stderr)
    sets = {"train": train, "dev": dev}
    trained = {_pair_of(group["train"]) for group in found}
    groups = [group for group in found if _pair_of(group["combined"]) not in trained][:TEST]
    sets |= {name: list(new(name, (group[name] for group in groups))) for name in MATCHED}
    more = [*(group["train"] for group in groups), *both[TRAIN - TEST + DEV_SLOTS :]]
    own = {draws.task: draws for draws in (*train, *more)}
    sets["train"] = [msgspec.structs.replace(draws, set="train") for draws in own.values()][:TRAIN]
    sets["long"] = list(new("long", long))[:TEST]
    return [draws for name in NAMES for draws in sets[name]]


def _pair_of(draws: Draws) -> frozenset[Conjunct]:
    """The relations of a matched intent, without `untouched(others)`."""
    return frozenset(task_of(draws.task).intent.conjuncts) - {UNTOUCHED}


def write_sets(every: Iterable[Draws]) -> None:
    """Writes the file of the sets."""
    FILE.write_bytes(b"".join(msgspec.json.encode(draws) + b"\n" for draws in every))
    print(f"DIGEST in magical_mj/intents/names.py should be {hashlib.sha256(FILE.read_bytes()).hexdigest()}")


def show(number: int) -> None:
    """Prints intents with their sentences, and what was not accepted."""
    rng, shown = np.random.default_rng(7), 0
    for intent in proposals(rng, list(RELATIONS_DRAWN), list(SELECTORS)):
        why = examined(Task(intent))
        print(
            f"- {intent}: {why}" if isinstance(why, str) else f"{shown:3} {intent}   |   {intent.sentence}", flush=True
        )
        shown += not isinstance(why, str)
        if shown == number:
            return


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["draw", jobs]:
            write_sets(draw(int(jobs)))
        case ["check", every]:
            check(int(every))
        case ["show", number]:
            show(int(number))
        case _:
            sys.exit(__doc__)
