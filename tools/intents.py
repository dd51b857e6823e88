"""Draws the sets of intents, and measures the expert on them.

    python -m tools.intents draw             writes magical_mj/intents/sets.txt
    python -m tools.intents show 200         prints random intents with their sentences
    python -m tools.intents expert OUT       plays the test sets with the expert; called again, it continues
    python -m tools.intents picture          draws docs/intents.png
    python -m tools.intents demonstrations   makes those of the test sets, and writes the file that the package ships;
                                             called again, it continues. It takes half an hour of one core

An intent is accepted if it has scenes, each of its relations adds something to the others, and random actions solve it
in at most a fifth of the episodes. No test intent has the same meaning as a training intent: meanings are compared in
the starts and ends of plans of all test intents.
"""

from __future__ import annotations

import hashlib
import lzma
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from itertools import count, islice
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

import magical_mj
from magical_mj.actions import ACTIONS
from magical_mj.demos import stored
from magical_mj.engine import Engine
from magical_mj.evaluation.scores import read
from magical_mj.intents import EIGHT
from magical_mj.intents.given import DEMONSTRATIONS_GIVEN
from magical_mj.intents.intent import Intent, intent_of, parse
from magical_mj.intents.names import FILE, NAMES, tasks_in
from magical_mj.intents.plans import planned
from magical_mj.intents.relations import RELATIONS, Conjunct
from magical_mj.intents.scenes import keeps
from magical_mj.intents.selectors import ALL, REGION, REST, ROBOT, Selector, Test, names_one
from magical_mj.intents.tasks import PREFIX, Task, spec_of
from magical_mj.scene import Scene
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.tasks.languages import members
from magical_mj.tasks.registry import task_name
from magical_mj.tasks.rules import pick, uniform_integer
from magical_mj.utils.errors import DemonstrationError, IntentError, PlacementError
from magical_mj.variants import vary
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
    "in": 4.0, "out": 2.0, "exactly": 2.0, "wall": 3.0, "near": 4.0, "line": 1.5, "clustered": 0.5, "robot in": 0.5,
    "robot wall": 0.5, "robot near": 1.0, "corner": 2.0, "apart": 1.5,
}  # fmt: skip
VARIANTS: Final = ("Demo", "Layout", "All")
TESTS: Final = ("seen", "combined", "selector", "relation", "long")
TRAIN, DEV, TEST = 1000, 50, 50
SPARE: Final = 5
"""The number of further test intents, since some have the meaning of others."""
CHANCE: Final = 0.2
PICTURED: Final = (
    "in(colour=red, region) & untouched(others)",
    "near(all, to=blue star)",
    "wall(nearest=region, left)",
    "line(all)",
)
"""The intents in the picture of the docs."""
EPISODES, FIRST = 20, 3
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


def proposals(rng: Rng, number: int, relations: Sequence[str], selectors: Sequence[str]) -> Iterator[Intent]:
    """Random intents of a number of relations; 0: one, two, or one and leave all others where they are."""
    while True:
        form = number or weighted(rng, {"1": 0.35, "2": 0.45, "rest": 0.2})
        conjuncts = [conjunct(rng, relations, selectors) for _ in range(1 if form == "rest" else int(form))]
        if form == "rest":
            conjuncts.append(Conjunct("untouched", REST))
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


def fault(intent: Intent) -> str:
    """Why an intent is not accepted; empty if it is."""
    try:
        spec = spec_of(Task(intent))
        scenes = [spec.demo, *(vary(spec, variant, seed) for variant in ("Layout", "All") for seed in range(2))]
    except (IntentError, PlacementError) as error:
        return str(error)
    for place, one in enumerate(intent.conjuncts):
        rest = Intent(tuple(other for number, other in enumerate(intent.conjuncts) if number != place))
        if not rest.conjuncts or keeps(one) or any(other.selector == REST for other in rest.conjuncts):
            continue
        if all(Intent((one,)).holds(*planned(rest, scene)) for scene in scenes):
            return f"{one} adds nothing"
    share = solved_by_chance(intent)
    return f"random actions solve {share:.0%}" if share > CHANCE else ""


