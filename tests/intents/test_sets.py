"""The sets of intents: their digest, what distinguishes them, what shortcuts reach in them, and their names."""

from __future__ import annotations

import hashlib
import itertools

import numpy as np
import pytest

import magical_mj
from magical_mj.intents import EIGHT, SETS, parse, shortcuts
from magical_mj.intents.by_set import floors
from magical_mj.intents.draws import FILE, in_sets
from magical_mj.intents.names import DIGEST, NAMES, TESTS, tasks_in
from magical_mj.intents.relations import RELATIONS
from magical_mj.intents.scenes import accepts
from magical_mj.intents.selectors import REST
from magical_mj.protocol import INTENTS
from magical_mj.tasks.registry import environments, listed_tasks, task_name, task_spec
from magical_mj.utils.errors import EvaluationError, IntentError
from magical_mj.variants import vary

MATCHED = ("seen", "combined", "selector", "relation")
TRAIN = SETS["train"]
NEW_RELATIONS = ("corner", "apart", "robot near")
NEW_SELECTORS = ("odd", "farthest")


def test_they_are_those_of_the_protocol() -> None:
    assert INTENTS == 2
    assert hashlib.sha256(FILE.read_bytes()).hexdigest() == DIGEST
    assert {name: len(intents) for name, intents in SETS.items()} == {"train": 1000, **dict.fromkeys([*NAMES][1:], 50)}
    every = [intent for name in SETS if name != "seen" for intent in SETS[name]]
    assert len(set(every) | set(EIGHT.values())) == 1250 + 8
    assert all(parse(str(intent)) == intent for intent in every)


def test_each_differs_from_the_training_set_in_one_respect() -> None:
    words = {one for intent in TRAIN for one in intent.conjuncts}
    together = {frozenset(pair) for intent in TRAIN for pair in itertools.combinations(intent.conjuncts, 2)}
    assert {one.relation for one in words} == set(RELATIONS) - {*NEW_RELATIONS, "near corner"}
    assert not {test.name for one in words for test in one.selector} & set(NEW_SELECTORS)
    assert set(SETS["seen"]) <= set(TRAIN)
    assert {task.seed for task in tasks_in("seen")} == {1}
    for name in MATCHED:
        for intent, seen in zip(SETS[name], SETS["seen"], strict=True):
            assert len(intent.conjuncts) == 3
            assert intent.conjuncts[-1].selector == REST
            changed = set(intent.conjuncts) - set(seen.conjuncts)
            if name != "seen":
                (new,), (old,) = changed, set(seen.conjuncts) - set(intent.conjuncts)
                assert (new.relation == old.relation) == (name != "relation")
                assert (new.relation in NEW_RELATIONS) == (name == "relation")
                assert (bool(new.selector) and new.selector[0].name in NEW_SELECTORS) == (name == "selector")
            if name == "combined":
                pair = frozenset(one for one in intent.conjuncts if one.selector != REST)
                assert words >= pair
                assert pair not in together
    assert all(len(intent.conjuncts) == 3 and words.issuperset(intent.conjuncts) for intent in SETS["long"])


def test_selector_and_relation_have_words_that_no_training_sentence_has() -> None:
    def words(name: str) -> set[str]:
        return {word.strip(",.") for intent in SETS[name] for word in intent.sentence.lower().split()}

    new = {name: words(name) - words("train") for name in TESTS}
    assert {name for name in TESTS if new[name]} == {"selector", "relation"}
    assert new["selector"] >= {"farthest", "differs"}
    assert new["relation"] >= {"corner", "apart"}


def test_matched_sets_take_the_same_effort() -> None:
    for value in ("cost", "moves"):
        medians = [np.median([getattr(one, value) for one in in_sets() if one.set == name]) for name in MATCHED]
        assert max(medians) <= 1.15 * min(medians), (value, medians)


@pytest.mark.parametrize("name", TESTS)
def test_shortcuts_fail(name: str) -> None:
    assert set(floors()[name]) == set(shortcuts)
    assert max(floors()[name].values()) <= 0.1


def test_each_shortcut_has_a_name_of_its_own_in_results() -> None:
    settings = {"tasks": "intent:dev/3", "variants": "Layout", "episodes": 1, "preset": "State", "jobs": 1}
    names = ("circling", "nearest blocks")
    found = [magical_mj.evaluate(shortcuts[name], **settings)["policy"].tolist() for name in names]
    assert found == [["shortcut circling"], ["shortcut nearest blocks"]]
    with pytest.raises(EvaluationError, match="shortcuts need the simulation of an intent"):
        magical_mj.evaluate(shortcuts["all blocks"], **{**settings, "tasks": "SweepToTop", "variants": "Demo"})


@pytest.mark.parametrize("name", NAMES)
def test_scenes_of_some_intents_are_good_starts(name: str) -> None:
    for task in tasks_in(name)[:2]:
        spec = task_spec(f"intent:{task}")
        for variant in ("Demo", "Layout", "All"):
            assert accepts(task.intent, vary(spec, variant, 1)), (task, variant)


def test_they_have_names() -> None:
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
