"""Results that check themselves: whatever is tampered with is found, and named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from magical_mj.evaluation.scores import SETTINGS
from magical_mj.leaderboard import verify
from magical_mj.tasks.registry import ENVIRONMENTS
from tests.helpers.entries import EPISODES, TAMPERED, Row, rewrite, swapped_scene


def test_an_honest_evaluation_replays(folder: Path) -> None:
    found = verify(folder)
    assert found.episodes == EPISODES
    assert (found.differing, found.unfit) == ([], [])


def test_what_the_protocol_asks_for_and_is_not_there_is_said(folder: Path) -> None:
    found = verify(folder)
    assert "expert, run 0, MoveToRegion Demo: all of the 100 episodes are missing" in found.missing
    assert "expert, run 0, MoveToRegion Layout: 96, such as seed 4, of the 100 episodes are missing" in found.missing
    assert len(found.missing) == sum(task == "MoveToRegion" for task, _ in ENVIRONMENTS)
    assert not found.good


@pytest.mark.parametrize("gone", ["policies", "environments"])
def test_what_was_to_be_played_and_was_not_is_said(folder: Path, gone: str) -> None:
    """A policy, or a task, whose turn a killed evaluation has never reached."""
    settings = json.loads((folder / SETTINGS).read_text())
    added = {"policies": {"name": "noop", "run": 1, "origin": "noop"}, "environments": "FixColour-Demo"}
    (folder / SETTINGS).write_text(json.dumps({**settings, gone: [*settings[gone], added[gone]]}))
    found = verify(folder)
    expected = {
        "policies": "noop, run 1, MoveToRegion Layout: all",
        "environments": "expert, run 0, FixColour Demo: all",
    }
    assert any(problem.startswith(expected[gone]) for problem in found.missing)
    assert found.unfit == []


ALTERED: list[tuple[Row, str]] = [
    ({"steps": 39}, "steps: expert, run 0, MoveToRegion Layout, seed 2: it says 39, and holds 40 actions"),
    ({"mujoco": "0.1"}, "mujoco: expert, run 0, MoveToRegion Layout, seed 2: it was played with '0.1', and run.json"),
    ({"version": "9"}, "version: expert, run 0, MoveToRegion Layout, seed 2: it was played with '9', and run.json"),
    ({"preset": "State"}, "with 'State', and run.json says 'LoRes4E'; and 1 more"),
    ({"run": 1}, "run: expert, run 1, MoveToRegion Layout, seed 2: run.json does not name it"),
    ({"policy": "noop"}, "run: noop, run 0, MoveToRegion Layout, seed 2: run.json does not name it"),
    ({"variant": "Colour", "scene": None}, "environment: expert, run 0, MoveToRegion Colour, seed 2: run.json does"),
]


@pytest.mark.parametrize(("change", "problem"), ALTERED)
def test_episodes_that_contradict_the_settings_are_named(folder: Path, change: Row, problem: str) -> None:
    rewrite(folder, lambda rows: [row.update(change) for row in rows[2:]])
    (found,) = verify(folder).unfit
    assert problem in found


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
