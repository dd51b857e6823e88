"""Loads the demonstrations of a task from a folder, or the shipped ones from the package.

All shipped demonstrations of a benchmark's task are in one file, which is two fifths smaller than separate files.

The file is a numpy archive (`*.npz`) compressed by xz. `headers` has a line for each demonstration, with the header of
a separate file. `actions`, `offsets` and `qvel` contain the arrays of all demonstrations. A position is predicted from
the previous one and from the velocities before and after the action. Its offset is the deviation from that prediction,
in units of the last place. Arrays are stored column by column, because successive numbers in a column are similar.
tools/pack_demonstrations.py writes these files.

Those of SweepToTop, set 2 and the graded demonstrations of all tasks are in one file each, as JSON with actions and
without states: loading them plays the actions again. tools/pack_demonstrations.py, tools/diverse_demonstrations.py and
tools/graded_demonstrations.py write them.
"""

from __future__ import annotations

import io
import lzma
import shlex
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, Literal, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from magical_mj.demos.demonstration import Demonstration, files_in, read, unpacked
from magical_mj.demos.stored import Stored
from magical_mj.scene.bodies import GRIPPER
from magical_mj.tasks.registry import task_name, task_spec
from magical_mj.utils.errors import DemonstrationError, MissingFileError, SettingsError, unknown_name

FOLDER: Final = Path(__file__).parent / "data"
DemonstrationSet = Literal[1, 2, "graded"]
SETS: Final[tuple[DemonstrationSet, ...]] = get_args(DemonstrationSet)
FILES: Final[Mapping[DemonstrationSet, Path]] = {
    1: FOLDER / "sweeps.json.xz",
    2: FOLDER / "diverse.json.xz",
    "graded": FOLDER / "graded.json.xz",
}
"""The files of actions: of set 1, only the demonstrations of SweepToTop."""
SAME_SCORE: Final = 0.01
SUFFIX: Final = ".npz.xz"
ARRAYS: Final = ("actions", "offsets", "qvel")
LEAST: Final = 1e-290
"""Smaller numbers become 0 in predictions, because some processes flush subnormal numbers to 0."""


def load(
    task: str,
    folder: Path | str | None = None,
    body: str = GRIPPER,
    *,
    set: DemonstrationSet = 1,  # noqa: A002 - the natural name for users
) -> list[Demonstration]:
    """The demonstrations of a task by one body: the shipped ones, or those in a folder.

    Args:
        task: the task.
        folder: the folder with files ``<Task>-<anything>.npz``. Files in its subfolders, such as one for each player,
            follow them. None: the folder that the task defines, otherwise the shipped demonstrations.
        body: the robot's body in the demonstrations.
        set: 1 for the expert's demonstrations, which protocol 1 uses. 2 for those by demonstrators who differ from each
            other. Both have score 1. "graded" for those with all scores, in ascending order. The last two, and those of
            SweepToTop, are played again, which takes up to some seconds.

    Raises:
        UnknownNameError: for an unknown task or set.
        DemonstrationError: if no demonstrations are found, or a file is damaged.
        SettingsError: without a folder, if the expert cannot solve the task with the body; with one, for another set
            than 1.
    """
    task, spec = task_name(task), task_spec(task)
    if isinstance(set, bool) or not isinstance(set, int | np.integer | str) or set not in SETS:
        raise unknown_name("set of demonstrations", set, map(repr, SETS))
    if set != 1:
        if folder is not None:
            raise SettingsError(f"the demonstrations of set {set} come with the package: leave out the folder")
        if demos := _played(set, task, body):
            return demos
        raise _missing(set, task, body)
    if folder is None:
        spec.check_expert_body(body)
        folder = spec.demonstrations
    if folder is None:
        packed = load_shipped(task, spec.name) if body == GRIPPER else []
        demos = packed or _played(1, task, body)
    else:
        every = (read(path, task, trusted=[body]) for path in files_in(folder, f"{spec.name}-"))
        demos = [demo for demo in every if demo.scene.robot.body == body]
    if not demos:
        raise _none_found(task, folder, body)
    return demos


