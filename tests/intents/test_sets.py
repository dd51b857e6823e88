"""The sets of intents: their digest, what distinguishes them, and their names."""

from __future__ import annotations

import hashlib

import pytest

from magical_mj.intents import EIGHT, SETS, Intent, parse
from magical_mj.intents.names import DIGEST, FILE, NAMES, tasks_in
from magical_mj.intents.plans import solved
from magical_mj.intents.relations import RELATIONS
from magical_mj.intents.scenes import accepts
from magical_mj.protocol import INTENTS
from magical_mj.scene import Scene
from magical_mj.tasks.registry import environments, listed_tasks, task_name, task_spec
from magical_mj.utils.errors import IntentError
from magical_mj.variants import vary

TESTS = ("combined", "selector", "relation", "long")
TRAIN = SETS["train"]


def test_they_are_those_of_the_protocol() -> None:
    assert INTENTS == 1
    assert hashlib.sha256(FILE.read_bytes()).hexdigest() == DIGEST
    assert {name: len(intents) for name, intents in SETS.items()} == {"train": 1000, **dict.fromkeys([*NAMES][1:], 50)}
    every = [intent for name in SETS if name != "seen" for intent in SETS[name]]
    assert len(set(every) | set(EIGHT.values())) == 1250 + 8
    assert all(parse(str(intent)) == intent for intent in every)


def test_each_differs_from_the_training_set_in_what_it_says() -> None:
    words = {conjunct for intent in TRAIN for conjunct in intent.conjuncts}
    relations = {conjunct.relation for conjunct in words}
    tests = {test.name for conjunct in words for test in conjunct.selector}
    assert set(SETS["seen"]) <= set(TRAIN)
    assert {task.seed for task in tasks_in("seen")} == {1}
    assert all(len(intent.conjuncts) == 2 and words.issuperset(intent.conjuncts) for intent in SETS["combined"])
    assert all(len(intent.conjuncts) == 3 and words.issuperset(intent.conjuncts) for intent in SETS["long"])
    new = ("corner", "apart", "robot near")
    assert relations == set(RELATIONS) - set(new)
    assert all(any(conjunct.relation in new for conjunct in intent.conjuncts) for intent in SETS["relation"])
    assert not tests & {"odd", "farthest"}
    for intent in SETS["selector"]:
        assert {test.name for conjunct in intent.conjuncts for test in conjunct.selector} & {"odd", "farthest"}


def test_no_test_intent_means_the_same_as_a_training_intent() -> None:
    """They differ in a start or an end of a plan of one of both; tools/intents.py compares all in 1,000 ends."""

    def scenes(intent: Intent) -> list[tuple[Scene, Scene]]:
        starts = [vary(intent.spec(), variant, seed) for variant in ("Demo", "Layout", "All") for seed in range(2)]
        return [(start, final) for start in starts for final in (start, solved(intent, start) or start)]

    def holds(intent: Intent, pairs: list[tuple[Scene, Scene]]) -> list[bool]:
        return [intent.holds(*pair) for pair in pairs]

    for name in TESTS:
        intent = SETS[name][0]
        pairs = scenes(intent)
        assert holds(intent, pairs) == [False, True] * 6
        alike = [other for other in TRAIN if holds(other, pairs) == [False, True] * 6]
        assert not [other for other in alike if holds(intent, scenes(other)) == [False, True] * 6], intent


@pytest.mark.parametrize("name", NAMES)
def test_scenes_of_some_intents_are_good_starts(name: str) -> None:
    for task in tasks_in(name)[:2]:
        spec = task_spec(f"intent:{task}")
        for variant in ("Demo", "Layout", "All"):
            assert accepts(task.intent, vary(spec, variant, 1)), (task, variant)


def test_members_of_sets_have_names() -> None:
    text = str(SETS["combined"][17])
    assert task_name("intent:combined/17") == f"intent:{text}"
    assert task_name("intent:combined/17 [demos=4, contrasting]") == f"intent:{text} [demos=4, contrasting]"
    assert task_name("intent:seen/0") == f"intent:{SETS['seen'][0]} [seed=1]"
    assert listed_tasks("FindDupe,intent:dev,intent:dev/3")[1:51] == [f"intent:{intent}" for intent in SETS["dev"]]
    assert len(environments("intent:long/1,intent:dev/0", "Demo,All")) == 4
    with pytest.raises(IntentError, match="the set dev has dev/0 to dev/49"):
        task_spec("intent:dev/50")
    with pytest.raises(IntentError, match="the set dev has dev/0 to dev/49"):
        task_spec("intent:dev")
