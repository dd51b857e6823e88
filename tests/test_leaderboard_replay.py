"""Results that check themselves: whatever is tampered with is found, and named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from entries import EPISODES, TAMPERED, Row, rewrite, swapped_scene

from magical_mj.evaluation.scores import SETTINGS
from magical_mj.leaderboard import verify
from magical_mj.registry import ENVIRONMENTS, task_spec


def test_an_honest_evaluation_replays(folder: Path) -> None:
    found = verify(folder)
    assert (found.episodes, found.steps) == (EPISODES, EPISODES * task_spec("MoveToRegion").horizon())
    assert (found.differing, found.unfit) == ([], [])


def test_what_the_protocol_asks_for_and_is_not_there_is_said(folder: Path) -> None:
    found = verify(folder)
    assert "expert, run 0, MoveToRegion Demo: all of the 100 episodes are missing" in found.missing
    assert "expert, run 0, MoveToRegion Layout: 96, such as seed 4, of the 100 episodes are missing" in found.missing
    assert len(found.missing) == sum(task == "MoveToRegion" for task, _ in ENVIRONMENTS)
    assert not found.good


@pytest.mark.parametrize(("change", "problem"), TAMPERED)
def test_what_was_tampered_with_is_named(folder: Path, change: Callable[[list[Row]], None], problem: str) -> None:
    rewrite(folder, change)
    found = verify(folder)
    assert len(found.differing) == (2 if change is swapped_scene else 1)
    assert found.differing[-1].startswith(f"run 0, MoveToRegion Layout, seed 2: {problem}")


@pytest.mark.parametrize("what", ["protocol", "demonstrations", "rules"])
def test_other_settings_are_named(folder: Path, what: str) -> None:
    settings = json.loads((folder / SETTINGS).read_text())
    (folder / SETTINGS).write_text(json.dumps({**settings, what: 99}))
    assert [problem.partition(":")[0] for problem in verify(folder).unfit] == [what]
    (folder / SETTINGS).unlink()
    assert f"{what}: nothing is recorded" in "; ".join(verify(folder).unfit)


def test_rows_of_older_versions_have_no_scene(folder: Path) -> None:
    rewrite(folder, lambda rows: [row.pop("scene") for row in rows])
    assert verify(folder).differing == []
