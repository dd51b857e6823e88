"""What the Makefile installs with the system's package manager."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "tools" / "system.sh"


@pytest.mark.skipif(sys.platform != "linux", reason="the script asks for packages of Linux")
@pytest.mark.parametrize("refuse", ["", "1"])
def test_the_system_is_not_changed_if_the_user_refuses(tmp_path: Path, refuse: str) -> None:
    (tmp_path / "apt-get").write_text(f"#!/bin/sh\necho called >> {tmp_path}/log\n")  # in place of the real one
    (tmp_path / "sudo").write_text('#!/bin/sh\nshift\nexec "$@"\n')
    for name in ("apt-get", "sudo"):
        (tmp_path / name).chmod(0o755)
    variables = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "NO_APT": refuse, "CHROMIUM": "/nowhere"}
    result = subprocess.run(
        ["sh", str(SCRIPT), sys.executable, "chromium"], env=variables, capture_output=True, text=True, check=False
    )
    assert (tmp_path / "log").exists() == (not refuse)
    assert ("please install these system packages" in result.stderr) == bool(refuse)
    assert "chromium" in result.stdout + result.stderr
