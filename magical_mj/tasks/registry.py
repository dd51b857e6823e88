"""All tasks, variants and environments by name, their scenes and their scores.

Tasks of other packages are announced by entry points, or given by reference as ``"package.module:SPEC"``.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import fields
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import Any, Final, cast

import numpy as np

from magical_mj.scene import Scene, check_scene_type
from magical_mj.scene.bodies import GRIPPER
from magical_mj.scene.geometry import check_scene
from magical_mj.tasks import KNOWN, RULES, SPECS, Rules, TaskSpec
from magical_mj.utils.errors import (
    InvalidSceneError,
    MagicalError,
    SettingsError,
    TaskError,
    UnknownNameError,
    UntrustedNameError,
    check_name,
    short_repr,
    unknown_name,
)
from magical_mj.utils.imports import (
    errors_of_task,
    is_reference,
    place,
    resolve,
    resolve_installed,
    source_of,
    with_place,
)
from magical_mj.variants import VARIANTS as _VARIANTS
from magical_mj.variants import Axis, variants_of, varied_axes, vary
from magical_mj.variants.rules import is_task_name

_REGION_TOLERANCE: Final = 1e-6
"""A scene read from the simulation may differ from the original one by rounding, up to this (world units)."""

TASKS: Final[tuple[str, ...]] = tuple(SPECS)
"""The benchmark's tasks in the paper's order. "all" means these; tasks of other packages must be named."""

VARIANTS: Final[tuple[str, ...]] = tuple(_VARIANTS)
"""The variants: Demo, then the paper's test variants in its order."""

Pair = tuple[str, str]
"""A task and a variant, which name an environment."""

ENVIRONMENTS: Final[tuple[Pair, ...]] = tuple(
    (task, variant) for task, spec in SPECS.items() for variant in variants_of(spec)
)
"""All (task, variant) pairs of the benchmark; which exist follows from the axes that each task supports."""


SPLITS: Final = {"test": 0, "dev": 10_000_000}
"""Split -> the seed of its first scene. Scores are reported on "test", from seed 0 on; "dev" is for looking and tuning.

Poses, counts and dynamics of dev scenes are never those of test scenes. Variants that draw from few scenes, such as the
four of MoveToCorner-Colour, have the same ones in both."""

Names = str | Iterable[str]
"""Names as a list, or as one string separated by commas; "all" stands for all of them."""

GROUP: Final = "magical_mj.tasks"
"""The entry-point group in which installed packages announce tasks, such as ``PushOut = "push_out:SPEC"``."""
DRAWS: Final = 3
"""How often each variant's first scene is drawn again, to see whether it is always the same."""
_CHECKED: Final[dict[str, TaskSpec]] = {}
"""The last task that was checked for each name and reference."""


def task_spec(task: str) -> TaskSpec:
    """The definition of a task.

    Args:
        task: one of `TASKS`, or of another suite, a task that an installed package announces, or
            ``"package.module:SPEC"``.

    Raises:
        UnknownNameError: if there is no such task.
        TaskError: if it is the task of another package, and cannot be played.
    """
    if isinstance(task, str) and task in KNOWN:
        return KNOWN[task]
    if isinstance(task, str) and (task in task_plugins() or is_reference(task)):
        return load_spec(task)
    raise unknown_name("task", task, (*KNOWN, *task_plugins(), "package.module:SPEC"))


def task_name(task: str) -> str:
    """The name under which results of a task are stored: a reference to a named task becomes its name.

    Raises:
        UnknownNameError: if there is no such task.
        TaskError: if it is the task of another package, and cannot be played.
    """
    spec = task_spec(task)
    known = spec.name in KNOWN or spec.name in task_plugins()
    return spec.name if known and task_spec(spec.name) is spec else task


def variant_name(variant: str) -> str:
    """The variant's name; ``"TestAll"``, as in the ids, is accepted for ``"All"``.

    Raises:
        UnknownNameError: if there is no such variant.
    """
    name = variant.removeprefix("Test") if isinstance(variant, str) and variant != "TestDemo" else ""
    if name not in VARIANTS:
        raise unknown_name("variant", variant, VARIANTS)
    return name


def environment_axes(task: str, variant: str) -> tuple[Axis, ...]:
    """The axes along which the environment's scenes vary, such as ``("layout", "colour", "dynamics")``.

    Raises:
        UnknownNameError: if there is no such task or variant, or the task does not have this variant.
    """
    return varied_axes(task_spec(task), variant_name(variant))


def environments(tasks: Names = "all", variants: Names = "all") -> list[Pair]:
    """The existing (task, variant) pairs of these tasks and variants: first the benchmark's in its order, then others.

    Args:
        tasks: names that `task_spec` accepts; "all" is `TASKS`.
        variants: names that `variant_name` accepts; "all" is `VARIANTS`.

    Raises:
        SettingsError: if no name is given.
        UnknownNameError: if a name is unknown, or none of the pairs exists.
        TaskError: if the task of another package cannot be played.
    """
    chosen = in_order(task_name(task) for task in listed(tasks, TASKS))
    wanted = [variant_name(variant) for variant in listed(variants, VARIANTS)]
    pairs = [(task, variant) for task in chosen for variant in variants_of(task_spec(task)) if variant in wanted]
    if not pairs:
        environment_axes(chosen[0], wanted[0])  # says which variants the task has
    return pairs


