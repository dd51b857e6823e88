"""Packs a folder of demonstrations into those that come with the package, one file a task. `make demonstrations`."""

from __future__ import annotations

import sys
from pathlib import Path

from magical_mj.demos.demonstration import Demonstration, files_in, read
from magical_mj.demos.shipped import FOLDER, SUFFIX, pack


def main(folder: Path) -> None:
    """Pack by task, in the order of the files."""
    groups: dict[str, list[Demonstration]] = {}
    for path in files_in(folder):
        groups.setdefault(path.name.partition("-")[0], []).append(read(path))
    for name, demos in groups.items():
        pack(demos, FOLDER / f"{name}{SUFFIX}")
        print(f"{name}: {len(demos)} demonstrations, {(FOLDER / f'{name}{SUFFIX}').stat().st_size:,} bytes")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
