"""The command `train`: what it says of its progress, and of mistakes."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from magical_mj.cli import console
from magical_mj.cli.app import run
from magical_mj.learners import Progress
from magical_mj.learners.cli.train import TrainingView, bars
from magical_mj.learners.policy import POLICY
from tests.helpers.learners import TINY

PICTURES = {name: value for name, value in TINY.items() if name not in ("device", "network.entity")}
SET = [f"--set={name}={value}" for name, value in {**PICTURES, "bc.batches": 8, "bc.batch_size": 4}.items()]
TRAIN = ["train", "bc", "--tasks", "MoveToRegion", "--quick", "--device", "cpu", *SET]


def test_train_then_evaluate(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "a run, or b=c")
    assert run([*TRAIN, "--out", out]) == 0
    assert f"magical-mj evaluate --policy '{out}' --tasks MoveToRegion --out" in capfd.readouterr().out
    assert run([*TRAIN, "--out", out]) == 1
    assert "already contains a training; --resume (resume=True) continues it" in capfd.readouterr().err
    assert run([*TRAIN, "--out", out, "--resume"]) == 0
    scores = ["--episodes", "2", "--jobs", "1", "--out", str(tmp_path / "scores")]
    assert run(["evaluate", "--policy", out, "--tasks", "MoveToRegion", "--variants", "Demo", *scores]) == 0
    assert "\n a run, or b=c " in capfd.readouterr().out
    (Path(out) / POLICY).unlink()
    assert run(["evaluate", "--policy", out, "--out", str(tmp_path / "none")]) == 2
    assert "contains no policy: no " in capfd.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["train", "bd", "--tasks", "FindDupe"], "unknown method 'bd'. Did you mean 'bc'?"),
        (["train", "bc", "--tasks", "FindDupe,MakeLine"], "needs --multi-task"),
        (["train", "bc", "--tasks", "FindDupe", "--set", "ppo.clip"], "--set must be NAME=VALUE"),
        (["train", "bc", "--tasks", "FindDupe", "--set", "bc.batch=3"], "Did you mean 'bc.batches'?"),
        (["train", "bc", "--tasks", "FindDupe", "--device", "meta"], "'meta' stores no values"),
        (
            ["train", "bc", "--tasks", "FindDupe", "--set", "ppo.clip=0.1"],
            "ppo.clip is for gail, wgail-gp, airl, al, ppo and",
        ),
        (["train", "bc", "--tasks", "FindDupe", "--preset", "State", "--set", "network.channels=8"], "is for pictures"),
        (
            ["train", "bc", "--tasks", "FindDupe", "--set", "network.entity=8"],
            "network.entity is for states and has no",
        ),
        (
            ["train", "gail", "--tasks", "FindDupe", "--set", "precision=bfloat16"],
            "precision is for bc and has no effect",
        ),
        (["train", "al", "--tasks", "FindDupe", "--augment", "none"], "--augment has an effect only with bc"),
        (["train", "bc", "--tasks", "FindDupe", "--simulator", "warp"], "bc cannot choose its simulator"),
        (["train", "bc", "--tasks", "FindDupe", "--set", "seed=5"], "seed has its own option"),
        (["train", "bc", "--tasks", "FindDupe", "--set", "demonstrations=26"], "there are 25"),
        (["train", "bc", "--tasks", "FindDupe", "--set", "network.frames=5"], "an integer of at most 4, not '5'"),
    ],
)
def test_mistakes_are_one_line(
    arguments: list[str], says: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run([*arguments, "--out", str(tmp_path / "run")]) == 2
    error = capfd.readouterr().err
    assert says in error
    assert error.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_a_missing_extra_is_one_line(tmp_path: Path) -> None:
    hide = "import sys; sys.modules['kornia'] = None; from magical_mj.cli import main; sys.exit(main(sys.argv[1:]))"
    arguments = [sys.executable, "-c", hide, *TRAIN, "--out", str(tmp_path / "run")]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("magical-mj: learners need kornia: pip install ")
    assert '[il]"' in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(("updates", "left"), [(10, r" \d+:\d\d:\d\d left"), (10**400, "")])
def test_the_line_of_each_minute_counts_any_number_of_updates(
    updates: int, left: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("FIRST", "MINUTE"):
        monkeypatch.setattr(console, name, 0)
    written = StringIO()
    watch = TrainingView(bars(Console(file=written)), "bc")
    for update in (1, 2):
        watch(Progress(update, updates, {"loss": 1 / 3}, {}))
        time.sleep(0.001)
    line = written.getvalue().splitlines()[-1]
    assert re.match(rf"bc 2/{updates} updates, \S+/s loss 0.333 \d:\d\d:\d\d{left}$", line)


def test_a_training_that_goes_on_tells_its_present_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("FIRST", "MINUTE"):
        monkeypatch.setattr(console, name, 0)
    written = StringIO()
    watch = TrainingView(bars(Console(file=written)), "gail")
    for update in (2001, 2002, 2003):
        watch(Progress(update, 4000, {}, {}))
        time.sleep(0.05)
    speeds = [float(speed) for speed in re.findall(r"updates, (\S+)/s", written.getvalue())]
    assert len(speeds) == 2
    assert max(speeds) <= 20
