"""Making entries: which folders and cards are taken, and how entries grow."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from magical_mj.evaluation.entry import entry_files
from magical_mj.evaluation.scores import SETTINGS
from magical_mj.leaderboard import read_entry, submit
from magical_mj.leaderboard.standings import standing
from magical_mj.utils.errors import EvaluationError, SettingsError, UnknownNameError
from tests.helpers.entries import EPISODES, rewrite

BAD: list[tuple[str, dict[str, Any], str]] = [
    ('colour = "red"', {}, "the card is not valid in .*card.toml: .*colour"),
    ("[training]\nhuors = 1", {}, "huors"),
    ("method =", {}, "cannot be read as TOML"),
    ("method = 2020-01-01", {}, "the card is not valid in .*card.toml.*method"),
    ('links = "https://example.org"', {}, "links"),
    ('training = "long"', {}, "training"),
    ("[training]\nhours = nan", {}, "hours"),
    ("", {"folders": []}, "give at least one folder"),
    ("", {"folders": "scores"}, "give a list of folders"),
    ("", {"policy": "nobody"}, "unknown policy 'nobody'"),
    ("", {"out": "entry.json"}, "must end in .json.xz"),
]


def test_bad_submissions_are_explained(folder: Path, tmp_path: Path) -> None:
    defaults = {"folders": [folder], "out": tmp_path / "entry.json.xz", "card": tmp_path / "card.toml"}
    for card, arguments, problem in BAD:
        (tmp_path / "card.toml").write_text(card)
        with pytest.raises((SettingsError, UnknownNameError), match=problem):
            submit(**{**defaults, **arguments})


def test_a_protocol_that_is_no_number_is_explained(folder: Path, tmp_path: Path) -> None:
    settings = json.loads((folder / SETTINGS).read_text())
    for number in ([1], "1", True, 0):
        (folder / SETTINGS).write_text(json.dumps({**settings, "protocol": number}))
        with pytest.raises(EvaluationError, match=r"the choice of folders is no entry: .*protocol"):
            submit([folder], tmp_path / "entry.json.xz")
    assert not list(tmp_path.glob("entry*"))


def test_what_is_no_evaluation_of_one_method_is_explained(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match=r"holds an episode twice: .* again with another --run"):
        submit([folder, folder], tmp_path / "entry.json.xz")
    training = tmp_path / "training"
    training.mkdir()
    (training / "policy.safetensors").touch()
    with pytest.raises(EvaluationError, match=r"holds a policy: .* --policy .*training --out ANOTHER"):
        submit([training], tmp_path / "entry.json.xz")
    rewrite(folder, lambda rows: rows[0].update(preset="LoRes4E"))
    with pytest.raises(EvaluationError, match="different preset"):
        submit([folder], tmp_path / "entry.json.xz")
    rewrite(folder, lambda rows: rows[0].update(preset=None, task="PushOut"))
    with pytest.raises(EvaluationError, match="PushOut"):
        submit([folder], tmp_path / "entry.json.xz")
    rewrite(folder, lambda rows: rows[0].update(policy="bc-1"))
    with pytest.raises(SettingsError, match=r"bc-1, expert: .*\(--policy NAME\).*--policy BC=runs/a,BC=runs/b"):
        submit([folder], tmp_path / "entry.json.xz")
    rewrite(folder, lambda rows: [row.update(shift="mine:Fog:3") for row in rows])
    with pytest.raises(EvaluationError, match="all episodes are shifted"):
        submit([folder], tmp_path / "entry.json.xz")
    assert not (tmp_path / "entry.json.xz").exists()


def test_one_training_is_one_run(folder: Path, tmp_path: Path) -> None:
    """The file of a policy, evaluated twice, is recorded with the same hash."""
    settings = json.loads((folder / SETTINGS).read_text())
    settings["policies"] = [{"name": "expert", "run": run, "origin": "a", "sha256": "c0ffee"} for run in (0, 1)]
    (folder / SETTINGS).write_text(json.dumps(settings))
    with pytest.raises(EvaluationError, match=r"the runs 0, 1 of expert played with equal policies \(sha256 c0ffee"):
        submit([folder], tmp_path / "entry.json.xz")


def test_files_of_an_entry_are_of_one_kind(folder: Path, tmp_path: Path) -> None:
    submit((path for path in [folder]), tmp_path / "mine" / "0.json.xz")
    (tmp_path / "mine" / "card.toml").write_text('method = "Mine"\n')
    for name, value in (("rules", "released"), ("preset", "LoRes4A")):
        rewrite(folder, lambda rows: [row.update({"run": 1, name: value}) for row in rows])  # noqa: B023
        submit([folder], tmp_path / "mine" / "1.json.xz")
        with pytest.raises(EvaluationError, match=f"different .*, {value} in .*an entry is of one kind"):
            read_entry(tmp_path / "mine")
        (tmp_path / "mine" / "1.json.xz").unlink()
        rewrite(folder, lambda rows: [row.update({"run": 1, "rules": "paper"}) for row in rows])


def test_a_run_is_added_as_a_file(folder: Path, tmp_path: Path) -> None:
    """A folder's card counts, its files are read together, and no episode stands in two of them."""
    submit([folder], tmp_path / "mine" / "0.json.xz")
    (tmp_path / "mine" / "card.toml").write_text('method = "Mine"\nprivileges = ["simulator at test"]\n')
    rewrite(folder, lambda rows: [row.update(run=1) for row in rows])
    submit([folder], tmp_path / "mine" / "1.json.xz")
    assert entry_files(tmp_path) == entry_files(tmp_path / "mine") == [tmp_path / "mine"]
    entry = read_entry(tmp_path / "mine")
    assert (entry.method, entry.runs, len(entry.episodes)) == ("Mine", [0, 1], 2 * EPISODES)
    assert (standing(entry).block, standing(read_entry(tmp_path / "mine" / "0.json.xz")).block) == (
        "simulator",
        "undeclared",
    )
    (tmp_path / "mine" / "2.json.xz").write_bytes((tmp_path / "mine" / "1.json.xz").read_bytes())
    with pytest.raises(EvaluationError, match=r"2\.json\.xz holds episodes that another file"):
        read_entry(tmp_path / "mine")
    (tmp_path / "mine" / "card.toml").write_text('method = "Mine"\nprivileges = ["magic"]\n')
    with pytest.raises(EvaluationError, match=r"card\.toml is no card: .*magic"):
        read_entry(tmp_path / "mine")


def test_our_entries_declare_their_privileges() -> None:
    results = Path(__file__).parents[2] / "results"
    cards = [tomllib.loads(path.read_text()) for path in results.glob("*/card.toml")]
    assert len(cards) == len(entry_files(results)) > 20
    assert all("privileges" in card for card in cards)
