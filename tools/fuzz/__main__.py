"""Tries to break the package: hostile values, files, command lines and clients, drawn at random, until time is over.

    python tools/fuzz [--minutes 60] [--cases 100] [--kinds calls,scenes] [--case KIND:NUMBER]

A find is whatever a user's mistake must not lead to: an exception other than `MagicalError`, a process that dies or
hangs, a file that was there and is changed, a message without words, and damage that nobody notices. Cases are drawn
from their numbers, so `--case` repeats one. Each find is printed once, and makes the exit code 1.
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

KINDS: Final = ("calls", "scenes", "states", "hands", "files", "commands", "clients")
SLICE: Final = 180.0  # seconds for each kind in turn, in a process of its own


class Campaign:
    """What was tried so far, and what was found."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.tried: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self.finds: Counter[str] = Counter()

    def go_on(self, kind: str, seconds: float, most: int) -> None:
        """Tries more cases of a kind for some seconds, in a process of its own, until there are so many."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and self.tried[kind] < most:
            numbers = f"{self.tried[kind]}:{most}"
            command = [sys.executable, "-X", "faulthandler", str(Path(__file__).parent / "cases.py"), kind]
            self.watch(kind, [*command, numbers, str(end - time.monotonic()), str(self._folder)])

    def watch(self, kind: str, command: list[str]) -> None:
        """Reads what a process tells of its cases, until it ends or dies."""
        with (
            (self._folder / f"{kind}.stderr").open("w+") as errors,
            subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=errors, text=True, start_new_session=True, env=_variables()
            ) as process,
        ):
            assert process.stdout is not None  # noqa: S101  for the type checker
            for line in process.stdout:
                self._told(kind, json.loads(line))
            if process.wait() != 0:
                errors.seek(0)
                said = [line.strip() for line in errors if line.strip()][-40:]
                ours = [line for line in said if "magical_mj" in line][:3] or said[-3:]
                what = f"the process ends with {process.returncode}"
                self._told(kind, {"result": "find", "what": what, "said": " | ".join(ours)})

    def _told(self, kind: str, told: dict[str, str]) -> None:
        number = self.tried[kind]
        self.tried[kind] += 1
        self.refused[kind] += told["result"] == "refused"
        if told["result"] == "find":
            find = f"{kind}: {told['what']}"
            self.finds[find] += 1
            if self.finds[find] == 1:
                print(f"FOUND {find} ({told['said'][:300]!a}); again: --case {kind}:{number}", flush=True)


def _variables() -> dict[str, str]:
    return os.environ | {"OMP_NUM_THREADS": "1", "SDL_VIDEODRIVER": "dummy", "PYGAME_HIDE_SUPPORT_PROMPT": "1"}


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--cases", type=int, default=10**9, help="of each kind at most")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--case", help="repeat one, such as files:12, and show everything")
    arguments = parser.parse_args()
    kinds = arguments.kinds.split(",")
    kind, _, number = (arguments.case or f"{kinds[0]}:0").partition(":")
    if not {kind, *kinds} <= set(KINDS) or not number.isdecimal():
        parser.error(f"there are the kinds {', '.join(KINDS)}, and cases such as {KINDS[0]}:12")
    with tempfile.TemporaryDirectory() as name:
        if arguments.case:
            numbers = f"{number}:{int(number) + 1}"
            command = [sys.executable, str(Path(__file__).parent / "cases.py"), kind, numbers, "0", name, "--loud"]
            return subprocess.run(command, check=False, env=_variables()).returncode
        folder = Path(name) / "deep" / "enough"  # for commands that are given ../..: what others keep is no case
        folder.mkdir(parents=True)
        campaign, end = Campaign(folder), time.monotonic() + 60 * arguments.minutes
        while time.monotonic() < end and any(campaign.tried[kind] < arguments.cases for kind in kinds):
            for kind in kinds:
                campaign.go_on(kind, min(SLICE, end - time.monotonic()), arguments.cases)
            counts = ", ".join(f"{kind} {campaign.tried[kind]}" for kind in campaign.tried)
            print(f"tried so far: {counts}; finds: {len(campaign.finds)}", flush=True)
    for kind, tried in campaign.tried.items():
        print(f"{kind}: {tried} cases, of which {campaign.refused[kind]} were refused with a clear error")
    for find, times in campaign.finds.most_common():
        print(f"{times} x {find}")
    return 1 if campaign.finds else 0


if __name__ == "__main__":
    sys.exit(main())
