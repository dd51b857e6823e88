"""The demonstrations that come with the package, all of a task in one file: a third smaller than as single files.

Such a file is a numpy archive (`*.npz`) compressed by xz: `headers`, as in the files of single demonstrations, one a
line, and for all of them together `actions`, `qpos` and `qvel`. The latter two are stored column by column, since what
follows a number there resembles it. tools/pack_demonstrations.py makes them.
"""

from __future__ import annotations

import io
import json
import lzma
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from magical_mj.demos.demonstration import ARRAYS, Demonstration, packed, unpacked
from magical_mj.utils import files

FOLDER: Final = Path(__file__).parent / "data"
SUFFIX: Final = ".npz.xz"
FILTERS: Final[Sequence[dict[str, Any]]] = ({"id": lzma.FILTER_LZMA2, "preset": 9, "lc": 0, "lp": 3, "pb": 3},)
"""For numbers of eight bytes."""


def load_shipped(task: str, name: str) -> list[Demonstration]:
    """The demonstrations of a task with this name; empty if none come with the package.

    Raises:
        DemonstrationError: if they are those of another task that has the same name.
    """
    path = FOLDER / f"{name}{SUFFIX}"
    if not path.exists():
        return []
    with np.load(io.BytesIO(lzma.decompress(path.read_bytes()))) as archive:
        headers, actions, qpos, qvel = (archive[part] for part in ("headers", *ARRAYS))
        lengths = archive["lengths"].tolist()
    demos, start = [], 0
    for number, (text, length) in enumerate(zip(headers.tobytes().splitlines(), lengths, strict=True)):
        steps, states = slice(start, start + length), slice(start + number, start + number + length + 1)
        parts = {"actions": actions[steps], "qpos": qpos[states], "qvel": qvel[states]}
        arrays = {part: np.ascontiguousarray(rows) for part, rows in parts.items()}
        demos.append(unpacked(path, text, arrays, task))
        start += length
    return demos


def pack(demos: Sequence[Demonstration], path: Path) -> None:
    """Writes demonstrations of one scene to a file that `load_shipped` reads, over the present one."""
    headers, arrays = zip(*map(packed, demos), strict=True)
    content = io.BytesIO()
    np.savez(
        content,
        allow_pickle=False,
        headers=np.frombuffer("\n".join(map(json.dumps, headers)).encode(), np.uint8),
        lengths=np.array([len(demo.actions) for demo in demos]),
        **{name: np.asfortranarray(np.concatenate([parts[name] for parts in arrays])) for name in ARRAYS},
    )
    files.write(path, lzma.compress(content.getvalue(), filters=list(FILTERS)), overwrite=True)
