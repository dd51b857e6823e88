"""Checks of results, and the commands of the leaderboard: whatever is tampered with is found and named."""

from __future__ import annotations

import json
import lzma
import re
from pathlib import Path

import pytest
from msgspec.structs import replace

import magical_mj
from magical_mj.evaluation.folder import SETTINGS
from magical_mj.evaluation.reports.tables import NONE
from magical_mj.evaluation.scores import SCORES
from magical_mj.leaderboard import read_entry, submit, verify
from magical_mj.leaderboard.entry import packed, unpacked
from magical_mj.protocol import PROTOCOL
from magical_mj.tasks.registry import ENVIRONMENTS
from magical_mj.utils.errors import EvaluationError, SettingsError
from tests.helpers.commands import Shell
from tests.helpers.entries import EPISODES, TAMPERED, Row, rewrite, swapped_scene, tampered_score, whole


def test_pages_of_others_are_kept(folder: Path, tmp_path: Path, shell: Shell) -> None:
    """And the command says so before it replays anything; pages of its own are replaced."""
    submit([folder], tmp_path / "entries" / "entry.json.xz")
    pages = tmp_path / "out" / "leaderboard"
    for _ in range(2):
        assert shell("leaderboard", "entries", "--jobs", 1)[0] == 0
    assert [path.name for path in (tmp_path / "entries").iterdir()] == ["entry.json.xz"], (
        "nothing else is written there"
    )
    for name in ("leaderboard.md", "leaderboard.html"):
        (pages / name).write_text("# Mine, on the leaderboard\n")
        error = shell.fails(1, "leaderboard", "entries")
        assert f"{name} is not a page of an earlier leaderboard: move it" in error
        assert (pages / name).read_text() == "# Mine, on the leaderboard\n"
    assert "cannot write into /dev/null/pages" in shell.fails(1, "leaderboard", "entries", "--out", "/dev/null/pages")


def test_a_sample_is_repeated_by_its_seed(folder: Path, tmp_path: Path, shell: Shell) -> None:
    rewrite(folder, lambda rows: [row.update(score=0.5) for row in rows])
    submit([folder], tmp_path / "entry.json.xz")
    code, out, error = shell("leaderboard", tmp_path, "--jobs", 1)
    (seed,) = re.findall(r"--seed (\d+) repeats this sample", out)
    assert "entry.json.xz differs: run 0, MoveToRegion Layout" in error
    assert shell("leaderboard", tmp_path, "--seed", seed, "--jobs", 1)[::2] == (code, error)
    assert "only without --all" in shell.fails(2, "leaderboard", tmp_path, "--all", "--seed", seed)


def test_the_commands_say_what_they_found(folder: Path, tmp_path: Path, shell: Shell) -> None:
    path = tmp_path / "entry.json.xz"
    code, out, _ = shell("submit", folder, "--out", path)
    assert code == 0
    assert f"expert: {EPISODES} episodes of 1 run," in out
    assert "the card lacks: description, authors, links, demonstrations.set, demonstrations.per_task" in out
    assert "a partial entry: 1 of 5 runs, 1 of 60 environments, 96 of 100 episodes missing in the " in out
    (tmp_path / "card.toml").write_text('method = "Mine"')
    options = ("--card", tmp_path / "card.toml", "--policy", "expert")
    assert shell("submit", folder, "--out", tmp_path / "two.json.xz", *options)[0] == 0
    entry = read_entry(tmp_path / "two.json.xz")
    assert (entry.method, entry.runs) == ("Mine", [0])
    rewrite(folder, tampered_score)
    code, out, error = shell("verify", folder, "--jobs", 1)
    assert code == 1
    assert f"{EPISODES} episodes replayed" in out
    assert f"{folder} differs: run 0, MoveToRegion Layout, seed 2: the score is 0.5" in error
    assert f"{folder} is incomplete: expert, run 0" in error


