"""`magical-mj evaluate`, `report` and `compare`: their output and files, and one line for each error."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from magical_mj.evaluation.scores import SCORES, read
from tests.helpers.commands import Shell

SMALL = ("--tasks", "MoveToRegion", "--variants", "Demo,Layout", "--episodes", "2", "--jobs", "1")


def test_from_scores_to_a_comparison(shell: Shell, tmp_path: Path) -> None:
    code, out, error = shell("evaluate", "--policy", "random,still=noop", "--out", "o", *SMALL)
    assert (code, error) == (0, "")
    assert "8/8 episodes" in out
    assert [line.split() for line in out.splitlines() if "still" in line] == [["still", "0.000", "0.000"]]
    assert [line.split()[2:] for line in out.splitlines() if "mean score" in line] == [["Demo", "Layout"]]
    assert "magical-mj report o" in out

    code, out, error = shell("report", "o", "--published")
    assert (code, error) == (0, "")
    assert out.endswith("o/report/report.md\n")
    assert "BC (ST)†" in (tmp_path / "o/report/report.md").read_text()
    assert "o/report/report.md replaces an earlier report" in shell("report", "o")[1]
    assert "give --out" in shell.fails(2, "report", "o", shutil.copytree(tmp_path / "o", tmp_path / "p"))

    code, out, error = shell("compare", "o:random", "o:still")
    assert (code, error) == (0, "")
    lines = {line.split("  ")[0].strip(): line.split() for line in out.splitlines()}
    assert lines["variant"][1:3] == ["random", "still"]
    assert {"variant", "Demo", "Layout", "all of them"} <= set(lines)
    assert "one run: the intervals cover scenes" in out
    assert lines["all of them"][-1] == "4"


def test_videos_replace_nothing_but_those_of_an_earlier_report(shell: Shell, tmp_path: Path) -> None:
    tiny = ("--tasks", "MoveToRegion", "--variants", "Demo", "--episodes", "1", "--jobs", "1")
    shell("evaluate", "--policy", "noop", "--out", "o", *tiny)
    mine = tmp_path / "mine" / "best-noop-MoveToRegion.mp4"
    mine.parent.mkdir()
    mine.write_bytes(b"mine")
    error = shell.fails(1, "report", "o", "--videos", "--out", "mine")
    assert "best-noop-MoveToRegion.mp4 does not belong to an earlier report: move it" in error
    assert [path.read_bytes() for path in mine.parent.iterdir()] == [b"mine"]
    assert shell("report", "o", "--videos", "--out", "ours")[0] == 0
    assert (tmp_path / "ours" / mine.name).stat().st_size > 1000
    (tmp_path / "ours" / "report.md").write_text("# Evaluation\n\nThis report is not finished yet.\n")  # killed
    assert shell("report", "o", "--videos", "--out", "ours")[0] == 0


def test_resume_says_what_is_done(shell: Shell, tmp_path: Path) -> None:
    command = ("evaluate", "--policy", "noop", "--out", "o", *SMALL)
    shell(*command)
    path = tmp_path / "o" / SCORES
    path.write_bytes(path.read_bytes()[:-5])
    code, out, _ = shell(*command, "--resume")
    assert code == 0
    assert "3 episodes are done already" in out
    assert "4/4 episodes" in out
    assert len(read(tmp_path / "o")) == 4


def test_failures_are_counted(shell: Shell, tmp_path: Path) -> None:
    """The agent is right only in the first scene."""
    (tmp_path / "mine.py").write_text(
        "class Agent:\n    uses_simulation = True\n    def reset(self, episode):\n        self.seed = episode.seed\n"
        "    def __call__(self, _):\n        return 99 if self.seed else 0\n"
    )
    code, out, _ = shell("evaluate", "--policy", "mine:Agent", "--out", "o", *SMALL)
    assert code == 0
    assert "Agent: 2 episodes failed: InvalidActionError: 99" in out


def test_a_replay_that_ends_otherwise_is_refused(shell: Shell, tmp_path: Path) -> None:
    shell("evaluate", "--policy", "noop", "--out", "o", *SMALL)
    path = tmp_path / "o" / SCORES
    path.write_text(path.read_text().replace('"score": 0.0', '"score": 0.5'))
    assert "ends with 0.00 now, not 0.50" in shell.fails(1, "report", "o", "--videos")
    path.write_text(path.read_text().replace('"worlds": "single"', '"worlds": "batched"'))
    assert "noop in o cannot be filmed: it was played in batched environments" in shell.fails(
        2, "report", "o", "--videos"
    )
    assert not list(tmp_path.rglob("*.mp4"))


@pytest.mark.parametrize(
    ("line", "code", "hint"),
    [
        ("evaluate --out o", 2, "--policy"),
        ("evaluate --policy noop", 2, "--out"),
        ("evaluate --policy nop --out o", 2, "Did you mean 'noop'"),
        ("evaluate --policy noop --out o --tasks MoveToRegion --variants Shape", 2, "It has: Demo"),
        ("evaluate --policy noop --out o --rules mine", 2, "paper"),
        ("evaluate --policy noop --out /dev/null/folder", 1, "cannot write into /dev/null/folder"),
        ("report", 2, "FOLDERS"),
        ("report nothing", 2, "nothing does not exist; magical-mj evaluate"),
        ("verify nothing", 2, "nothing does not exist; magical-mj evaluate"),
        ("compare nothing nothing", 2, "nothing does not exist; magical-mj evaluate"),
        ("compare nothing", 2, "missing argument"),
    ],
)
def test_wrong_use_is_one_line(shell: Shell, tmp_path: Path, line: str, code: int, hint: str) -> None:
    error = shell.fails(code, *line.split())
    assert hint.lower() in error.lower()
    assert list(tmp_path.iterdir()) == []


PAGE = (Path(__file__).parents[2] / "docs" / "evaluation.md").read_text()


def test_options_on_the_page_exist(shell: Shell) -> None:
    known = "".join(shell(name, "--help")[1] for name in ("evaluate", "report", "compare"))
    named = set(re.findall(r"--[a-z][a-z-]+", PAGE))
    assert len(named) > 10
    assert {option for option in named if option not in known} == set()
