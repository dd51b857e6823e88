"""The graded demonstrations: what is in them, and their exports."""

from __future__ import annotations

import lzma
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import magical_mj
from magical_mj.demos.shipped import FILES, stored_rows
from magical_mj.exports.folders import about
from magical_mj.tasks import KNOWN
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import DemonstrationError, SettingsError, UnknownNameError
from tests.helpers.commands import Shell

SETS = [(task, body) for task in KNOWN for body in (task_spec(task).bodies if task_spec(task).speeds else ("gripper",))]
FREE = {"MoveToRegion": 2, "FixColour": 2, "FindDupe": 3, "MakeLine": 3}
"""Tasks whose scores lie in so few quartiles."""


def test_there_are_25_of_each_task_over_the_quartiles_of_the_score_by_three_kinds() -> None:
    rows = stored_rows(FILES["graded"])
    assert sorted({(row.task, row.body) for row in rows}) == sorted(SETS)
    for task, body in SETS:
        own = [row for row in rows if (row.task, row.body) == (task, body)]
        scores = [row.score for row in own]
        assert len({(row.seed, row.actions) for row in own}) == 25
        assert scores == sorted(scores)
        quartiles = Counter(min(int(score * 4), 3) for score in scores)
        assert len(quartiles) == FREE.get(task, 4)
        assert max(quartiles.values()) <= 13
        kinds = Counter(row.demonstrator for row in own)
        assert kinds.keys() == {"stopped", "disturbed", "mistaken"}
        assert min(kinds.values()) >= 4
    assert FILES["graded"].stat().st_size < 200_000
    assert lzma.decompress(FILES["graded"].read_bytes()).startswith(b"[")


@pytest.mark.parametrize(
    ("task", "body"), [("MoveToRegion", "gripper"), ("MatchRegions", "gripper"), ("SweepToTop", "longstick")]
)
def test_they_are_played_again_to_their_scores(task: str, body: str) -> None:
    demos = magical_mj.demos.load(task, body=body, set="graded")
    rows = [row for row in stored_rows(FILES["graded"]) if (row.task, row.body) == (task, body)]
    for demo, row in zip(demos, rows, strict=True):
        assert demo.score == pytest.approx(row.score, abs=1e-4)
        assert demo.score == demo.rescored()
        assert len(demo.actions) == task_spec(task).horizon(body=body)
    assert magical_mj.demos.verify(demos[7]).exact


def test_they_are_shown_and_exported_like_others(shell: Shell) -> None:
    chosen = ("--tasks", "MoveToRegion", "--set", "graded")
    assert "mistaken" in shell("demos", "info", *chosen)[1]
    assert shell("demos", "export", *chosen, "--preset", "State", "--no-drop-noop")[0] == 0
    with np.load("MoveToRegion-Demo-graded-State.npz") as archive:
        assert len(archive["actions"]) == 25 * 40
        assert set(archive["scores"]) == {0.0, 1.0}
        assert set(archive["demonstrators"]) == {"stopped", "disturbed", "mistaken"}
    data = magical_mj.datasets.load("MoveToRegion", preset="State", set="graded")
    assert len(data["scores"]) == 25
    assert len([*Path("datasets").glob("MoveToRegion-Demo-graded-*-State.npz")]) == 1
    assert "leave out the files" in shell.fails(2, "demos", "info", "datasets", "--set", "graded")
    facts = about(magical_mj.demos.load("MoveToRegion", set="graded"))
    assert facts["demonstrators"] == ["disturbed", "mistaken", "stopped"]


def test_errors_of_load_list_the_sets_and_tasks() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown set of demonstrations 'grades'.* 1, 2, 'graded'"):
        magical_mj.demos.load("FindDupe", set="grades")  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match="leave out the folder"):
        magical_mj.demos.load("FindDupe", "folder", set="graded")
    with pytest.raises(
        DemonstrationError, match="no demonstrations of set graded of FindDupe with the body 'shortstick'"
    ):
        magical_mj.demos.load("FindDupe", body="shortstick", set="graded")
