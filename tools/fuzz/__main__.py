"""Fuzzes the package with random hostile values, files, command lines and clients for a given time.

    python tools/fuzz [--minutes 60] [--cases 100] [--kinds calls,scenes] [--case KIND:NUMBER]

A finding is a result that no user's mistake may have: an exception other than `MagicalError`, a process that crashes or
hangs, a changed user's file, an empty error message, or undetected damage. A case depends only on its number, so
`--case` repeats one. Each finding is printed once. If there are any, the exit code is 1.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Final

KINDS: Final = ("calls", "scenes", "states", "hands", "files", "commands", "clients", "costs")
SLICE: Final = 180.0  # seconds for each kind in turn, in a separate process


class Campaign:
    """Runs cases and counts them, those that were refused with a clear error, and the findings."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.tried: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self.finds: Counter[str] = Counter()

    def proceed(self, kind: str, seconds: float, most: int) -> None:
        """Runs more cases of a kind in a separate process, for some seconds or until there were `most` cases."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and self.tried[kind] < most:
            numbers = f"{self.tried[kind]}:{most}"
            command = [sys.executable, "-X", "faulthandler", str(Path(__file__).parent / "cases.py"), kind]
            self.watch(kind, [*command, numbers, str(end - time.monotonic()), str(self._folder)])

    def watch(self, kind: str, command: list[str]) -> None:
        """Reads the results of a process's cases until it ends or crashes."""
        with (
            (self._folder / f"{kind}.stderr").open("w+") as errors,
            subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=errors, text=True, start_new_session=True, env=_variables()
            ) as process,
        ):
            assert process.stdout is not None  # noqa: S101  for the type checker
            for line in process.stdout:
                self._count(kind, json.loads(line))
            if process.wait() != 0:
                errors.seek(0)
                said = [line.strip() for line in errors if line.strip()][-40:]
                ours = [line for line in said if "magical_mj" in line][:3] or said[-3:]
                what = f"the process ends with {process.returncode}"
                self._count(kind, {"result": "find", "what": what, "said": " | ".join(ours)})

    def _count(self, kind: str, outcome: dict[str, str]) -> None:
        number = self.tried[kind]
        self.tried[kind] += 1
        self.refused[kind] += outcome["result"] == "refused"
        if outcome["result"] == "find":
            find = f"{kind}: {outcome['what']}"
            self.finds[find] += 1
            if self.finds[find] == 1:
                print(f"FOUND {find} ({outcome['said'][:300]!a}); to repeat it: --case {kind}:{number}", flush=True)


def _variables() -> dict[str, str]:
    return os.environ | {"OMP_NUM_THREADS": "1", "SDL_VIDEODRIVER": "dummy", "PYGAME_HIDE_SUPPORT_PROMPT": "1"}


def main() -> int:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--cases", type=int, default=10**9, help="the most cases of each kind")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--case", help="repeat a case, such as files:12, and show its output")
    arguments = parser.parse_args()
    kinds = arguments.kinds.split(",")
    kind, _, number = (arguments.case or f"{kinds[0]}:0").partition(":")
    if not {kind, *kinds} <= set(KINDS) or not number.isdecimal():
        parser.error(f"the kinds are {', '.join(KINDS)}; a case is such as {KINDS[0]}:12")
    with tempfile.TemporaryDirectory() as name:
        if arguments.case:
            numbers = f"{number}:{int(number) + 1}"
            command = [sys.executable, str(Path(__file__).parent / "cases.py"), kind, numbers, "0", name, "--loud"]
            return subprocess.run(command, check=False, env=_variables()).returncode
        folder = Path(name) / "deep" / "enough"  # commands may get the path ../.., and must not find other files
        folder.mkdir(parents=True)
        campaign, end = Campaign(folder), time.monotonic() + 60 * arguments.minutes
        while time.monotonic() < end and any(campaign.tried[kind] < arguments.cases for kind in kinds):
            for kind in kinds:
                campaign.proceed(kind, min(SLICE, end - time.monotonic()), arguments.cases)
            counts = ", ".join(f"{kind} {campaign.tried[kind]}" for kind in campaign.tried)
            print(f"tried so far: {counts}; findings: {len(campaign.finds)}", flush=True)
    for kind, tried in campaign.tried.items():
        print(f"{kind}: {tried} cases; {campaign.refused[kind]} were refused with a clear error")
    for find, times in campaign.finds.most_common():
        print(f"{times} x {find}")
    return 1 if campaign.finds else 0


if __name__ == "__main__":
    sys.exit(main())
