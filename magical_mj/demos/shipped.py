"""The demonstrations of a task: those in a folder, or those that come with the package.

The latter are all of a task in one file, which is two fifths smaller than single files.

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

from magical_mj.demos.demonstration import Demonstration, files_in, header_and_arrays, read, unpacked
from magical_mj.scene.bodies import GRIPPER
from magical_mj.tasks.registry import task_name, task_spec
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError

FOLDER: Final = Path(__file__).parent / "data"
SUFFIX: Final = ".npz.xz"
FILTERS: Final[Sequence[dict[str, Any]]] = ({"id": lzma.FILTER_LZMA2, "preset": 9, "lc": 0, "lp": 3, "pb": 3},)
"""For numbers of eight bytes."""
ARRAYS: Final = ("actions", "offsets", "qvel")
LEAST: Final = 1e-290
"""Smaller numbers count as 0 in predicted positions, since processes may be set to treat subnormal ones so."""


def load(task: str, folder: Path | str | None = None, body: str = GRIPPER) -> list[Demonstration]:
    """The demonstrations that come with a task, or those in a folder: its files ``<Task>-<anything>.npz``; by one body.

    Those in its subfolders, such as one for each player, come after them.

    Raises:
        UnknownNameError: if there is no such task.
        DemonstrationError: if there are none, or a file is damaged.
        SettingsError: if the task is not offered with the body.
    """
    task, spec = task_name(task), task_spec(task)
    folder = spec.demonstrations if folder is None else folder
    spec.check_body(body)
    if folder is None and (demos := load_shipped(task, spec.name if body == GRIPPER else f"{spec.name}-{body}")):
        return demos
    paths = [] if folder is None else files_in(folder, f"{spec.name}-")
    demos = [demo for demo in (read(path, task, trusted=[body]) for path in paths) if demo.scene.robot.body == body]
    if demos:
        return demos
    command = f"play {task} --record" if spec.plan is None else f"demos generate --tasks {task} --out"
    where = f"in {folder}; to make some: magical-mj {command} {folder}"
    if folder is None:
        where = f"here: name a folder in its TaskSpec (demonstrations=...), and fill it: magical-mj {command} FOLDER"
    by = "" if body == GRIPPER else f" with the body {body!r}"
    raise DemonstrationError(f"there are no demonstrations of {task}{by} {where}")


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
