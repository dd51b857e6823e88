"""Commands whose disk is full: one line that names the file, and nothing is left that looks whole and is not."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from magical_mj.evaluation.scores import read
from tests.helpers.commands import Shell

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
}
MAY_STAY = ("scores.jsonl", "run.json", "config.toml", "metrics.csv", "events.*")
"""What is written line by line, or was finished before."""


@contextmanager
def small_files() -> Iterator[None]:
    """All files of this process and of those that it starts are limited."""
    before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (MOST, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.parametrize(("command", "named"), COMMANDS.items(), ids=[" ".join(words[:2]) for words in COMMANDS])
def test_a_full_disk_is_one_line_that_names_the_file(
    command: tuple[str, ...], named: str, shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    with small_files():
        code, out, error = shell(*command)
    assert code == 1, out
    assert error.count("\n") == 1
    assert named in error
    left = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert [path.name for path in left if not any(path.match(pattern) for pattern in MAY_STAY)] == []
    if "evaluate" in command:
        assert len(read(tmp_path / "scores")) > 0  # the episodes that had found room


def test_a_training_on_a_full_disk_is_one_line_too(tmp_path: Path) -> None:
    """In a process of its own: threads of TensorBoard's writer outlive an error in this one."""
    command = f"'{sys.executable}' -m magical_mj train bc {' '.join((*TASK, *STATE))} --set bc.batches=200 --out run"
    limited = f"trap '' XFSZ; ulimit -f 2; PYTHONDONTWRITEBYTECODE=1 exec {command}"
    result = subprocess.run(["bash", "-c", limited], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "run/" in result.stderr
    left = [path.name for path in tmp_path.rglob("*") if path.is_file()]
    assert not {"policy.safetensors", "checkpoint.safetensors"} & set(left)