def _none_found(task: str, folder: Path | str | None, body: str) -> DemonstrationError:
    """The error if a task with a body has no demonstrations, in a folder or in the package."""
    quoted, plan = shlex.quote(task), task_spec(task).plan
    command = f"play {quoted} --record" if plan is None else f"demos generate --tasks {quoted} --out"
    kind = DemonstrationError
    if folder is not None:
        kind, absent = (kind, "") if Path(folder).exists() else (MissingFileError, ", which does not exist")
        where = f"in {folder}{absent}: make some with magical-mj {command} {folder}"
    else:
        where = (
            f"in the package: make some with magical-mj {command} FOLDER, and name this folder, or set "
            "demonstrations=FOLDER in its TaskSpec"
        )
    by = "" if body == GRIPPER else f" with the body {body!r}"
    return kind(f"there are no demonstrations of {task}{by} {where}")


def of_demo_scene(demonstrations: Sequence[Demonstration], origin: str) -> list[Demonstration]:
    """The demonstrations of the demo scene without shifts. Raises a `DemonstrationError` if none is, or one is old."""
    fitting = [demo for demo in demonstrations if demo.variant == "Demo" and not demo.shifts]
    if not fitting:
        raise DemonstrationError(
            f"policies learn from the demo scene, but all demonstrations {origin} are of other scenes: "
            f"{', '.join(sorted({demo.name for demo in demonstrations}))}"
        )
    if old := [str(demo.scene_seed) for demo in fitting if not demo.is_current]:
        raise DemonstrationError(
            f"the demo scene has changed since demonstrations {origin} were made (seed {', '.join(old[:5])}): make "
            "them again"
        )
    return fitting


def set_suffix(which: DemonstrationSet) -> str:
    """The suffix of the names of data sets with this set: "", "-set2" or "-graded"."""
    if which == 1:
        return ""
    return f"-{which}" if isinstance(which, str) else f"-set{which}"


def stored_rows(path: Path) -> list[Stored]:
    """The demonstrations in a file of actions. Empty if it does not exist."""
    content = lzma.decompress(path.read_bytes()) if path.exists() else b"[]"
    return msgspec.json.decode(content, type=list[Stored])


def _missing(which: DemonstrationSet, task: str, body: str) -> DemonstrationError:
    """The error if a set has no demonstrations of the task with the body."""
    others = ", ".join(sorted({row.task for row in stored_rows(FILES[which])}))
    return DemonstrationError(
        f"there are no demonstrations of set {which} of {task} with the body {body!r}: there are 25 of each of "
        f"{others} with the gripper" + ", and of SweepToTop with each of its bodies" * (which == "graded")
    )


def _played(which: DemonstrationSet, task: str, body: str) -> list[Demonstration]:
    """The demonstrations in a file of actions, which are played again. Empty if it has none."""
    rows = [row for row in stored_rows(FILES[which]) if (row.task, row.body) == (task, body)]
    demos = [row.played() for row in rows]
    if changed := sum(abs(demo.score - row.score) > SAME_SCORE for demo, row in zip(demos, rows, strict=True)):
        warnings.warn(
            f"{changed} of {len(demos)} demonstrations of {task} in set {which} have other scores here than where they "
            "were made: MuJoCo's version or the machine differs",
            stacklevel=3,  # the call of `load`
        )
    return demos


def load_shipped(task: str, name: str) -> list[Demonstration]:
    """The shipped demonstrations with this name. Empty if the package contains none.

    Raises a `DemonstrationError` if they belong to another task with the same name.
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


def _positions(offsets: NDArray[np.int64], qvel: NDArray[np.float64]) -> NDArray[np.float64]:
    qpos = np.array(offsets, order="C").view(np.float64)  # the first row contains positions, not offsets
    for step, movement in enumerate(movements(qvel)):
        qpos[step + 1] = (predicted(qpos[step], movement).view(np.int64) + offsets[step + 1]).view(np.float64)
    return qpos


@np.errstate(all="ignore")  # underflow is expected, even if the caller's settings make it an error
def movements(qvel: NDArray[np.float64]) -> NDArray[np.float64]:
    """The change of all coordinates in each step, if their velocities change linearly. Shape (steps, nv)."""
    return _flushed((qvel[:-1] + qvel[1:]) / 16)  # the mean over 1/8 s. Division by a power of two is exact


def predicted(qpos: NDArray[np.float64], movement: NDArray[np.float64]) -> NDArray[np.float64]:
    """The positions after a movement."""
    return _flushed(qpos + movement)


def _flushed(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(np.abs(numbers) < LEAST, 0.0, numbers)
