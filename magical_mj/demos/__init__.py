"""Demonstrations: the shipped ones, your own files, and their conversion for learners and other tools.

Example:
    >>> demos = magical_mj.demos.load("FindDupe")  # 25 by the expert, all with score 1
    >>> observations, actions = magical_mj.demos.transitions(demos, "LoRes4E")  # (n, 96, 96, 12) uint8, (n,) uint8
"""

from __future__ import annotations

from pathlib import Path

from magical_mj.demos.demonstration import Demonstration, files_in, keep, read, write
from magical_mj.demos.export.archives import to_npz
from magical_mj.demos.export.minari import to_minari
from magical_mj.demos.learning import Transitions, observations, stream, transitions
from magical_mj.demos.recording import (
    MAX_BYTES,
    Diversity,
    Imported,
    Recorder,
    Verdict,
    demonstrate,
    diversity,
    from_recording,
    recorded,
    render_demo,
    verify,
)
from magical_mj.demos.shipped import load_shipped
from magical_mj.scene.bodies import GRIPPER
from magical_mj.tasks.registry import task_name, task_spec
from magical_mj.utils.errors import DemonstrationError

__all__ = [
    "MAX_BYTES",
    "Demonstration",
    "Diversity",
    "Imported",
    "Recorder",
    "Transitions",
    "Verdict",
    "demonstrate",
    "diversity",
    "files_in",
    "from_recording",
    "keep",
    "load",
    "observations",
    "read",
    "recorded",
    "render_demo",
    "stream",
    "to_minari",
    "to_npz",
    "transitions",
    "verify",
    "write",
]


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
    demos = [demo for demo in (read(path, task) for path in paths) if demo.scene.robot.body == body]
    if demos:
        return demos
    command = f"play {task} --record" if spec.plan is None else f"demos generate --tasks {task} --out"
    where = f"in {folder}; to make some: magical-mj {command} {folder}"
    if folder is None:
        where = f"here: name a folder in its TaskSpec (demonstrations=...), and fill it: magical-mj {command} FOLDER"
    by = "" if body == GRIPPER else f" with the body {body!r}"
    raise DemonstrationError(f"there are no demonstrations of {task}{by} {where}")
