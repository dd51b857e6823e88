"""Packs a folder of demonstrations into those that come with the package, one file a task. `make demonstrations`.

With ``--sweeps`` instead of a folder it makes those of SweepToTop: each body's in a file of its own, variant Layout.
"""

from __future__ import annotations

import sys
from pathlib import Path

from magical_mj.demos.demonstration import Demonstration, files_in, read
from magical_mj.demos.recording import demonstrate
from magical_mj.demos.shipped import FOLDER, SUFFIX, pack
from magical_mj.scene.bodies import GRIPPER
from magical_mj.tasks.registry import task_spec

FIRST, COUNT = 5_000_000, 50


def main(folder: Path) -> None:
    """Pack by task, in the order of the files."""
    groups: dict[str, list[Demonstration]] = {}
    for path in files_in(folder):
        groups.setdefault(path.name.partition("-")[0], []).append(read(path))
    for name, demos in groups.items():
        pack(demos, FOLDER / f"{name}{SUFFIX}")
        print(f"{name}: {len(demos)} demonstrations, {(FOLDER / f'{name}{SUFFIX}').stat().st_size:,} bytes")


def sweeps() -> None:
    """50 of each body, in scenes that are neither of the test nor of the dev split."""
    for body in task_spec("SweepToTop").bodies:
        demos = [demonstrate("SweepToTop", "Layout", FIRST + number, body=body) for number in range(COUNT)]
        path = FOLDER / f"SweepToTop{'' if body == GRIPPER else f'-{body}'}{SUFFIX}"
        pack(demos, path)
        print(f"{path.name}: {len(demos)} demonstrations, {path.stat().st_size:,} bytes")


if __name__ == "__main__":
    sweeps() if sys.argv[1] == "--sweeps" else main(Path(sys.argv[1]))
