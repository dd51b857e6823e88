"""The commands of the leaderboard: what they say of entries, good and bad, and whose pages they keep."""

from __future__ import annotations

import json
import lzma
import re
from pathlib import Path

import pytest
from msgspec.structs import replace

from magical_mj.cli import main
from magical_mj.evaluation.entry import packed, unpacked
from magical_mj.leaderboard import read_entry, submit
from magical_mj.utils.errors import EvaluationError, SettingsError
from tests.helpers.entries import EPISODES, rewrite, tampered_score, whole


def test_pages_of_others_are_kept(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And the command says so before it replays anything; pages of its own are replaced."""
    submit([folder], tmp_path / "entry.json.xz")
    for _ in range(2):
        assert main(["leaderboard", str(tmp_path)]) == 0
    for name in ("leaderboard.md", "leaderboard.html"):
        (tmp_path / name).write_text("# Mine, on the leaderboard\n")
        capsys.readouterr()
        assert main(["leaderboard", str(tmp_path)]) == 1
        out, error = capsys.readouterr()
        assert (out, f"{name} is not a page of an earlier leaderboard: move it" in error) == ("", True)
        assert (tmp_path / name).read_text() == "# Mine, on the leaderboard\n"
    assert main(["leaderboard", str(tmp_path), "--out", "/dev/null/pages"]) == 1
    out, error = capsys.readouterr()
    assert (out, "cannot write into /dev/null/pages" in error) == ("", True)


def test_a_sample_is_repeated_by_its_seed(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rewrite(folder, lambda rows: [row.update(score=0.5) for row in rows])
    submit([folder], tmp_path / "entry.json.xz")
    assert main(["leaderboard", str(tmp_path)]) == 1
    out, error = capsys.readouterr()
    (seed,) = re.findall(r"--seed (\d+) chooses the same again", out)
    assert "entry.json.xz differs: run 0, MoveToRegion Layout" in error
    assert main(["leaderboard", str(tmp_path), "--seed", seed]) == 1
    assert capsys.readouterr().err == error
    assert main(["leaderboard", str(tmp_path), "--all", "--seed", seed]) == 2
    assert "--seed has an effect only without --all" in capsys.readouterr().err


def test_the_commands_say_what_they_found(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "entry.json.xz"
    assert main(["submit", str(folder), "--out", str(path)]) == 0
    out = capsys.readouterr().out
    assert f"expert: {EPISODES} episodes of 1 run," in out
    assert "the card does not say: description, authors, links, demonstrations.set, demonstrations.per_task" in out
    assert "a partial entry: 1 of 5 runs, 1 of 60 environments, 96 of 100 episodes missing in the " in out
    (tmp_path / "card.toml").write_text('method = "Mine"')
    options = ["--card", str(tmp_path / "card.toml"), "--policy", "expert"]
    assert main(["submit", str(folder), "--out", str(tmp_path / "two.json.xz"), *options]) == 0
    entry = read_entry(tmp_path / "two.json.xz")
    assert (entry.method, entry.runs) == ("Mine", [0])
    rewrite(folder, tampered_score)
    capsys.readouterr()
    assert main(["verify", str(folder)]) == 1
    out, error = capsys.readouterr()
    assert f"{EPISODES} episodes replayed" in out
    assert f"{folder} differs: run 0, MoveToRegion Layout, seed 2: the score is 0.5" in error
    assert f"{folder} is incomplete: expert, run 0" in error


def test_a_leaderboard_names_bad_entries_and_shows_the_others(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entries = tmp_path / "entries"
    assert main(["leaderboard", str(tmp_path)]) == 1
    assert "holds no entries" in capsys.readouterr().err
    entries.mkdir()
    submit([folder], entries / "good.json.xz")
    assert main(["leaderboard", str(entries), "--all"]) == 0
    assert f"good.json.xz: expert; {EPISODES} episodes replayed" in capsys.readouterr().out
    (entries / "twin.json.xz").write_bytes((entries / "good.json.xz").read_bytes())
    (entries / "cut.json.xz").write_bytes((entries / "good.json.xz").read_bytes()[:-20])
    (entries / "folder.json.xz").mkdir()
    (entries / "half.json.xz").write_bytes(lzma.compress(b'{"card": "\\ud800"}'))
    rewrite(folder, tampered_score)
    (tmp_path / "card.toml").write_text('method = "Liar"')
    submit([folder], entries / "lie.json.xz", card=tmp_path / "card.toml")
    assert main(["leaderboard", str(entries), "--all", "--out", str(tmp_path / "pages")]) == 1
    error = capsys.readouterr().err
    assert "twin.json.xz is not shown: it has the name of the method in good.json.xz" in error
    assert "cut.json.xz is cut short" in error
    assert "folder.json.xz is not a plain file" in error
    assert "half.json.xz is no entry" in error
    assert "lie.json.xz differs: run 0, MoveToRegion Layout, seed 2: the score is 0.5" in error
    assert "entries that are not what they claim, and are not on the page: 5" in error
    text = (tmp_path / "pages" / "leaderboard.md").read_text()
    assert "| expert | paper | no observations |" in text
    assert "Liar" not in text


def test_names_are_what_they_look_like(folder: Path, tmp_path: Path) -> None:
    """Neither a card nor an entry's file may name a method so that it looks like another line of a table."""
    entry = whole(runs=1)
    entry = replace(entry, episodes=entry.episodes[:1])
    for name in (" ", "a\u200b", "\u202eTSB", "a\u2028b", "BC ⭐", "BC\n", "BC (ST) ★", "BC (ST)†", "BC | 1.00", ""):
        (tmp_path / "card.toml").write_text(f"method = {json.dumps(name)}")
        with pytest.raises((SettingsError, EvaluationError), match="method"):
            submit([folder], tmp_path / "entry.json.xz", card=tmp_path / "card.toml")
        with pytest.raises(EvaluationError, match="method"):
            unpacked(packed(replace(entry, card=replace(entry.card, method=name))))
