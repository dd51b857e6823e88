"""The files of `tools.test_scenes` follow from the scenes and from replays of the stored episodes."""

from __future__ import annotations

from itertools import islice

import pytest

from magical_mj.evaluation.reports.floors import refuting_seeds
from magical_mj.leaderboard.entry import read_entry
from tools.test_scenes import RESULTS, first_blocks, is_refuted, moved_first

ENTRIES = sorted({row["entry"] for row in first_blocks()})


def test_scenes_refute_the_shortcut() -> None:
    for pair in (("FixColour", "Colour"), ("MoveToRegion", "Layout")):
        assert refuting_seeds()[pair] == {seed for seed in range(100) if is_refuted(*pair, seed)}
    assert not any(is_refuted(task, "All", seed) for task in ("MoveToCorner", "MakeLine") for seed in range(10))


@pytest.mark.parametrize(
    ("name", "rows"), [("replay", 1), *(pytest.param(name, None, marks=pytest.mark.weekly) for name in ENTRIES)]
)
def test_the_first_blocks_are_those_of_a_replay(name: str, rows: int | None) -> None:
    """The first row, or each week all rows of all entries."""
    known = [tuple(row.values()) for row in first_blocks() if row["entry"] == name]
    found = islice(moved_first(read_entry(RESULTS / name)), rows)
    assert known[:rows] == [(name, *row) for row in found]