def solved_by_chance(intent: Intent) -> float:
    """The share of episodes in Layout that random actions solve; of the first ones only, if they solve none."""
    rng, wins = np.random.default_rng(0), 0
    engine = Engine(f"intent:{intent}", "Layout", seed=0)
    for seed in range(EPISODES):
        engine.reset(seed=seed)
        while not engine.step(int(rng.integers(len(ACTIONS)))):
            pass
        wins += engine.score() == 1.0
        if seed == FIRST - 1 and not wins:
            return 0.0
    return wins / EPISODES


# The sets


def from_words(rng: Rng, words: Sequence[Conjunct], number: int, own: Callable[[], Conjunct] | None = None) -> Intent:
    """An intent of some relations: one is drawn by `own`, if given, and the others are among the words."""
    while True:
        conjuncts = [own()] if own else []
        conjuncts += [pick(rng, words) for _ in range(number - len(conjuncts))]
        try:
            intent = intent_of(conjuncts)
        except IntentError:
            continue
        arranged = [one for one in conjuncts if one.relation in ARRANGEMENTS]
        if len(intent.conjuncts) == number and len(arranged) < 2:
            return intent


def accepted(intents: Iterator[Intent], number: int, taken: set[str], name: str) -> list[Intent]:
    """The first accepted ones. `taken` has the texts of others."""
    found: list[Intent] = []
    while len(found) < number:
        intent = next(intents)
        if str(intent) in taken:
            continue
        taken.add(str(intent))
        if not fault(intent):
            found.append(intent)
            if not len(found) % 25:
                print(f"{name}: {len(found)}", file=sys.stderr, flush=True)
    return found


def draw() -> dict[str, list[str]]:
    """Set -> the texts of its tasks."""
    rng, taken = np.random.default_rng(2026), set(map(str, EIGHT.values()))
    known = [kind for kind in SELECTORS if kind not in NEVER_TRAINED_SELECTORS]
    trained = [name for name in RELATIONS_DRAWN if name not in NEVER_TRAINED_RELATIONS]
    both = accepted(proposals(rng, 0, trained, known), TRAIN + DEV, taken, "train")
    train, dev = both[:TRAIN], both[TRAIN:]
    of_each = [name for name in trained if RELATIONS[name].each]
    words = sorted({one for intent in train for one in intent.conjuncts})
    moving = [one for one in words if one.relation != "untouched"]

    def number() -> int:
        return uniform_integer(rng, 1, 2)

    tests = {
        "combined": (from_words(rng, moving, 2) for _ in count()),
        "selector": (
            from_words(rng, words, number(), lambda: conjunct(rng, of_each, NEVER_TRAINED_SELECTORS)) for _ in count()
        ),
        "relation": (
            from_words(rng, words, number(), lambda: conjunct(rng, NEVER_TRAINED_RELATIONS, known)) for _ in count()
        ),
        "long": (from_words(rng, words, 3) for _ in count()),
    }
    found = {name: accepted(intents, TEST + SPARE, taken, name) for name, intents in tests.items()}
    scenes = [pair for intents in found.values() for intent in intents for pair in ends(intent)]
    meanings = {meaning(intent, scenes) for intent in (*train, *dev)}
    kept: dict[str, list[Intent]] = {"dev": dev}
    for name, intents in found.items():
        kept[name] = []
        for intent in intents:
            if (truth := meaning(intent, scenes)) not in meanings:
                meanings.add(truth)
                kept[name].append(intent)
        kept[name] = kept[name][:TEST]
    order = np.argsort(rng.random(TRAIN))
    seen = (Task(train[index], seed=1) for index in order if has_scenes(Task(train[index], seed=1)))
    texts: dict[str, list[str]] = {name: list(map(str, intents)) for name, intents in {"train": train, **kept}.items()}
    texts["seen"] = [str(task) for task in islice(seen, TEST)]
    return {name: texts[name] for name in NAMES}


def has_scenes(task: Task) -> bool:
    """Whether demo scenes are found for a task."""
    try:
        return bool(spec_of(task))
    except IntentError:
        return False


def ends(intent: Intent) -> list[tuple[Scene, Scene]]:
    """Starts of an intent, and ends that satisfy it."""
    spec = spec_of(Task(intent))
    starts = [spec.demo, *(vary(spec, variant, 0) for variant in ("Layout", "CountPlus", "All"))]
    return [planned(intent, scene) for scene in starts]


