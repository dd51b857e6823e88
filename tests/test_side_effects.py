"""Calls of the package change nothing that it shares with its caller."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def test_calls_leave_the_process_as_it_was(tmp_path: Path) -> None:
    """Random generators, settings of libraries, warnings, signals, logging, folder and environment variables."""
    root = Path(__file__).parents[1]
    variables = {name: value for name, value in os.environ.items() if name not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    path = os.pathsep.join(filter(None, (str(root), os.environ.get("PYTHONPATH"))))
    command = [sys.executable, "-W", "ignore", "-m", "tests.helpers.side_effects"]
    result = subprocess.run(
        command, cwd=tmp_path, env=variables | {"PYTHONPATH": path}, capture_output=True, text=True, check=False
    )
    assert (result.returncode, result.stdout) == (0, ""), result.stderr
