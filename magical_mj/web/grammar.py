"""The language of intents as JSON data, for the page where visitors build one. intent.js reads texts by it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Final

from magical_mj.intents.attribution import task_rivals
from magical_mj.intents.english import CLAUSES, LONG, NUMBERS, WITHOUT_MODEL, noun, reference
from magical_mj.intents.intent import LONGEST, MOST_CONJUNCTS
from magical_mj.intents.names import EIGHT
from magical_mj.intents.relations import RELATIONS
from magical_mj.intents.scenes import NEARLY
from magical_mj.intents.selectors import ALL, NEGATABLE, PAIRS, REFERENCES, REST, VALUES, Selector, Test, text_of
from magical_mj.intents.tasks import LEAST_STEPS, ROUNDED, STEPS_PER_COST
from magical_mj.tasks.planning import CARRYING, FETCHING
from magical_mj.tasks.registry import ENVIRONMENTS, sample_scene
from magical_mj.web.page_data import scene_data

STARTS: Final = ("All", "Layout")
"""Visitors play intents in scenes of these variants."""
SEEDS: Final = 15
RIVALS: Final = 40


def grammar_data() -> dict[str, Any]:
    """Relations and tests with their arguments, their words in sentences, and what limits an episode."""
    relations = {
        name: {
            "arguments": relation.arguments,
            "quantified": relation.quantified,
            "ofBlocks": relation.of_blocks,
            "each": relation.each is not None,
            "prefix": relation.prefix,
            "least": relation.least,
        }
        for name, relation in RELATIONS.items()
    }
    words = {
        "clauses": {kind: clauses[0] for kind, clauses in CLAUSES.items()},
        "nouns": {text_of(one): [noun(one), noun(one, plural=True)] for one in _selectors()},
        "references": {name: reference(name) for name in REFERENCES},
        "numbers": NUMBERS,
        "last": LONG,
        "pause": WITHOUT_MODEL,
    }
    tests = {str(test): test._asdict() for name in VALUES for test in _tests(name)}
    time = {"least": LEAST_STEPS, "rounded": ROUNDED, "rate": STEPS_PER_COST, "fetch": FETCHING, "carry": CARRYING}
    limits = {"most": MOST_CONJUNCTS, "longest": LONGEST, "nearly": NEARLY}
    return {"relations": relations, "tests": tests, "pairs": PAIRS, "words": words, "time": time, **limits}


def _selectors() -> Iterator[Selector]:
    yield from (ALL, REST)
    singles = {name: list(_tests(name)) for name in VALUES}
    for tests in singles.values():
        yield from ((test,) for test in tests)
    for one, other in PAIRS:
        yield from ((first, second) for first in singles[one] for second in singles[other])


def _tests(name: str) -> Iterable[Test]:
    return (Test(name, value, equal) for value in VALUES[name] for equal in (True, False)[: 1 + (name in NEGATABLE)])


def rival_texts() -> dict[str, list[str]]:
    """Task -> the simplest rivals that its demonstrations leave."""
    return {task: [str(rival) for rival in task_rivals(task)[:RIVALS]] for task in EIGHT}


def start_scenes() -> list[dict[str, Any]]:
    """Scenes where an intent may start, all environments with the same seed in turn."""
    pairs = [pair for variant in STARTS for pair in ENVIRONMENTS if pair[1] == variant]
    return [
        {"task": task, "variant": variant, "seed": seed, "scene": scene_data(sample_scene(task, variant, seed))}
        for seed in range(SEEDS)
        for task, variant in pairs
    ]
