"""Packs a folder of demonstrations for the package, with one file per task. `make demonstrations`.

With ``--sweeps`` instead of a folder, it makes those of SweepToTop in the variant Layout, with all bodies in one file.
"""

from __future__ import annotations

import sys
from pathlib import Path

from magical_mj.demos.demonstration import Demonstration, files_in, read
from magical_mj.demos.recording import demonstrate
from magical_mj.demos.shipped import FILES, FOLDER, SUFFIX, pack, pack_rows
from magical_mj.tasks.registry import task_spec

FIRST, COUNT = 5_000_000, 50


def main(folder: Path) -> None:
    """Packs the demonstrations of each task into a file, in the order of the folder's files."""
    groups: dict[str, list[Demonstration]] = {}
    for path in files_in(folder):
        groups.setdefault(path.name.partition("-")[0], []).append(read(path))
    for name, demos in groups.items():
        pack(demos, FOLDER / f"{name}{SUFFIX}")
        print(f"{name}: {len(demos)} demonstrations, {(FOLDER / f'{name}{SUFFIX}').stat().st_size:,} bytes")


def sweeps() -> None:
    """Makes 50 demonstrations with each body, in scenes that are neither in the test nor in the dev split."""
    demos = [
        demonstrate("SweepToTop", "Layout", FIRST + number, body=body)
        for body in task_spec("SweepToTop").bodies
        for number in range(COUNT)
    ]
    pack_rows(FILES[1], [], demos)
    print(f"SweepToTop: {len(demos)} demonstrations, {FILES[1].stat().st_size:,} bytes")


if __name__ == "__main__":
    sweeps() if sys.argv[1] == "--sweeps" else main(Path(sys.argv[1]))
