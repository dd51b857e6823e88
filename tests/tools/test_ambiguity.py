"""How ambiguous demonstrations are: the measures, and what docs/rivals.md says about them."""

from __future__ import annotations

import numpy as np
import pytest

from magical_mj.intents import EIGHT, parse, rivals
from magical_mj.intents.attribution import BITS
from magical_mj.intents.plans import planned
from magical_mj.intents.tasks import task_of
from tools.ambiguity import (
    KINDS,
    SCENES,
    Case,
    by_picture,
    by_sentence,
    case_of,
    curve,
    eight,
    left,
    nothing,
)
from tools.tables import ROOT

pytestmark = pytest.mark.xdist_group("ambiguity")  # measured with the same lists of intents

PAGE = (ROOT / "docs" / "rivals.md").read_text("utf-8")


def rows_of(name: str) -> dict[str, list[str]]:
    """The rows of a generated table, by their first cells."""
    body = PAGE.partition(f"<!-- {name}: written by python -m tools.ambiguity -->")[2].partition("<!--")[0]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in body.strip().splitlines()]
    return {first: rest for first, *rest in cells[2:]}


def test_missing_bits_are_the_weight_of_what_is_possible_relative_to_the_true_intent() -> None:
    true, same, longer = parse("robot wall(left)"), parse("robot wall(top)"), parse("wall(all, left)")
    case = Case(true, ())
    assert left(case, [true]) == (0, 0.0)
    assert left(case, [true, same]) == (1, 1.0)
    assert left(case, [same, longer]).bits == pytest.approx(np.log2(2 + 2.0 ** (true.bits - longer.bits)))
    assert nothing(case).bits < true.bits  # the weights of all intents sum to less than 1


def test_more_scenes_leave_fewer_rivals_and_the_sentence_none() -> None:
    case = case_of(task_of("near(shape=star, to=blue)"))
    counts = {kind: [found.rivals for found in curve(case, kind)] for kind in KINDS}
    for kind in KINDS:
        assert len(counts[kind]) == SCENES
        assert counts[kind] == sorted(counts[kind], reverse=True)
    assert counts["contrasting"][1] <= counts["random"][1]
    assert by_sentence(case) == (0, 0.0)
    assert by_picture(case).rivals >= counts["random"][0]
    assert by_picture(case).bits <= nothing(case).bits


def test_the_page_names_the_tasks_whose_own_intents_are_longer_than_all_rivals() -> None:
    longer = [task for task, intent in EIGHT.items() if intent.bits > BITS]
    assert "In {}, {} and {} it has more than 24, so all count".format(*longer) in " ".join(PAGE.split())
    assert BITS == 24


def test_a_weaker_intent_is_left_by_every_scene() -> None:
    """Unless it holds at the start, so that the demonstration does not reach it."""
    case = Case(EIGHT["MatchRegions"], eight()["MatchRegions"].first)
    weaker = parse("in(colour=region, region)")
    assert weaker in rivals([*case.first, planned(case.intent, case.first[0][0])])


def test_the_page_says_what_scenes_and_sentences_leave() -> None:
    known = rows_of("known")
    assert "many bits are missing even after eight contrasting scenes" in " ".join(PAGE.split())
    contrasting, random = known["in 8 scenes: contrasting"], known["in 8 scenes: random colours and poses"]
    assert 20 < float(contrasting[3]) < float(random[3])
    assert known["one scene and the sentence"] == ["0", "0.0", "0", "0.0"]