def in_order(tasks: Iterable[str]) -> list[str]:
    """The tasks without duplicates in the order of tables: the benchmark's in its order, then others as given."""
    rank = {task: index for index, task in enumerate(TASKS)}
    return sorted(dict.fromkeys(tasks), key=lambda task: rank.get(task, len(rank)))


def listed(names: Names, every: Iterable[str]) -> list[str]:
    """The names as a list; they may be given as a list or separated by commas, and "all" stands for `every` one.

    Raises:
        SettingsError: if no name is given.
    """
    if isinstance(names, str):
        names = names.split(",")
    try:
        entries = [name.strip() if isinstance(name, str) else name for name in names]
    except TypeError:  # also of arrays without a dimension, which look like sequences
        entries = []
    entries = [name for name in entries if not isinstance(name, str) or name]  # "" is from a comma at the end
    if not entries:
        raise SettingsError(f"give at least one of {', '.join(every)}, or all; not {short_repr(names)}")
    return list(every) if isinstance(entries[0], str) and entries == ["all"] else entries


def check_rules(rules: str) -> Rules:
    """`rules` if it is "paper" or "released".

    Raises:
        UnknownNameError: if it is anything else.
    """
    check_name("set of rules", rules, RULES)
    return cast("Rules", rules)


def sample_scene(task: str, variant: str, seed: int, body: str = GRIPPER) -> Scene:
    """The scene in which an episode with this seed starts: the same on every machine and in every process.

    The scenes of seeds 0 to 99 are those on which the environment is evaluated. With another body of the robot, the
    poses are drawn from the same generators until that body fits.

    Raises:
        SettingsError: if the task is not offered with this body.
        UnknownNameError: if there is no such task or variant, or the task does not have this variant.
        InvalidSeedError: if the seed is not an integer, or negative; any size will do.
        PlacementError: if no legal placement was found (not known to happen in the benchmark).
        TaskError: if the task of another package draws a scene in which it cannot start, or its code raises an error.
    """
    spec, variant = task_spec(task), variant_name(variant)
    spec.check_body(body)
    if spec.name in KNOWN:
        return vary(spec, variant, seed, body)  # known to be right
    with errors_of_task(f"{spec.name}-{variant} cannot be drawn from seed {short_repr(seed)}"):
        scene = vary(spec, variant, seed, body)
        check_drawn(spec, variant, seed, scene)
    return scene


def score(task: str, initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """How well the final scene solves the task, in [0, 1]. It depends on the two scenes only.

    Args:
        task: a task's name.
        initial: the scene at the start; it determines which block belongs where.
        final: the same robot, blocks and regions with the poses at the end.
        rules: "paper", or "released" for the rules of the original's code where it differs.

    Raises:
        UnknownNameError: if there is no such task or set of rules.
        InvalidSceneError: if `initial` is not a scene of the task, or `final` has other blocks or regions.
        SettingsError: if the score of the task depends on more than these scenes.
        TaskError: if the task of another package returns anything but a number in [0, 1], or its code raises an error.
    """
    if task_spec(task).trajectory:
        raise SettingsError(
            f"the score of {task} depends on the scenes of all steps: magical_mj.score_trajectory(task, scenes) takes "
            "these; in an environment it is env.score()"
        )
    return score_trajectory(task, (initial, final), rules)


def score_trajectory(task: str, scenes: Sequence[Scene], rules: Rules = "paper") -> float:
    """The score in [0, 1] of an episode, for every task: most look at its first and its last scene only.

    Args:
        task: a task's name.
        scenes: the initial scene, and the scene after each step.
        rules: "paper", or "released" for the rules of the original's code where it differs.

    Raises:
        UnknownNameError: if there is no such task or set of rules.
        SettingsError: if the scenes are no sequence with at least one scene.
        InvalidSceneError: if the first one is not a scene of the task, or others have other blocks or regions.
        TaskError: if the task of another package returns anything but a number in [0, 1], or its code raises an error.
    """
    spec = task_spec(task)
    rules = check_rules(rules)
    if not isinstance(scenes, list | tuple) or not scenes:
        raise SettingsError(
            f"a trajectory is a list or a tuple of scenes, the first the initial one, not {short_repr(scenes)}"
        )
    for scene in scenes:
        check_scene_type(scene)
    with errors_of_task(f"{spec.name}.check failed"):
        spec.check(scenes[0])
    for scene in scenes[1:] if spec.trajectory else scenes[-1:]:
        _check_same(scenes[0], scene)
    return spec.checked_score(scenes, rules)


def _check_same(initial: Scene, final: Scene) -> None:
    """Raise `InvalidSceneError` unless both scenes have the same blocks (poses may differ) and goal regions."""
    before, after = ([f"{block.colour} {block.shape}" for block in scene.blocks] for scene in (initial, final))
    if before != after:
        raise InvalidSceneError(
            "the final scene must have the initial scene's blocks in the same order, "
            f"which are {', '.join(before) or 'none'}, not {', '.join(after) or 'none'}"
        )
    boxes = [[region.box for region in scene.regions] for scene in (initial, final)]
    colours = [[region.colour for region in scene.regions] for scene in (initial, final)]
    if colours[0] != colours[1] or not np.allclose(*boxes, rtol=0.0, atol=_REGION_TOLERANCE):
        raise InvalidSceneError(
            f"the final scene must have the initial scene's goal regions, {initial.regions}, not {final.regions}"
        )


# Tasks of other packages


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
            spec.checked_score((spec.demo, spec.demo), rules)
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