def test_a_leaderboard_names_bad_entries_and_shows_the_others(folder: Path, tmp_path: Path, shell: Shell) -> None:
    entries = tmp_path / "entries"
    assert "holds no entries" in shell.fails(1, "leaderboard", tmp_path)
    entries.mkdir()
    submit([folder], entries / "good.json.xz")
    assert (
        f"good.json.xz: expert; {EPISODES} episodes replayed" in shell("leaderboard", entries, "--all", "--jobs", 1)[1]
    )
    (entries / "twin.json.xz").write_bytes((entries / "good.json.xz").read_bytes())
    (entries / "cut.json.xz").write_bytes((entries / "good.json.xz").read_bytes()[:-20])
    (entries / "folder.json.xz").mkdir()
    (entries / "half.json.xz").write_bytes(lzma.compress(b'{"card": "\\ud800"}'))
    rewrite(folder, tampered_score)
    (tmp_path / "card.toml").write_text('method = "Liar"')
    submit([folder], entries / "lie.json.xz", card=tmp_path / "card.toml")
    code, _, error = shell("leaderboard", entries, "--all", "--jobs", 1, "--out", tmp_path / "pages")
    assert code == 1
    assert "twin.json.xz is not shown: good.json.xz has a method whose name reads the same" in error
    assert "cut.json.xz is cut short" in error
    assert "folder.json.xz is not a plain file" in error
    assert "half.json.xz is not an entry" in error
    assert "lie.json.xz differs: run 0, MoveToRegion Layout, seed 2: the score is 0.5" in error
    assert "entries that failed the checks and are not on the page: 5" in error
    text = (tmp_path / "pages" / "leaderboard.md").read_text()
    assert f"| expert | {NONE} | no observations |" in text
    assert "Liar" not in text


def test_names_have_no_hidden_characters(folder: Path, tmp_path: Path) -> None:
    """Neither a card nor an entry's file may name a method so that it looks like another line of a table."""
    entry = whole(runs=1)
    entry = replace(entry, episodes=entry.episodes[:1])
    for name in (" ", "a\u200b", "\u202eTSB", "a\u2028b", "BC ⭐", "BC\n", "BC (ST) ★", "BC (ST)†", "BC | 1.00", ""):
        (tmp_path / "card.toml").write_text(f"method = {json.dumps(name)}")
        with pytest.raises((SettingsError, EvaluationError), match="method"):
            submit([folder], tmp_path / "entry.json.xz", card=tmp_path / "card.toml")
        with pytest.raises(EvaluationError, match="method"):
            unpacked(packed(replace(entry, card=replace(entry.card, method=name))))


def test_an_honest_evaluation_replays_and_what_it_lacks_is_said(folder: Path) -> None:
    findings = verify(folder, jobs=1)
    assert (findings.episodes, findings.differing, findings.unfit, findings.good) == (EPISODES, [], [], False)
    assert "expert, run 0, MoveToRegion Demo: all of the 100 episodes are missing" in findings.missing
    assert "expert, run 0, MoveToRegion Layout: 96, such as seed 4, of the 100 episodes are missing" in findings.missing
    assert len(findings.missing) == sum(task == "MoveToRegion" for task, _ in ENVIRONMENTS)


def test_planned_episodes_that_were_not_played_are_reported(folder: Path) -> None:
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
    ({"steps": 39}, "steps: expert, run 0, MoveToRegion Layout, seed 2: 39 are recorded, but it has 40 actions"),
    ({"mujoco": "0.1"}, "mujoco: expert, run 0, MoveToRegion Layout, seed 2: it was played with '0.1', but run.json"),
    ({"preset": "State"}, "with 'State', but run.json contains 'LoRes4E'; and 1 more"),
    ({"run": 1}, "run: expert, run 1, MoveToRegion Layout, seed 2: run.json does not include it"),
    ({"policy": "noop"}, "run: noop, run 0, MoveToRegion Layout, seed 2: run.json does not include it"),
    ({"variant": "Colour", "scene": None}, "environment: expert, run 0, MoveToRegion Colour, seed 2: run.json does"),
]


