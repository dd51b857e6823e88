"""Results that check themselves: whatever is tampered with is found, and named."""

from __future__ import annotations

import json
from pathlib import Path

from magical_mj.evaluation.scores import SCORES, SETTINGS
from magical_mj.leaderboard import verify
from magical_mj.tasks.registry import ENVIRONMENTS
from tests.helpers.entries import EPISODES, TAMPERED, Row, rewrite, swapped_scene


def test_an_honest_evaluation_replays_and_what_it_lacks_is_said(folder: Path) -> None:
    findings = verify(folder)
    assert (findings.episodes, findings.differing, findings.unfit, findings.good) == (EPISODES, [], [], False)
    assert "expert, run 0, MoveToRegion Demo: all of the 100 episodes are missing" in findings.missing
    assert "expert, run 0, MoveToRegion Layout: 96, such as seed 4, of the 100 episodes are missing" in findings.missing
    assert len(findings.missing) == sum(task == "MoveToRegion" for task, _ in ENVIRONMENTS)


def test_what_was_to_be_played_and_was_not_is_said(folder: Path) -> None:
    """A policy, or a task, whose turn a killed evaluation has never reached."""
    settings = json.loads((folder / SETTINGS).read_text())
    settings["policies"].append({"name": "noop", "run": 1, "origin": "noop"})
    settings["environments"].append("FixColour-Demo")
    (folder / SETTINGS).write_text(json.dumps(settings))
    findings = verify(folder, jobs=1)
    for beginning in ("noop, run 1, MoveToRegion Layout: all", "expert, run 0, FixColour Demo: all"):
        assert any(problem.startswith(beginning) for problem in findings.missing)
    assert findings.unfit == []


ALTERED: list[tuple[Row, str]] = [
    ({"steps": 39}, "steps: expert, run 0, MoveToRegion Layout, seed 2: it says 39, and holds 40 actions"),
    ({"mujoco": "0.1"}, "mujoco: expert, run 0, MoveToRegion Layout, seed 2: it was played with '0.1', and run.json"),
    ({"preset": "State"}, "with 'State', and run.json says 'LoRes4E'; and 1 more"),
    ({"run": 1}, "run: expert, run 1, MoveToRegion Layout, seed 2: run.json does not name it"),
    ({"policy": "noop"}, "run: noop, run 0, MoveToRegion Layout, seed 2: run.json does not name it"),
    ({"variant": "Colour", "scene": None}, "environment: expert, run 0, MoveToRegion Colour, seed 2: run.json does"),
]


def test_episodes_that_contradict_the_settings_are_named(folder: Path) -> None:
    episodes = (folder / SCORES).read_bytes()
    for change, problem in ALTERED:
        (folder / SCORES).write_bytes(episodes)
        rewrite(folder, lambda rows: [row.update(change) for row in rows[2:]])  # noqa: B023
        (sentence,) = verify(folder, jobs=1).unfit
        assert problem in sentence


def test_what_was_tampered_with_is_named(folder: Path) -> None:
    episodes = (folder / SCORES).read_bytes()
    for change, problem in TAMPERED:
        (folder / SCORES).write_bytes(episodes)
        rewrite(folder, change)
        differing = verify(folder, jobs=1).differing
        assert len(differing) == (2 if change is swapped_scene else 1)
        assert differing[-1].startswith(f"run 0, MoveToRegion Layout, seed 2: {problem}")


def test_other_settings_are_named(folder: Path) -> None:
    settings = json.loads((folder / SETTINGS).read_text())
    for name in ("protocol", "demonstrations", "rules"):
        for value in (99, [1]):
            (folder / SETTINGS).write_text(json.dumps({**settings, name: value}))
            (sentence,) = verify(folder, jobs=1).unfit
            assert sentence.startswith(f"{name}: {value} is recorded, and it must be ")
    (folder / SETTINGS).write_text(json.dumps({**settings, "policies": [1]}))
    assert "protocol: nothing is recorded" in verify(folder, jobs=1).unfit[0]
    (folder / SETTINGS).unlink()
    assert "protocol: nothing is recorded" in verify(folder, jobs=1).unfit[0]


def test_rows_of_older_versions_have_no_scene(folder: Path) -> None:
    rewrite(folder, lambda rows: [row.pop("scene") for row in rows])
    assert verify(folder).differing == []
