"""A short campaign of tools/fuzz: what is wrong is refused in words, and nothing dies, hangs or is overwritten."""

from __future__ import annotations

import importlib
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from magical_mj.utils.errors import MagicalError

FUZZ = Path(__file__).parent.parent / "tools" / "fuzz"
CASES = {"calls": 100, "scenes": 15, "states": 20, "hands": 3, "clients": 4, "costs": 40}
"""Few of each, and none that starts commands. weekly.yml runs all kinds for longer."""


@pytest.mark.slow
@pytest.mark.parametrize("kinds", CASES)
def test_hostile_cases_are_refused_or_harmless(kinds: str) -> None:
    command = [sys.executable, str(FUZZ), "--kinds", kinds, "--cases", str(CASES[kinds])]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    for kind in kinds.split(","):
        (found,) = re.findall(rf"^{kind}: (\d+) cases; (\d+) were refused", result.stdout, re.MULTILINE)
        tried, refused = map(int, found)
        assert tried == CASES[kinds]
        assert refused > 0 or kind in ("states", "hands", "clients")


def test_the_fuzzing_campaign_finds_faults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The campaign itself can fail: by exceptions of other kinds, errors without words, and processes that die."""
    monkeypatch.syspath_prepend(str(FUZZ))
    cases = importlib.import_module("cases")
    for raised, expected in (
        (ZeroDivisionError("x"), "find"),
        (MagicalError(""), "find"),
        (cases.FindError("gone"), "find"),
        (MagicalError("why"), "refused"),
        (None, "fine"),
    ):

        def case(rng: object, folder: Path, raised: Exception | None = raised) -> None:
            if raised is not None:
                raise raised

        monkeypatch.setitem(cases.KINDS, "calls", case)
        assert cases.result("calls", 0, tmp_path, loud=False)["result"] == expected
    campaign = runpy.run_path(str(FUZZ / "__main__.py"))["Campaign"](tmp_path)
    for number in (0, 6, 11):
        program = f"import os; os.kill(os.getpid(), {number})"
        campaign.watch("calls", [sys.executable, "-c", program])
    assert list(campaign.finds) == [f"calls: the process ends with {-number}" for number in (6, 11)]
