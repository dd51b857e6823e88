"""Packs a folder of demonstrations for the package, with one file per task. `make demonstrations`.

With ``--sweeps`` instead of a folder, it makes those of SweepToTop in the variant Layout, with all bodies in one file.
"""

from __future__ import annotations

import io
import json
import lzma
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from magical_mj.demos.demonstration import Demonstration, files_in, header_and_arrays, read
from magical_mj.demos.recording import demonstrate
from magical_mj.demos.shipped import ARRAYS, FILES, FOLDER, SUFFIX, movements, predicted
from magical_mj.demos.stored import Stored, as_stored
from magical_mj.tasks.registry import task_spec
from magical_mj.utils import files

FIRST, COUNT = 5_000_000, 50
FILTERS = [{"id": lzma.FILTER_LZMA2, "preset": 9, "lc": 0, "lp": 3, "pb": 3}]
"""Settings of xz for numbers of eight bytes."""


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


def pack_rows(path: Path, kept: Sequence[Stored], demos: Sequence[Demonstration]) -> None:
    """Writes a file of actions: rows that are kept, and others that are added."""
    rows = [*kept, *(as_stored(demo, score=round(demo.score, 4)) for demo in demos)]
    rows.sort(key=lambda row: (row.task, row.body))  # those of a task stay in their order
    content = msgspec.json.format(msgspec.json.encode(rows), indent=0)
    files.write(path, lzma.compress(content, preset=9), overwrite=True)


def pack(demos: Sequence[Demonstration], path: Path) -> None:
    """Writes demonstrations of one scene to a file for `load_shipped`. An existing file is replaced."""
    headers = [header_and_arrays(demo)[0] for demo in demos]
    arrays = [(demo.actions, _offsets(demo.qpos, demo.qvel), demo.qvel) for demo in demos]
    content = io.BytesIO()
    np.savez(
        content,
        allow_pickle=False,
        headers=np.frombuffer("\n".join(map(json.dumps, headers)).encode(), np.uint8),
        lengths=np.array([len(demo.actions) for demo in demos]),
        **{name: np.asfortranarray(np.concatenate(parts)) for name, *parts in zip(ARRAYS, *arrays, strict=True)},
    )
    files.write(path, lzma.compress(content.getvalue(), filters=FILTERS), overwrite=True)


def _offsets(qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> NDArray[np.int64]:
    expected = np.zeros_like(qpos)
    expected[1:] = predicted(qpos[:-1], movements(qvel))
    return np.ascontiguousarray(qpos).view(np.int64) - expected.view(np.int64)


if __name__ == "__main__":
    sweeps() if sys.argv[1] == "--sweeps" else main(Path(sys.argv[1]))
