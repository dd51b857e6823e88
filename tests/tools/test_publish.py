"""What goes to the hub: the folder that `tools.publish` prepares, and its rehearsed upload."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import magical_mj
from tools import publish

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(not (ROOT / "site" / "policies").exists(), reason="the sdist has no policies")


def test_the_prepared_folder_is_whole_and_can_be_uploaded(tmp_path: Path) -> None:
    out = tmp_path / "publish"
    publish.prepare(out, "MoveToRegion", "State")
    assert [path.name for path in tmp_path.iterdir()] == ["publish"]
    sets = {f"magical-mj-MoveToRegion-{name}" for name in ("expert", "diverse", "graded")}
    assert {path.name for path in (out / "datasets").iterdir()} == sets
    for folder in out.glob("*/*"):
        assert (folder / "README.md").read_text().startswith("---\nlicense: apache-2.0\n")
    (policies,) = (path.parent for path in out.glob("models/*/FindDupe.onnx"))
    assert {path.stem for path in policies.glob("*.onnx")} == set(magical_mj.TASKS)
    card = (policies / "README.md").read_text()
    assert "| MoveToRegion | 1.00 | 0.11 |" in card
    assert f"(n, 4, {len(magical_mj.observations.STATE_NAMES)})" in card
    if find_spec("huggingface_hub") is not None:
        command = [sys.executable, "-m", "tools.publish", "--rehearse", "--out", out]
        said = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
        assert said.count("files have arrived") == 5


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "publish").mkdir()
    (tmp_path / "publish" / "mine").touch()
    with pytest.raises(FileExistsError):
        publish.prepare(tmp_path / "publish", "MoveToRegion", "State")
    assert (tmp_path / "publish" / "mine").exists()
