"""Tasks of other packages: announced by entry points, or given by reference as ``"package.module:SPEC"``."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import Any, Final

from magical_mj.scene import Scene
from magical_mj.scene.geometry import check_scene
from magical_mj.tasks import KNOWN, RULES, SPECS, TaskSpec
from magical_mj.utils.errors import (
    InvalidSceneError,
    MagicalError,
    TaskError,
    UnknownNameError,
    UntrustedNameError,
    short_repr,
)
from magical_mj.utils.imports import is_reference, place, resolve, resolve_installed, source_of, with_place
from magical_mj.variants import variants_of, vary
from magical_mj.variants.rules import is_task_name

GROUP: Final = "magical_mj.tasks"
"""The entry-point group in which installed packages announce tasks, such as ``PushOut = "push_out:SPEC"``."""
DRAWS: Final = 3
"""How often each variant's first scene is drawn again, to see whether it is always the same."""
_CHECKED: Final[dict[str, TaskSpec]] = {}
"""The last task that was checked for each name and reference."""


def announced(
    noun: str, group: str, taken: Collection[str], is_name: Callable[[str], bool], example: str
) -> Mapping[str, EntryPoint]:
    """The entry points of a group by name, but for names that are `taken`; their modules are imported on first use.

    An invalid one is ignored with a warning, since it must not keep anybody from importing this package.
    """
    plugins: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=group)):
        if point.name in taken or plugins.get(point.name, point) != point:
            problem = f"another {noun} has that name"
        elif not is_name(point.name):
            problem = f"the name of a {noun} must be made of letters and digits"
        elif not is_reference(reference_of(point)):
            problem = f"announce an object in a module, as in {example}"
        else:
            plugins[point.name] = point
            continue
        warnings.warn(f"the {noun} {point.name!r} ({point.value}) is ignored: {problem}", stacklevel=3)
    return MappingProxyType(plugins)


def imported(noun: str, name: str, point: EntryPoint | None, failed: type[MagicalError]) -> Any:
    """The object of an entry point, or the one that is named; an `UnknownNameError`, or `failed`, if there is none."""
    try:
        return resolve(name) if point is None else resolve_installed(reference_of(point))
    except UntrustedNameError:
        raise
    except (Exception, SystemExit) as error:
        why, kind = (error, UnknownNameError) if isinstance(error, ImportError) else (with_place(error), failed)
        raise kind(f"the {noun} {short_repr(name)} cannot be imported: {why}") from error


def reference_of(point: EntryPoint) -> str:
    """What an entry point refers to, without the spaces that Python allows there."""
    return "".join(point.value.split())


@cache
def task_plugins() -> Mapping[str, EntryPoint]:
    """The entry points of announced tasks by the tasks' names."""
    return announced("task", GROUP, KNOWN, is_task_name, 'PushOut = "push_out:SPEC"')


def announced_name(task: str) -> str:
    """The name under which a package announces the task with this reference; any other `task` is returned as it is."""
    return next((name for name, point in task_plugins().items() if reference_of(point) == task), task)


def load_spec(task: str) -> TaskSpec:
    """The task with this announced name or reference; it is checked when it is new, as after `importlib.reload`.

    Raises:
        UnknownNameError: if its module or the object in it does not exist.
        UntrustedNameError: if a file names it, and the command does not.
        TaskError: if its module fails when it is imported, or the object is not a valid task.
    """
    point = task_plugins().get(task)
    spec = imported("task", task, point, TaskError)
    if _CHECKED.get(task) is spec:
        return spec
    check_spec(spec, task)
    if point is not None and spec.name != task:
        raise TaskError(f"{point.value} is announced as {task!r}, but its name is {spec.name!r}: they must be the same")
    if spec.name in KNOWN and KNOWN[spec.name] is not spec:
        raise TaskError(f"{task} is called {spec.name!r}, as a task of the benchmark is: give it a name of its own")
    _CHECKED[task] = spec
    return spec


def code_digest(task: str) -> str:
    """A hash of the modules that define this task: the one that is named, and those of the task's functions."""
    point, spec = task_plugins().get(task), load_spec(task)
    functions = (getattr(spec, field.name) for field in fields(spec))
    names = {getattr(function, "__module__", None) for function in functions if callable(function)}
    sources = {source_of(str(name)) for name in (task if point is None else reference_of(point), *names)}
    return hashlib.sha256(b"\0".join(sorted(source.read_bytes() for source in sources if source))).hexdigest()


def check_spec(spec: Any, task: str) -> None:
    """Raise `TaskError` unless `spec` is a valid task: its demo scene is legal, and every variant can be drawn again.

    Args:
        spec: the object that was found.
        task: the name or reference by which the user asked for it.
    """
    if not isinstance(spec, TaskSpec):
        raise TaskError(f"{task} is not a magical_mj.tasks.TaskSpec but {short_repr(spec)}")
    if spec.like and spec.like not in SPECS:
        raise TaskError(f"{spec.name}.like must be one of {', '.join(SPECS)}, not {short_repr(spec.like)}")
    try:
        check_drawn(spec, "Demo", 0, spec.demo)
        checked: Any = spec.check(spec.demo)
        if checked is not None:
            raise TaskError(f"{spec.name}.check must raise InvalidSceneError or return None, not {short_repr(checked)}")
        for rules in RULES:
            spec.checked_score(spec.demo, spec.demo, rules)
        for variant in variants_of(spec):
            drawn = vary(spec, variant, 0)
            check_drawn(spec, variant, 0, drawn)
            if any(vary(spec, variant, 0) != drawn for _ in range(DRAWS)):
                raise TaskError(
                    f"{spec.name}-{variant} draws different scenes for one seed: its rules must use no random numbers "
                    "except those of the generator that they are given"
                )
    except TaskError:
        raise
    except MagicalError as error:
        raise TaskError(f"{task} cannot be played: {error}{place(error)}") from error
    except Exception as error:
        raise TaskError(f"{task} cannot be played: {with_place(error)}") from error


def check_drawn(spec: TaskSpec, variant: str, seed: int, scene: Scene) -> None:
    """Raise `TaskError` unless an episode can start in the scene that was drawn from this seed."""
    try:
        check_scene(scene)
        spec.check(scene)
    except InvalidSceneError as error:
        drawn = "its own demo scene" if variant == "Demo" else f"the scene of {variant} that seed {seed} draws"
        raise TaskError(f"no episode of {spec.name} can start in {drawn}: {error}") from error