def meaning(intent: Intent, scenes: Sequence[tuple[Scene, Scene]]) -> tuple[bool, ...]:
    """In which of the pairs of scenes it holds."""
    return tuple(intent.holds(*pair) for pair in scenes)


def write() -> None:
    """Writes the file of the sets."""
    text = "\n".join(f"# {name}\n{chr(10).join(texts)}\n" for name, texts in draw().items())
    FILE.write_text(text, encoding="utf-8")
    print(f"DIGEST in magical_mj/intents/names.py should be {hashlib.sha256(text.encode()).hexdigest()}")


def show(number: int) -> None:
    """Prints intents with their sentences, and what was not accepted."""
    rng, shown = np.random.default_rng(7), 0
    for intent in proposals(rng, 0, list(RELATIONS_DRAWN), list(SELECTORS)):
        why = fault(intent)
        print(f"- {intent}: {why}" if why else f"{shown:3} {intent}   |   {intent.sentence}", flush=True)
        shown += not why
        if shown == number:
            return


# The expert


def expert(out: str) -> None:
    """Plays one episode of each test intent in three variants, and prints the shares of solved ones and what failed."""
    path = Path(out)
    tasks = {name: list(map(task_name, members(f"intent:{name}"))) for name in TESTS}
    every = [task for names in tasks.values() for task in names]
    if path.exists():
        magical_mj.evaluate("expert", tasks=every, variants=VARIANTS, episodes=1, out=path, resume=True)
    else:
        magical_mj.evaluate("expert", tasks=every, variants=VARIANTS, episodes=1, out=path)
    scores = {(row.task, row.variant): row for row in read(path)}
    print(f"| Set | {' | '.join(VARIANTS)} |\n| --- |{' ---: |' * len(VARIANTS)}")
    for name, names in tasks.items():
        shares = [sum(scores[task, variant].score == 1.0 for task in names) / len(names) for variant in VARIANTS]
        print(f"| {name} | {' | '.join(f'{share:.2f}' for share in shares)} |")
    failed = [row for row in scores.values() if row.score < 1.0]
    print(f"\n{len(scores) - len(failed)} of {len(scores)} episodes are solved. Not solved:")
    for row in failed:
        print(f"- {row.task}, {row.variant}: {row.score:.2f}")


def demonstrations() -> None:
    """Makes the demonstrations that `evaluate` gives by default in the test sets, and ships those that were made."""
    tasks = [f"{PREFIX}{task}" for name in TESTS for task in tasks_in(name)]
    keys = [(task, "Demo", number) for task in tasks for number in range(DEMONSTRATIONS_GIVEN)]
    path = ROOT / "out" / "intents" / stored.default_path().name
    try:
        stored.complete(keys, path, known=stored.shipped(), watch=lambda *done: print(*done, end="\r", file=sys.stderr))
    except DemonstrationError as error:
        print(error, file=sys.stderr)
    made = {**stored.read(path), **stored.shipped()}
    lines = [msgspec.json.encode(made[key]) for key in keys if key in made]
    stored.shipped_path().write_bytes(lzma.compress(b"\n".join(lines), preset=9))
    print(f"{stored.shipped_path()}: {len(lines)} of {len(keys)} demonstrations")


# The picture


def picture() -> None:
    """Draws the initial scene of some intents, and the final scene of a plan, into docs/intents.png."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 5.6), layout="constrained")
    panels: Any = figure.subfigures(2, 2, wspace=0.04, hspace=0.04)
    for panel, text in zip(panels.flat, PICTURED, strict=True):
        intent = parse(text)
        start = intent.spec().demo
        panel.suptitle(f"{text}\n{intent.sentence}", fontsize=8)
        for axes, scene in zip(panel.subplots(1, 2), planned(intent, start), strict=True):
            with closing(Engine.of_scene(scene, renderer="software")) as engine:
                axes.imshow(engine.render("allo", 240))
            axes.set_axis_off()
    figure.savefig(ROOT / "docs" / "intents.png", dpi=100)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["draw"]:
            write()
        case ["show", number]:
            show(int(number))
        case ["expert", out]:
            expert(out)
        case ["demonstrations"]:
            demonstrations()
        case ["picture"]:
            picture()
        case _:
            sys.exit(__doc__)
