"""Commands whose disk is full: one line that names the file, and nothing is left that looks whole and is not."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from magical_mj.evaluation.scores import read

MOST = 1500  # bytes of a file, as if the disk were full then
STATE = ("--preset", "State")
TASK = ("--tasks", "MoveToRegion")
COMMANDS = {  # and the file that the error names
    ("view", "FindDupe", "--out", "a.png"): "a.png",
    ("export", "FindDupe", "--out", "models"): "models/FindDupe-Demo-0.xml",
    ("rollout", "MoveToRegion", "--policy", "random", *STATE, "--video", "a.mp4", "--size", "64"): "a.mp4",
    ("demos", "video", *TASK, "--out", "a.mp4", "--size", "64"): "a.mp4",
    ("demos", "generate", *TASK, "--count", "1", "--out", "mine"): "mine/MoveToRegion-Demo-000.npz",
    ("demos", "export", *TASK, *STATE, "--out", "a.npz"): "a.npz",
    ("demos", "export", *TASK, "--to", "robomimic", *STATE, "--out", "a.hdf5"): "a.hdf5",
    ("evaluate", "--policy", "noop", *TASK, "--episodes", "3", "--out", "scores"): "scores/scores.jsonl",
    ("train", "bc", *TASK, *STATE, "--set", "bc.batches=200", "--out", "run"): "run/",
}
MAY_STAY = ("scores.jsonl", "run.json", "config.toml", "metrics.csv", "events.*")
"""What is written line by line, or was finished before."""


def _small_files() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (MOST, MOST))
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)


@pytest.mark.parametrize(("command", "named"), COMMANDS.items(), ids=[" ".join(words[:2]) for words in COMMANDS])
def test_a_full_disk_is_one_line_that_names_the_file(command: tuple[str, ...], named: str, tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "magical_mj", *command],
        preexec_fn=_small_files,
        cwd=tmp_path,
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 1, result.stdout
    assert result.stderr.count("\n") == 1
    assert named in result.stderr
    left = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert [path.name for path in left if not any(path.match(pattern) for pattern in MAY_STAY)] == []
    if "evaluate" in command:
        assert len(read(tmp_path / "scores")) > 0  # the episodes that had found room
