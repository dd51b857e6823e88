"""The demonstrations that come with the package, all of a task in one file: two fifths smaller than as single files.

Such a file is a numpy archive (`*.npz`) compressed by xz: `headers`, as in the files of single demonstrations, one a
line, and for all of them together `actions`, `offsets` and `qvel`. Offsets say how far the positions are from where
the velocities before and after each action lead, in units of the last place. Numbers are stored column by column, since
what follows a number there resembles it. tools/pack_demonstrations.py makes these files.
"""

from __future__ import annotations

import io
import json
import lzma
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.demos.demonstration import Demonstration, packed, unpacked
from magical_mj.utils import files

FOLDER: Final = Path(__file__).parent / "data"
SUFFIX: Final = ".npz.xz"
FILTERS: Final[Sequence[dict[str, Any]]] = ({"id": lzma.FILTER_LZMA2, "preset": 9, "lc": 0, "lp": 3, "pb": 3},)
"""For numbers of eight bytes."""
ARRAYS: Final = ("actions", "offsets", "qvel")
LEAST: Final = 1e-290
"""Smaller numbers count as 0 in predicted positions, since processes may be set to treat subnormal ones so."""


def load_shipped(task: str, name: str) -> list[Demonstration]:
    """The demonstrations of a task with this name; empty if none come with the package.

    Raises a `DemonstrationError` if they are those of another task that has the same name.
    """
    path = FOLDER / f"{name}{SUFFIX}"
    if not path.exists():
        return []
    with np.load(io.BytesIO(lzma.decompress(path.read_bytes()))) as archive:
        headers, actions, offsets, qvel = (archive[part] for part in ("headers", *ARRAYS))
        lengths = archive["lengths"].tolist()
    demos, start = [], 0
    for number, (text, length) in enumerate(zip(headers.tobytes().splitlines(), lengths, strict=True)):
        steps, states = slice(start, start + length), slice(start + number, start + number + length + 1)
        speeds = qvel[states]
        parts = {"actions": actions[steps], "qpos": _positions(offsets[states], speeds), "qvel": speeds}
        arrays = {part: np.ascontiguousarray(rows) for part, rows in parts.items()}
        demos.append(unpacked(path, text, arrays, task))
        start += length
    return demos


def pack(demos: Sequence[Demonstration], path: Path) -> None:
    """Writes demonstrations of one scene to a file that `load_shipped` reads, over the present one."""
    headers = [packed(demo)[0] for demo in demos]
    arrays = [(demo.actions, _offsets(demo.qpos, demo.qvel), demo.qvel) for demo in demos]
    content = io.BytesIO()
    np.savez(
        content,
        allow_pickle=False,
        headers=np.frombuffer("\n".join(map(json.dumps, headers)).encode(), np.uint8),
        lengths=np.array([len(demo.actions) for demo in demos]),
        **{name: np.asfortranarray(np.concatenate(parts)) for name, *parts in zip(ARRAYS, *arrays, strict=True)},
    )
    files.write(path, lzma.compress(content.getvalue(), filters=list(FILTERS)), overwrite=True)


def _offsets(qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> NDArray[np.int64]:
    foretold = np.zeros_like(qpos)
    foretold[1:] = _flushed(qpos[:-1] + _ways(qvel))
    return np.ascontiguousarray(qpos).view(np.int64) - foretold.view(np.int64)


def _positions(offsets: NDArray[np.int64], qvel: NDArray[np.float64]) -> NDArray[np.float64]:
    qpos = np.array(offsets, order="C").view(np.float64)  # those before the first action
    for step, way in enumerate(_ways(qvel)):
        foretold = _flushed(qpos[step] + way)
        qpos[step + 1] = (foretold.view(np.int64) + offsets[step + 1]).view(np.float64)
    return qpos


@np.errstate(all="ignore")  # numbers may be too small, whatever the caller wants of those
def _ways(qvel: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far all coordinates move in each step, if their velocities change evenly: shape (steps, nv)."""
    return _flushed((qvel[:-1] + qvel[1:]) / 16)  # steps of 1/8 s; a power of two, so that every machine gets the same


def _flushed(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(np.abs(numbers) < LEAST, 0.0, numbers)
