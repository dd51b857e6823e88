"""The tests' temporary folder, which `conftest.py` makes: gone when all is well, and a reason to fail if not."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TIDY = "def test_tidy(tmp_path): (tmp_path / 'a').mkdir()"
UNTIDY = "import tempfile\ndef test_untidy(): open(tempfile.mkdtemp(prefix='mine-') + '/a', 'w').close()"
FAILING = "def test_failing(tmp_path): assert not (tmp_path / 'a').mkdir() and False"


@pytest.mark.parametrize(("test", "code", "processes"), [(TIDY, 0, 1), (UNTIDY, 1, 0), (UNTIDY, 1, 1), (FAILING, 1, 0)])
def test_temporary_files_that_stay_make_the_tests_fail(test: str, code: int, processes: int, tmp_path: Path) -> None:
    system, tests = tmp_path / "system", tmp_path / "tests"
    system.mkdir()
    tests.mkdir()
    shutil.copy(Path(__file__).parents[2] / "conftest.py", tests)
    (tests / "test_it.py").write_text(f"{test}\n")
    result = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *(["-n", "1"] if processes else []), str(tests)],
        env={name: value for name, value in os.environ.items() if "PYTEST" not in name}
        | {"TMPDIR": str(system), "PYTHONPATH": str(Path(__file__).parents[2])},  # of what conftest.py imports
        capture_output=True,
        text=True,
        check=False,
        cwd=tests,
    )
    assert result.returncode == code, result.stdout
    assert "1 failed" in result.stdout if test is FAILING else "1 passed" in result.stdout
    kept = list(system.iterdir())
    assert len(kept) == code
    assert all(f"temporary files are in {folder}" in result.stdout for folder in kept)
    assert ("left behind, though it should be gone: mine-" in result.stdout) == (test is UNTIDY)
