"""A user's own recordings on the command line: record, import, train, evaluate, report."""

from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path

from magical_mj import demos
from magical_mj.protocol import PROTOCOL
from tests.helpers.commands import Shell


def recording(number: int) -> str:
    """The file that the page in the browser saves, for an episode in MoveToRegion's demo scene."""
    actions = demos.load("MoveToRegion")[number].actions.tolist()
    names = {"format": 1, "protocol": PROTOCOL, "task": "MoveToRegion", "variant": "Demo", "seed": 0}
    return json.dumps({**names, "actions": actions})


def test_recordings_are_trained_on_evaluated_and_reported(shell: Shell) -> None:
    for number in range(3):
        Path(f"{number}.json").write_text(recording(number))
    assert shell("demos", "import", "0.json", "1.json", "2.json", "--out", "mine")[0] == 0
    layout = ("demos", "generate", "--tasks", "MoveToRegion", "--variants", "Layout", "--count", 1, "--jobs", 1)
    assert shell(*layout, "--out", "mine")[0] == 0
    train = ("train", "bc", "--tasks", "MoveToRegion", "--preset", "State", "--set", "bc.batches=20", "--set")
    train = (*train, "evaluations=0", "--demonstrations", "mine", "--out", "runs/mine")
    code, out, _ = shell(*train)
    assert code == 0
    folder = Path("mine").absolute()
    assert f"MoveToRegion: 3 of 3 demonstrations of the demo scene in {folder}, mean score 1.00, lowest 1.00" in out
    assert shell(*train, "--resume")[0] == 0
    shutil.copy("mine/MoveToRegion-Demo-human-000.npz", "mine/MoveToRegion-Demo-more.npz")
    assert "have changed since runs/mine was begun" in shell(*train, "--resume")[2]
    Path("mine/MoveToRegion-Demo-more.npz").unlink()
    assert tomllib.loads(Path("runs/mine/config.toml").read_text())["recordings"] == str(folder)
    evaluate = ("evaluate", "--policy", "MINE=runs/mine", "--tasks", "MoveToRegion", "--variants", "Demo,Layout")
    assert shell(*evaluate, "--preset", "State", "--episodes", 2, "--jobs", 1, "--out", "scores")[0] == 0
    twice = ("evaluate", "--policy", "MINE=runs/mine,MINE=runs/mine", *evaluate[3:], "--preset", "State", "--out", "no")
    assert "the runs 0, 1 of MINE have equal policies" in shell.fails(1, *twice)
    assert not Path("no").exists()
    assert (
        shell(*evaluate[:2], "noop", *evaluate[3:], "--episodes", 2, "--split", "dev", "--jobs", 1, "--out", "dev")[0]
        == 0
    )
    assert "on the split dev: not by the official protocol" in shell("compare", "dev", "dev")[1]
    assert "official" not in shell("compare", "scores", "scores")[1]
    assert shell("report", "scores")[0] == 0
    page = Path("scores/report/report.md").read_text()
    assert "| MINE |" in page
    assert "observations: `State`" in page


def test_recordings_of_other_tasks_or_scenes_are_refused(shell: Shell) -> None:
    layout = ("demos", "generate", "--tasks", "MoveToRegion", "--variants", "Layout", "--count", 1, "--jobs", 1)
    assert shell(*layout, "--out", "mine")[0] == 0
    train = ("train", "bc", "--preset", "State", "--demonstrations", "mine", "--out", "runs/mine", "--tasks")
    assert "there are no demonstrations of FindDupe in" in shell.fails(2, *train, "FindDupe")
    absent = ("train", "bc", "--preset", "State", "--demonstrations", "other", "--out", "runs/x", "--tasks", "FindDupe")
    assert "other, which does not exist: make some with" in shell.fails(2, *absent)
    assert "of MoveToRegion in " in (error := shell.fails(2, *train, "MoveToRegion"))
    assert "are of other scenes: MoveToRegion-Layout" in error
    assert not Path("runs").exists()
