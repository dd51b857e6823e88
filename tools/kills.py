"""Kills `demos generate` and `play --record` at random moments, and looks whether anything is lost.

    python tools/kills.py [ROUNDS]

After each kill, every file that bears a demonstration's name must be whole, those of earlier rounds must be unchanged,
and the command must go on from there.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

from magical_mj import demos

LONGEST: Final = 6.0  # seconds before a kill
GENERATE: Final = ("-m", "magical_mj", "demos", "generate", "--tasks", "FixColour,MoveToRegion", "--count", "300")
PLAYER: Final = """
import random, sys
from magical_mj.cli import main
from magical_mj.cli.window import Window
Window.action = lambda self: random.randrange(1, 18)
Window.wishes = lambda self: ["next"] if random.random() < 0.02 else []
Window.show = lambda self, *_: None
sys.exit(main(sys.argv[1:]))
"""  # somebody who plays without end, at any speed


def killed(command: list[str], seconds: float) -> None:
    """Runs a command in a session of its own, and kills all its processes after some time."""
    process = subprocess.Popen(
        [sys.executable, *command],
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"SDL_VIDEODRIVER": "dummy"},
    )
    time.sleep(seconds)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def main(rounds: int) -> None:
    """Prints a line for each kill; an error that tells what was lost ends it."""
    draw = random.Random(0)  # noqa: S311
    with tempfile.TemporaryDirectory() as name:
        folders = {kind: Path(name) / kind for kind in ("generate", "play")}
        kept: dict[Path, bytes] = {}
        for number in range(rounds):
            kind = ("generate", "play")[number % 2]
            folder = folders[kind]
            folder.mkdir(exist_ok=True)
            generate = [*GENERATE, "--out", str(folder), "--jobs", "2"]
            play = ["-c", PLAYER, "play", "MoveToRegion", "Jitter", "--record", str(folder), "--size", "16"]
            seconds = draw.uniform(2.0, 2.0 + LONGEST)
            killed(generate if kind == "generate" else play, seconds)
            for path in demos.files_in(folder):
                demos.read(path)
            found = {path: path.read_bytes() for path in demos.files_in(folder)}
            lost = [str(path) for path in kept if path.parent == folder and found.get(path) != kept[path]]
            if lost:
                raise SystemExit(f"lost or changed after {seconds:.1f} s of {kind}: {', '.join(lost)}")
            fresh = len(found.keys() - kept.keys())
            kept |= found
            print(f"{kind} killed after {seconds:.1f} s: {fresh} more, {len(found)} in all, each whole")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