def test_episodes_that_contradict_the_settings_are_named(folder: Path) -> None:
    episodes = (folder / SCORES).read_bytes()
    for change, problem in ALTERED:
        (folder / SCORES).write_bytes(episodes)
        rewrite(folder, lambda rows: [row.update(change) for row in rows[2:]])  # noqa: B023
        (sentence,) = verify(folder, jobs=1).unfit
        assert problem in sentence


def test_altered_episodes_are_named(folder: Path) -> None:
    episodes = (folder / SCORES).read_bytes()
    for change, problem in TAMPERED:
        (folder / SCORES).write_bytes(episodes)
        rewrite(folder, change)
        differing = verify(folder, jobs=1).differing
        assert len(differing) == (2 if change is swapped_scene else 1)
        assert differing[-1].startswith(f"run 0, MoveToRegion Layout, seed 2: {problem}")


def test_other_settings_are_named(folder: Path) -> None:
    settings = json.loads((folder / SETTINGS).read_text())
    for value in (99, [1]):
        for name in ("demonstrations", "rules"):
            (folder / SETTINGS).write_text(json.dumps({**settings, name: value}))
            (sentence,) = verify(folder, jobs=1).unfit
            assert sentence.startswith(f"{name}: {value} is recorded, but it must be ")
        (folder / SETTINGS).write_text(json.dumps({**settings, "protocol": value}))
        findings = verify(folder, jobs=1)
        problem = f"cannot be replayed: it follows protocol {value}, but this version plays {PROTOCOL}"
        assert findings.unfit == [f"{EPISODES} episodes {problem}"]
        assert findings.episodes == 0
    (folder / SETTINGS).write_text(json.dumps({**settings, "policies": [1]}))
    for _ in range(2):
        assert any(problem.startswith("protocol: nothing is recorded") for problem in verify(folder, jobs=1).unfit)
        (folder / SETTINGS).unlink(missing_ok=True)


def test_shards_are_verified_together(shell: Shell, tmp_path: Path) -> None:
    """They are complete together, as `report` and `submit` see them; what two of them hold must agree."""
    options = {"tasks": "MoveToRegion", "variants": "Demo", "preset": "State", "jobs": 1}
    magical_mj.evaluate("noop", out=tmp_path / "s0", episodes=60, **options)
    magical_mj.evaluate("noop", out=tmp_path / "s1", episodes=50, first_seed=50, **options)
    assert any("MoveToRegion Demo: 40, such as seed 60" in gap for gap in verify(tmp_path / "s0", jobs=1).missing)
    findings = verify(tmp_path / "s0", tmp_path / "s1", jobs=1)
    assert (findings.episodes, findings.differing, findings.unfit) == (100, [], [])
    assert not any("Demo" in gap for gap in findings.missing)
    submit([tmp_path / "s1"], tmp_path / "entry.json.xz")
    code, out, error = shell("verify", "s0", "entry.json.xz", "--jobs", 1)
    assert code == 1
    assert out.endswith("100 episodes replayed\n")
    assert "s0, entry.json.xz is incomplete: noop, run 0, MoveToRegion Jitter: all of the 100" in error
    assert "Demo" not in error
    rewrite(tmp_path / "s1", lambda rows: rows[0].update(score=0.5))
    (problem,) = verify(tmp_path / "s0", tmp_path / "s1", jobs=1).differing
    assert "seed 50: " in problem
    assert "s0 and " in problem
    assert "contain it with different results" in problem


def test_scenes_that_start_solved_are_named(shell: Shell, tmp_path: Path) -> None:
    options = {"tasks": "MakeLine", "variants": "All", "episodes": 1, "jobs": 1}
    for seed in (12, 13):
        magical_mj.evaluate("noop", out=tmp_path / str(seed), first_seed=seed, **options)
    assert not verify(tmp_path / "12", jobs=1).solved
    _, out, _ = shell("verify", tmp_path / "13", "--jobs", 1)
    assert out == "1 episode replayed\nthe scene starts with score 1 in MakeLine All, seed 13\n"


def test_rows_of_older_versions_have_no_scene(folder: Path) -> None:
    rewrite(folder, lambda rows: [row.pop("scene") for row in rows])
    assert verify(folder, jobs=1).differing == []
