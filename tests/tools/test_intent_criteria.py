"""The criteria by which the sets of intents were searched."""

from __future__ import annotations

import msgspec

from magical_mj.intents.draws import in_sets
from tools.intent_criteria import problem, unmatched


def test_members_are_those_that_a_search_finds() -> None:
    """One of selector: no shortcut solves it in a tenth of 40 scenes, and no training intent means the same."""
    selector, train = (next(one for one in in_sets() if one.set == name) for name in ("selector", "train"))
    assert not problem(selector)
    assert not problem(train)
    assert "a search finds" in problem(msgspec.structs.replace(train, steps=train.steps + 10))


def test_matched_sets_are_matched() -> None:
    assert not unmatched()
