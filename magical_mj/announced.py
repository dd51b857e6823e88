"""Tasks of other packages: announced by entry points, or given by reference as ``"package.module:SPEC"``."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from traceback import extract_tb
from types import MappingProxyType
from typing import Any, Final

from magical_mj.errors import InvalidSceneError, MagicalError, TaskError, UnknownNameError, shown
from magical_mj.geometry import check_scene
from magical_mj.references import resolve
from magical_mj.scene import Scene
from magical_mj.tasks import RULES, SPECS, TaskSpec
from magical_mj.variants import variants_of, vary

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
        raise TaskError(f"the task {shown(task)} cannot be imported: {_with_place(error)}") from error
    check_spec(spec, task)
    if point is not None and spec.name != task:
        raise TaskError(f"{point.value} is announced as {task!r}, but its name is {spec.name!r}: they must be the same")
    if spec.name in SPECS and SPECS[spec.name] is not spec:
        raise TaskError(f"{task} is called {spec.name!r}, as a task of the benchmark is: give it a name of its own")
    return spec


def check_spec(spec: Any, task: str) -> None:
    """Raise `TaskError` unless `spec` is a valid task: its demo scene is legal, and every variant can be drawn.

    Args:
        spec: the object that was found.
        task: the name or reference by which the user asked for it.
    """
    if not isinstance(spec, TaskSpec):
        raise TaskError(f"{task} is not a magical_mj.tasks.TaskSpec but {shown(spec)}")
    try:
        check_drawn(spec, "Demo", 0, spec.demo)
        checked: Any = spec.check(spec.demo)
        if checked is not None:
            raise TaskError(f"{spec.name}.check must raise InvalidSceneError or return None, not {shown(checked)}")
        for rules in RULES:
            spec.checked_score(spec.demo, spec.demo, rules)
        for variant in variants_of(spec):
            check_drawn(spec, variant, 0, vary(spec, variant, 0))
    except TaskError:
        raise
    except MagicalError as error:
        raise TaskError(f"{task} cannot be played: {error}") from error
    except Exception as error:
        raise TaskError(f"{task} cannot be played: {_with_place(error)}") from error


def check_drawn(spec: TaskSpec, variant: str, seed: int, scene: Scene) -> None:
    """Raise `TaskError` unless an episode can start in the scene that was drawn from this seed."""
    try:
        check_scene(scene)
        spec.check(scene)
    except InvalidSceneError as error:
        drawn = "its own demo scene" if variant == "Demo" else f"the scene of {variant} that seed {seed} draws"
        raise TaskError(f"no episode of {spec.name} can start in {drawn}: {error}") from error


def _with_place(error: BaseException) -> str:
    """The error's type, message and place in the user's files."""
    place = extract_tb(error.__traceback__)[-1]
    where = "" if isinstance(error, SyntaxError) else f" ({place.filename}, line {place.lineno})"
    return f"{type(error).__name__}: {error}{where}"
