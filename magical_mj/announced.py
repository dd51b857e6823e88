"""Tasks of other packages: announced by entry points, or given by reference as ``"package.module:SPEC"``."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from traceback import extract_tb
from types import MappingProxyType
from typing import Any, Final

from magical_mj.errors import InvalidSceneError, TaskError, UnknownNameError, shown
from magical_mj.geometry import check_scene
from magical_mj.references import resolve
from magical_mj.tasks import RULES, SPECS, TaskSpec

GROUP: Final = "magical_mj.tasks"
"""The entry-point group in which installed packages announce tasks, such as ``PushOut = "push_out:SPEC"``."""


@cache
def announced() -> Mapping[str, EntryPoint]:
    """The entry points of announced tasks by the tasks' names; their modules are imported on first use."""
    found: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=GROUP)):
        if point.name in (*SPECS, *found) and found.get(point.name) != point:
            warnings.warn(
                f"the task {point.name!r} ({point.value}) is ignored: another task has that name", stacklevel=2
            )
        else:
            found[point.name] = point
    return MappingProxyType(found)


@cache
def load_spec(task: str) -> TaskSpec:
    """The task with this announced name or reference; it is checked once.

    Raises:
        UnknownNameError: if its module or the object in it does not exist.
        TaskError: if its module fails when it is imported, or the object is not a valid task.
    """
    point = announced().get(task)
    try:
        spec = resolve(task if point is None else point.value)
    except ImportError as error:
        raise UnknownNameError(f"the task {shown(task)} cannot be imported: {error}") from error
    except (Exception, SystemExit) as error:
        place = extract_tb(error.__traceback__)[-1]
        where = "" if isinstance(error, SyntaxError) else f" ({place.filename}, line {place.lineno})"
        what = f"{type(error).__name__}: {error}{where}"
        raise TaskError(f"the task {shown(task)} cannot be imported: {what}") from error
    check_spec(spec, task)
    if point is not None and spec.name != task:
        raise TaskError(f"{point.value} is announced as {task!r}, but its name is {spec.name!r}: they must be the same")
    if spec.name in SPECS and SPECS[spec.name] is not spec:
        raise TaskError(f"{task} is called {spec.name!r}, as a task of the benchmark is: give it a name of its own")
    return spec


def check_spec(spec: Any, task: str) -> None:
    """Raise `TaskError` unless `spec` is a valid task: its demo scene is legal and has a score.

    Args:
        spec: the object that was found.
        task: the name or reference by which the user asked for it.
    """
    if not isinstance(spec, TaskSpec):
        raise TaskError(f"{task} is not a magical_mj.tasks.TaskSpec but {shown(spec)}")
    try:
        check_scene(spec.demo)
        spec.check(spec.demo)
    except InvalidSceneError as error:
        raise TaskError(f"no episode of {task} can start in its own demo scene: {error}") from error
    for rules in RULES:
        score = spec.score(spec.demo, spec.demo, rules)
        if not isinstance(score, int | float) or not 0.0 <= score <= 1.0:
            raise TaskError(f"the score of {task} must be in [0, 1]; in its demo scene it is {shown(score)}")
