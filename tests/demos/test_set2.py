"""Set 2 of the demonstrations: what is in it, and how trainings, evaluations and entries record it."""

from __future__ import annotations

import hashlib
import json
import lzma
import tomllib
from pathlib import Path

import numpy as np
import pytest

import magical_mj
from magical_mj.demos.shipped import FILES, SETS, stored_rows
from magical_mj.evaluation import evaluate
from magical_mj.leaderboard import submit, verify
from magical_mj.leaderboard.entry import Demonstrations, read_entry
from magical_mj.leaderboard.standings import gaps
from magical_mj.learners import clone, train
from magical_mj.learners.data import chosen
from magical_mj.learners.policy import load_policy
from magical_mj.utils.errors import DemonstrationError, SettingsError, UnknownNameError
from tests.helpers.commands import Shell
from tests.helpers.learners import from_states


def test_there_are_25_different_ones_of_each_task_with_score_1_in_a_small_file() -> None:
    rows = stored_rows(FILES[2])
    assert {row.task for row in rows} == set(magical_mj.TASKS)
    for task in magical_mj.TASKS:
        own = [row for row in rows if row.task == task]
        assert len({row.actions for row in own}) == len(own) == 25
        assert {(row.variant, row.body, row.demonstrator, row.score) for row in own} == {
            ("Demo", "gripper", "diverse", 1.0)
        }
    content = hashlib.sha256(lzma.decompress(FILES[2].read_bytes())).hexdigest()
    assert content.startswith("c7d6c9e1123d5322"), (
        "policies that learnt from it no longer compare: give it a new number"
    )


def test_they_are_played_again_exactly() -> None:
    demos = magical_mj.demos.load("MoveToRegion", set=2)
    assert {demo.score for demo in demos} == {1.0}
    assert magical_mj.demos.verify(demos[3]).exact


def test_the_default_is_set_1_and_what_is_not_there_says_what_is() -> None:
    one, default = magical_mj.demos.load("FixColour", set=1), magical_mj.demos.load("FixColour")
    assert [demo.digest for demo in one] == [demo.digest for demo in default]
    assert SETS == (1, 2, "graded")
    with pytest.raises(UnknownNameError, match=r"unknown set of demonstrations 3.* 1, 2, 'graded'"):
        magical_mj.demos.load("FindDupe", set=3)  # type: ignore[arg-type]
    for other in ("2", True, 2.0, np.array([1, 2]), np.array(2)):
        with pytest.raises(UnknownNameError, match=r"There are: 1, 2, 'graded'"):
            magical_mj.demos.load("FindDupe", set=other)  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match="set 2 come with the package: leave out the folder"):
        magical_mj.demos.load("FindDupe", "folder", set=2)
    with pytest.raises(
        DemonstrationError, match=r"no demonstrations of set 2 of SweepToTop .* there are 25 of each of"
    ):
        magical_mj.demos.load("SweepToTop", set=2)


def test_they_are_shown_and_exported(shell: Shell) -> None:
    names = ("--tasks", "MoveToRegion", "--set", "2")
    assert "diverse" in shell("demos", "info", *names)[1]
    assert shell("demos", "export", *names, "--preset", "State")[0] == 0
    with np.load("MoveToRegion-Demo-set2-State.npz") as archive:
        assert set(archive["demonstrators"]) == {"diverse"}
    assert "leave out the files" in shell.fails(2, "demos", "info", "datasets", "--set", "2")


def test_cloning_them_needs_the_set_in_the_settings() -> None:
    given = {"MoveToRegion": magical_mj.demos.load("MoveToRegion", set=2)[:2]}
    with pytest.raises(DemonstrationError, match=r"MoveToRegion are of set 2: give settings with demos\.set=2"):
        clone(from_states(), given)
    assert clone(from_states(**{"demos.set": 2}), given).learnt.demonstration_set == 2


def test_trainings_evaluations_and_entries_record_the_set(tmp_path: Path) -> None:
    settings = from_states(**{"demos.set": 2})
    seeds = {row.seed for row in stored_rows(FILES[2]) if row.task == "MoveToRegion"}
    assert {demo.scene_seed for demo in chosen(settings, "MoveToRegion")} <= seeds
    trained = train(settings, tmp_path / "run")
    assert tomllib.loads((tmp_path / "run" / "config.toml").read_text())["demos"] == {"set": 2}
    with pytest.raises(SettingsError, match=r"demos\.set was 2 and is 1"):
        train(from_states(), tmp_path / "run", resume=True)
    where = {"tasks": "MoveToRegion", "variants": "Demo", "episodes": 2, "jobs": 1}
    evaluate({"BC": tmp_path / "run"}, out=tmp_path / "scores", **where)
    assert json.loads((tmp_path / "scores" / "run.json").read_text())["policies"][0]["demonstration_set"] == 2
    for number, policy in enumerate([trained, load_policy(tmp_path / "run")]):
        evaluate({"BC": policy}, out=tmp_path / f"other{number}", **where)
        recorded = json.loads((tmp_path / f"other{number}" / "run.json").read_text())["policies"][0]
        assert recorded["demonstration_set"] == 2
    assert any("BC learnt from demonstrations of set 2" in text for text in verify(tmp_path / "scores", jobs=1).unfit)
    (tmp_path / "card.toml").write_text("privileges = []\n[demonstrations]\nset = 2\n")
    with pytest.raises(SettingsError, match=r"learnt from demonstrations of set 2, but the card has .*loaded_set = 1"):
        submit([tmp_path / "scores"], tmp_path / "bc.json.xz", card=tmp_path / "card.toml")
    (tmp_path / "card.toml").write_text("privileges = []\n[demonstrations]\nset = 2\nloaded_set = 2\n")
    submit([tmp_path / "scores"], tmp_path / "bc.json.xz", card=tmp_path / "card.toml")
    entry = read_entry(tmp_path / "bc.json.xz")
    assert entry.card.demonstrations == Demonstrations(set=2, loaded_set=2)
    assert "it learnt from demonstrations of set 2, and protocol 1 uses set 1" in gaps(entry)


def test_a_card_can_declare_the_set_of_a_policy_of_which_it_is_unknown(tmp_path: Path) -> None:
    evaluate({"Mine": "noop"}, out=tmp_path / "scores", tasks="MoveToRegion", variants="Demo", episodes=1, jobs=1)
    card = tmp_path / "card.toml"
    card.write_text('method = "Mine"\n[demonstrations]\nset = 2\nloaded_set = 2\n')
    submit([tmp_path / "scores"], tmp_path / "mine.json.xz", card=card)
    entry = read_entry(tmp_path / "mine.json.xz")
    assert "it learnt from demonstrations of set 2, and protocol 1 uses set 1" in gaps(entry)


def test_the_setting_is_checked() -> None:
    with pytest.raises(SettingsError, match=r"demos\.set must be an integer of at most 2"):
        from_states(**{"demos.set": 3})
    with pytest.raises(SettingsError, match=r"demos\.set is for the package's demonstrations"):
        from_states(recordings="mine", **{"demos.set": 2})
