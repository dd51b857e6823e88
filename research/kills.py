"""Kills evaluations and reports at random moments, and checks that nothing is lost and that no process stays behind.

``python research/kills.py`` prints a line for each kill, and ends with an error if something is not as it must be:

- `evaluate`: each line of scores.jsonl that was whole before is still there, and once it is done after all, the rows
  are those of an evaluation that nobody disturbed.
- `report`: each file is as it was or as it is to be, whole, and once it is done after all, they are the same files.
- After each kill, no process that the command had started is left after a few seconds.
"""

from __future__ import annotations

import argparse
import json
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

from PIL import Image

MAIN: Final = (sys.executable, "-m", "magical_mj")
EVALUATE: Final = ("--policy", "random", "--tasks", "MoveToRegion,FixColour", "--episodes", "60")
SIGNALS: Final = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
PATIENCE: Final = 15.0
"""Seconds within which all processes must be gone."""


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20, help="of each of the two commands")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # shells ignore it in what they start in the background
    rng = random.Random(arguments.seed)  # noqa: S311 no secret
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        whole = folder / "whole"
        seconds = undisturbed(["evaluate", *EVALUATE, "--jobs", "2", "--out", str(whole)])
        kill_evaluations(folder / "killed", rows(whole), arguments.kills, seconds, rng)
        kill_reports(whole, folder, arguments.kills, rng)


def kill_evaluations(out: Path, expected: set[str], kills: int, seconds: float, rng: random.Random) -> None:
    """Kills an evaluation again and again, resumes it each time, and lets it end."""
    command = [*MAIN, "evaluate", *EVALUATE, "--out", str(out), "--jobs", "2", "--resume"]
    for number in range(kills):
        before = lines(out)
        how, ended = killed(command, seconds, rng)
        if lines(out)[: len(before)] != before:
            raise SystemExit(f"lines were lost or changed: {out}")
        told(f"evaluate {number}: {how}, {len(lines(out)) - len(before)} more lines{', it had ended' if ended else ''}")
        if len(lines(out)) == len(expected):
            for path in out.iterdir():
                path.unlink()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    if rows(out) != expected:
        raise SystemExit("the rows are not those of an evaluation that was left in peace")
    told(f"evaluate: {kills} kills, and the {len(expected)} rows are the same")


def kill_reports(scores: Path, folder: Path, kills: int, rng: random.Random) -> None:
    """Kills a report again and again over the files of the last one."""
    whole, out = folder / "report", folder / "killed-report"
    seconds = undisturbed(["report", str(scores), "--out", str(whole)])
    expected = {path.name: path.read_bytes() for path in whole.iterdir()}
    command = [*MAIN, "report", str(scores), "--out", str(out)]
    for number in range(kills):
        how, _ = killed(command, seconds, rng)
        there = {path.name: path for path in out.iterdir() if not path.name.startswith(".")} if out.exists() else {}
        for name, path in there.items():
            check_whole(path, expected[name])
        told(f"report {number}: {how}, {len(there)} of {len(expected)} files, all whole")
        if len(there) == len(expected):
            for path in out.iterdir():
                path.unlink()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    if {path.name for path in out.iterdir()} != set(expected):
        raise SystemExit(f"the report's files are {sorted(path.name for path in out.iterdir())}")
    told(f"report: {kills} kills, and the {len(expected)} files are there, whole")


def check_whole(path: Path, expected: bytes) -> None:
    """Ends the program if a file is not what it is to be; pictures, which hold their time, must open."""
    if path.suffix == ".png":
        with Image.open(path) as picture:
            picture.load()
    elif path.suffix == ".pdf":
        if not path.read_bytes().rstrip().endswith(b"%%EOF"):
            raise SystemExit(f"{path} is not whole")
    elif path.read_bytes() != expected:
        raise SystemExit(f"{path} is not what it is to be")


def undisturbed(arguments: list[str]) -> float:
    """Lets a command end, and returns how many seconds it took."""
    start = time.monotonic()
    subprocess.run([*MAIN, *arguments], check=True, stdout=subprocess.DEVNULL)
    return time.monotonic() - start


def killed(command: list[str], latest: float, rng: random.Random) -> tuple[str, bool]:
    """Starts a command and kills it within so many seconds; returns how and when, and whether it had ended before."""
    process = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    moment, how = rng.uniform(0, latest), rng.choice(SIGNALS)
    try:
        process.wait(moment)
        ended = True
    except subprocess.TimeoutExpired:
        process.send_signal(how)  # to the process alone; its workers must notice by themselves
        process.wait()
        ended = False
    start = time.monotonic()
    while left := session(process.pid):
        if time.monotonic() - start > PATIENCE:
            raise SystemExit(f"{how.name} after {moment:.1f} s left processes: {left}")
        time.sleep(0.05)
    return f"{how.name} after {moment:.1f} s, all gone after {time.monotonic() - start:.1f} s more", ended


def session(leader: int) -> list[int]:
    """The processes of a session."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:  # it has just ended
            continue
        if int(fields[3]) == leader and fields[0] != "Z":
            found.append(int(stat.parent.name))
    return found


def lines(out: Path) -> list[str]:
    """The whole lines of an evaluation's file."""
    path = out / "scores.jsonl"
    return path.read_text().split("\n")[:-1] if path.exists() else []


def rows(out: Path) -> set[str]:
    """What must not depend on how often an evaluation was stopped."""
    return {json.dumps({**json.loads(line), "seconds": 0}) for line in lines(out)}


def told(text: str) -> None:
    """Prints at once, for whoever waits."""
    print(text, flush=True)


if __name__ == "__main__":
    main()
