"""The shipped demonstrations are those of the tools that made them."""

from __future__ import annotations

import numpy as np

import magical_mj
from magical_mj.demos.shipped import FILES, stored_rows
from magical_mj.policies.interface import actions_of
from tools.diverse_demonstrations import MATCHED, PEOPLE, demonstration
from tools.graded_demonstrations import mistaken, still
from tools.research.demonstration_statistics import STATISTICS


def test_graded_ones_that_stop_begin_as_shipped_ones_and_mistaken_ones_are_made_again() -> None:
    shipped = [still(demo, 40) for demo in magical_mj.demos.load("MoveToRegion")]
    graded = magical_mj.demos.load("MoveToRegion", set="graded")
    for demo in graded:
        if demo.demonstrator == "stopped":
            acting = int(np.flatnonzero(demo.acts)[-1]) + 1
            assert any(np.array_equal(demo.actions[:acting], actions[:acting]) for actions in shipped)
    made = mistaken("MoveToRegion", 0, 40)
    assert any(np.array_equal(demo.actions, made) for demo in graded if demo.demonstrator == "mistaken")


def test_set_2_is_more_varied_than_set_1_and_nearer_to_people() -> None:
    task = "MatchRegions"
    by_set = {number: magical_mj.demos.load(task, set=number) for number in (1, 2)}
    variety = {number: magical_mj.demos.diversity(demos) for number, demos in by_set.items()}
    assert variety[2].orders > variety[1].orders
    assert variety[2].strategies > variety[1].strategies
    assert variety[2].ways > 1.5 * variety[1].ways
    wanted = dict(zip(MATCHED, PEOPLE[task], strict=True))
    for name in ("cells visited", "length of the robot's path"):
        gaps_to_people = {number: abs(STATISTICS[name](demos) - wanted[name]) for number, demos in by_set.items()}
        assert gaps_to_people[2] < gaps_to_people[1]


def test_set_2_is_that_of_the_command() -> None:
    row = next(row for row in stored_rows(FILES[2]) if row.task == "MoveToRegion")
    again = demonstration("MoveToRegion", row.seed)
    assert again is not None
    np.testing.assert_array_equal(again.actions, list(actions_of(row.actions)))
