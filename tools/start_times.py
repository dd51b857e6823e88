"""Prints start-up times in seconds of processor time: imports, help, and the first observation.

Each is measured in a new process. The shortest of several runs counts. The times include Python's own start.

    python tools/start_times.py [RUNS]
"""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Final

MAKE: Final = "import gymnasium, magical_mj; gymnasium.make('magical_mj/FindDupe-Demo-{}-v0').reset(seed=0)"
STARTS: Final = {
    "Python itself": ["-c", "pass"],
    "import numpy": ["-c", "import numpy"],
    "import gymnasium": ["-c", "import gymnasium"],
    "import mujoco": ["-c", "import mujoco"],
    "import magical_mj": ["-c", "import magical_mj"],
    "magical-mj --version": ["-m", "magical_mj", "--version"],
    "magical-mj --help": ["-m", "magical_mj", "--help"],
    "magical-mj evaluate --help": ["-m", "magical_mj", "evaluate", "--help"],
    "first observation, State": ["-c", MAKE.format("State")],
    "first observation, LoRes4E": ["-c", MAKE.format("LoRes4E")],
}


def seconds(arguments: list[str]) -> float:
    """The processor time of a process and its children."""
    before = os.times()
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


if __name__ == "__main__":
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    for name, arguments in STARTS.items():
        print(f"{name:28} {min(seconds(arguments) for _ in range(runs)):.2f}", flush=True)
