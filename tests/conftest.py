"""Imported before any test module: magical_mj chooses the OpenGL backend, which mujoco looks at when it is imported."""

import os
import shutil
from pathlib import Path

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")  # PyTorch's: several tests run at once, and its threads wait busily

from commands import Shell
from entries import EPISODES

import magical_mj


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Shell:
    """Runs `magical-mj` in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return Shell(capsys)


@pytest.fixture(scope="session")
def evaluated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A few episodes of the expert, who is right everywhere, so that nobody else's actions would be."""
    out = tmp_path_factory.mktemp("evaluated") / "expert"
    magical_mj.evaluate("expert", tasks="MoveToRegion", variants="Layout", episodes=EPISODES, out=out)
    return out


@pytest.fixture
def folder(evaluated: Path, tmp_path: Path) -> Path:
    """A copy of that evaluation, to tamper with."""
    return Path(shutil.copytree(evaluated, tmp_path / "expert"))
