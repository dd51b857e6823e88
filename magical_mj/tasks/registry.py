"""All tasks, variants and environments by name, their scenes and their scores.

Tasks of other packages are announced by entry points, or given as a reference ``"package.module:SPEC"``. Names with the
prefix of a language, such as ``"intent:in(colour=red, region)"``, are texts that describe tasks.
"""

from __future__ import annotations

import hashlib
import re
import warnings
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import fields
from functools import cache
from importlib.metadata import EntryPoint
from typing import Any, Final, cast

from magical_mj.scene import Scene, check_same_objects, check_scene_type
from magical_mj.scene.bodies import GRIPPER, check_body_name
from magical_mj.scene.geometry import check_scene
from magical_mj.tasks import KNOWN, RULES, SPECS, Rules, TaskSpec
from magical_mj.tasks.languages import canonical_name, in_language, language_spec, languages, members
from magical_mj.utils import imports
from magical_mj.utils.errors import (
    InvalidSceneError,
    MagicalError,
    SettingsError,
    TaskError,
    UnknownNameError,
    check_name,
    short_repr,
    unknown_name,
)
from magical_mj.variants import OTHER_VARIANTS, Axis, check_seed, varied_axes, vary
from magical_mj.variants import VARIANTS as _VARIANTS
from magical_mj.variants.placement import contact
from magical_mj.variants.rules import is_task_name

TASKS: Final[tuple[str, ...]] = tuple(SPECS)
"""The benchmark's tasks in the paper's order. "all" means these; tasks of other packages must be named."""

VARIANTS: Final[tuple[str, ...]] = tuple(_VARIANTS)
"""The variants: Demo, then the paper's test variants in its order."""

EVERY_VARIANT: Final[tuple[str, ...]] = (*VARIANTS, *OTHER_VARIANTS)
"""The variants, and those beyond the paper's, which some tasks have."""

Pair = tuple[str, str]
"""A task and a variant, which name an environment."""

ENVIRONMENTS: Final[tuple[Pair, ...]] = tuple(
    (task, variant) for task, spec in SPECS.items() for variant in spec.variants
)
"""All (task, variant) pairs of the benchmark. They follow from the axes that each task supports."""


SPLITS: Final = {"test": 0, "dev": 10_000_000, "fresh": 20_000_000}
"""Split -> the seed of its first scene. Scores are reported on "test", from seed 0 on. "dev" is for inspection and
tuning. "fresh" is to confirm a score in scenes that nobody knew: none of them was played before 28 November 2026.

Poses, counts and dynamics of dev scenes never equal those of test scenes. Variants with few different scenes, such as
the four of MoveToCorner-Colour, have the same scenes in both."""


def split_of(seed: int) -> str:
    """The split that contains the scene of a seed."""
    return max((first, name) for name, first in SPLITS.items() if first <= seed)[1]


Names = str | Iterable[str]
"""Names as a list, or as one string separated by commas. "all" means all of them."""

ENTRY_POINTS: Final = "magical_mj.tasks"
"""The entry-point group for tasks of installed packages, such as ``PushOut = "push_out:SPEC"``."""
_SPEC: Final = re.compile(r"^(\w+)\b[^=\n]*= *(?:\w+\.)*(?:TaskSpec|replace)\(", re.MULTILINE)
"""Matches the definition of a task in the source of a module. Group 1 is the name of the object."""
_COMMA: Final = re.compile(r",(?![^(\[]*[)\]])")
"""A comma that is not in brackets."""
DRAWS: Final = 3
"""The number of draws of each variant's first scene, to check that they are equal."""
_CHECKED: Final[dict[str, TaskSpec]] = {}
"""Name or reference -> the last checked task."""


def task_spec(task: str) -> TaskSpec:
    """The definition of a task.

    Args:
        task: one of `TASKS`, a task of another suite, a task that an installed package announces,
            ``"package.module:SPEC"``, or a text of a language, such as ``"intent:in(colour=red, region)"``.

    Raises:
        UnknownNameError: if the task does not exist.
        TaskError: if the task of another package is invalid.
        IntentError: if the text after "intent:" is not an intent.
    """
    if isinstance(task, str) and task in KNOWN:
        return KNOWN[task]
    if in_language(task):
        return language_spec(canonical_name(task))
    if isinstance(task, str) and (task in task_plugins() or imports.is_reference(task)):
        return load_spec(task)
    if (parts := _parts_of_id(task)) is not None:
        raise UnknownNameError(
            f"{short_repr(task)} names an environment and not a task: its task is {parts[0]!r} and its variant "
            f"{parts[1]!r}; give them separately"
        )
    meant = imports.reference_in_folder(task, _SPEC)
    texts = (f"{prefix}:TEXT" for prefix in languages())
    raise unknown_name("task", task, (*KNOWN, *task_plugins(), *texts, "package.module:SPEC"), meant)


def _parts_of_id(text: object) -> Pair | None:
    """Task and variant in an environment's id, such as "magical_mj/FindDupe-TestAll-LoRes4E-v0"; None for others."""
    if not isinstance(text, str):
        return None
    task, *parts = text.removeprefix("magical_mj/").split("-")
    known = {other.lower(): other for other in (*KNOWN, *task_plugins())}
    names = [part.removeprefix("Test").replace("Color", "Colour") for part in parts]
    variants = [name for name in names if name in VARIANTS]
    return (known[task.lower()], variants[0]) if task.lower() in known and variants else None


def task_name(task: str) -> str:
    """The name that results store for a task.

    A text of a language is stored in its canonical form, and a reference to an announced task as the task's name.

    Raises:
        UnknownNameError: if the task does not exist.
        TaskError: if the task of another package is invalid.
        IntentError: if the text after "intent:" is not an intent.
    """
    if in_language(task):
        return canonical_name(task)
    spec = task_spec(task)
    known = spec.name in KNOWN or spec.name in task_plugins()
    return spec.name if known and task_spec(spec.name) is spec else task


def variant_name(variant: str) -> str:
    """The variant's name; ``"TestAll"``, as in the ids, is accepted for ``"All"``.

    Raises:
        UnknownNameError: if the variant does not exist.
    """
    name = variant.removeprefix("Test") if isinstance(variant, str) and variant != "TestDemo" else ""
    if name not in EVERY_VARIANT:
        raise unknown_name("variant", variant, VARIANTS)
    return name


def environment_axes(task: str, variant: str) -> tuple[Axis, ...]:
    """The axes along which the environment's scenes vary, such as ``("layout", "colour", "dynamics")``.

    Raises:
        UnknownNameError: if the task or variant does not exist, or the task does not have this variant.
    """
    return varied_axes(task_spec(task), variant_name(variant))


def environments(tasks: Names = "all", variants: Names = "all") -> list[Pair]:
    """The existing (task, variant) pairs of these tasks and variants, task by task in the given order, each once.

    Args:
        tasks: names for `listed_tasks`.
        variants: names that `variant_name` accepts; "all" is `VARIANTS`.

    Raises:
        SettingsError: if no name is given.
        UnknownNameError: if a name is unknown, or none of the pairs exists.
        TaskError: if the task of another package is invalid.
    """
    return list(dict.fromkeys(given_environments(tasks, variants)))


def given_environments(tasks: Names, variants: Names) -> list[Pair]:
    """`environments` with repetitions, where tasks or variants are repeated. It raises the same errors."""
    chosen = listed_tasks(tasks)
    wanted = [variant_name(variant) for variant in listed(variants, VARIANTS)]
    pairs = [(task, variant) for task in chosen for variant in wanted if variant in task_spec(task).variants]
    if not pairs:
        environment_axes(chosen[0], wanted[0])  # its error lists the task's variants
    return pairs


def in_order(tasks: Iterable[str]) -> list[str]:
    """The tasks without duplicates, in the order of tables: the benchmark's in its order, then others as given."""
    rank = {task: index for index, task in enumerate(TASKS)}
    return sorted(dict.fromkeys(tasks), key=lambda task: rank.get(task, len(rank)))


def listed_tasks(names: Names) -> list[str]:
    """The stored names of tasks. "all" is `TASKS`, and a set of a language, such as "intent:dev", is all of its tasks.

    Raises:
        SettingsError: if no name is given.
        UnknownNameError, TaskError, IntentError: see `task_name`.
    """
    return [task_name(member) for name in listed(names, TASKS) for member in members(name)]


def tasks_in_file(names: Names, file: object, trusted: Collection[str] = ()) -> list[str]:
    """The stored names of tasks that a file lists; see `listed_tasks`.

    Raises:
        UntrustedNameError: if one is a reference that is not trusted.
    """
    for name in listed(names, TASKS):
        if not in_language(name):
            imports.check_named(name, file, trusted)
    return listed_tasks(names)


def listed(names: Names, every: Iterable[str]) -> list[str]:
    """The names as a list. They may be given as a list or separated by commas. "all" means all names in `every`.

    Commas in brackets, as in "intent:in(colour=red, region)", do not separate names.

    Raises:
        SettingsError: if no name is given.
    """
    if isinstance(names, str):
        names = _COMMA.split(names)
    try:
        entries = [name.strip() if isinstance(name, str) else name for name in names]
    except TypeError:  # also raised for arrays without dimensions, which appear to be sequences
        entries = []
    entries = [name for name in entries if not isinstance(name, str) or name]  # "" comes from a trailing comma
    if not entries:
        raise SettingsError(f"give at least one of {', '.join(every)}, or all; not {short_repr(names)}")
    return list(every) if isinstance(entries[0], str) and entries == ["all"] else entries


def check_rules(rules: str) -> Rules:
    """`rules` if it is "paper" or "released".

    Raises:
        UnknownNameError: if it is another value.
    """
    check_name("set of rules", rules, RULES)
    return cast("Rules", rules)


def sample_scene(task: str, variant: str, seed: int, body: str = GRIPPER) -> Scene:
    """The initial scene of an episode with this seed. It is the same on every machine and in every process.

    Environments are evaluated on the scenes of seeds 0 to 99. For another body of the robot, poses are drawn from the
    same generators until the body fits; where a variant keeps the demo's poses, the robot is moved aside if necessary.

    Raises:
        InvalidSceneError: if the body does not exist.
        UnknownNameError: if the task or variant does not exist, or the task does not have this variant.
        InvalidSeedError: if the seed is not an integer, or negative. It may have any size.
        PlacementError: if no legal placement was found (not known to happen in the benchmark).
        TaskError: if the task of another package draws an invalid scene, or its code raises an error.
    """
    spec, variant = task_spec(task), variant_name(variant)
    varied_axes(spec, variant)  # an error if the task does not have the variant
    check_body_name(body)
    return drawn_scene(spec, variant, check_seed(seed), body)


def drawn_scene(spec: TaskSpec, variant: str, seed: int, body: str) -> Scene:
    """As `sample_scene`, whose arguments are checked already."""
    if spec.name in KNOWN:
        return vary(spec, variant, seed, body)  # the benchmark's tasks need no checks
    with imports.errors_of_user(f"{spec.title}-{variant} cannot be drawn from seed {short_repr(seed)}"):
        scene = vary(spec, variant, seed, body)
        check_drawn(spec, variant, seed, scene)
    return scene


def score(task: str, initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    """The score of the final scene, in [0, 1]. It depends only on the two scenes.

    Args:
        task: a task's name.
        initial: the scene at the start, which defines the goal.
        final: the same robot, blocks and regions with the poses at the end.
        rules: "paper", or "released" for the rules of the original's code where it differs.

    Raises:
        UnknownNameError: if the task or set of rules does not exist.
        InvalidSceneError: if `initial` is not a scene of the task, or `final` has other blocks or regions.
        SettingsError: if the task's score depends on the scenes of all steps.
        TaskError: if the task of another package does not return a number in [0, 1], or its code raises an error.
    """
    if task_spec(task).trajectory:
        raise SettingsError(
            f"the score of {task} depends on the scenes of all steps: use magical_mj.score_trajectory(task, scenes), "
            "or env.score() in an environment"
        )
    return score_trajectory(task, (initial, final), rules)


def score_trajectory(task: str, scenes: Sequence[Scene], rules: Rules = "paper") -> float:
    """The score in [0, 1] of an episode, for every task. Most scores depend only on the first and the last scene.

    Args:
        task: a task's name.
        scenes: the initial scene, and the scene after each step.
        rules: "paper", or "released" for the rules of the original's code where it differs.

    Raises:
        UnknownNameError: if the task or set of rules does not exist.
        SettingsError: if `scenes` is not a sequence with at least one scene.
        InvalidSceneError: if the first scene is not one of the task, or others have other blocks or regions.
        TaskError: if the task of another package does not return a number in [0, 1], or its code raises an error.
    """
    spec = task_spec(task)
    rules = check_rules(rules)
    if not isinstance(scenes, list | tuple) or not scenes:
        raise SettingsError(
            f"a trajectory is a list or a tuple of scenes, starting with the initial one, not {short_repr(scenes)}"
        )
    for scene in scenes:
        check_scene_type(scene)
    with imports.errors_of_user(f"{spec.title}.check failed"):
        spec.check(scenes[0])
    for scene in scenes[1:] if spec.trajectory else scenes[-1:]:
        check_same_objects(scenes[0], scene)
    return spec.checked_score(scenes, rules)


# Tasks of other packages


@cache
def task_plugins() -> Mapping[str, EntryPoint]:
    """The entry points of announced tasks by the tasks' names."""
    return imports.announced("task", ENTRY_POINTS, KNOWN, is_task_name, 'PushOut = "push_out:SPEC"')


def announced_name(task: str) -> str:
    """The announced name of the task with this reference. Other names and references are returned unchanged."""
    return next((name for name, point in task_plugins().items() if imports.reference_of(point) == task), task)


def load_spec(task: str) -> TaskSpec:
    """The task with this announced name or reference. A new task is checked, also after `importlib.reload`.

    Raises:
        UnknownNameError: if its module or the object in it does not exist.
        TaskError: if importing its module fails, or the object is not a valid task.
    """
    point = task_plugins().get(task)
    spec = imports.imported("task", task, point, TaskError)
    if _CHECKED.get(task) is spec:
        return spec
    check_spec(spec, task)
    if point is not None and spec.name != task:
        raise TaskError(f"{point.value} is announced as {task!r}, but its name is {spec.name!r}: they must be equal")
    if spec.name in KNOWN and KNOWN[spec.name] is not spec:
        raise TaskError(f"{task} has the name of another task, {spec.name!r}: choose a different name")
    _CHECKED[task] = spec
    return spec


def code_digest(task: str) -> str:
    """A hash of the modules that define this task: those of its reference and its functions, and what they import.

    For a task of a language it is a hash of what its text means: the name, the demo scenes and the horizon.
    """
    if in_language(task):
        spec = task_spec(task)
        parts = canonical_name(task), str(spec.steps), *(scene.to_json() for scene in spec.demos)
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()
    point, spec = task_plugins().get(task), load_spec(task)
    functions = (getattr(spec, field.name) for field in fields(spec))
    names = {getattr(function, "__module__", None) for function in functions if callable(function)}
    module = task if point is None else imports.reference_of(point)
    return imports.source_digest(module, *map(str, names))


def check_spec(spec: Any, task: str) -> None:
    """Raises a `TaskError` unless `spec` is a valid task: its demo scene is legal, and every variant is reproducible.

    Args:
        spec: the imported object.
        task: the name or reference given by the user.
    """
    if not isinstance(spec, TaskSpec):
        raise TaskError(f"{task} is not a magical_mj.tasks.TaskSpec but {short_repr(spec)}")
    if spec.like and spec.like not in SPECS:
        raise TaskError(f"{spec.name}.like must be one of {', '.join(SPECS)}, not {short_repr(spec.like)}")
    try:
        check_drawn(spec, "Demo", 0, spec.demo)
        if touching := contact(spec.demo, regions=False):
            raise TaskError(f"in the demo scene of {spec.title}, {touching}: move them apart")
        checked: Any = spec.check(spec.demo)
        if checked is not None:
            raise TaskError(
                f"{spec.title}.check must raise InvalidSceneError or return None, not {short_repr(checked)}"
            )
        if {spec.checked_score((spec.demo, spec.demo), rules) for rules in RULES} == {1.0}:
            warnings.warn(
                f"the demo scene of {spec.title} is solved at the start: a policy that does nothing scores 1.0 in it",
                stacklevel=2,
            )
        _check_variants(spec)
    except TaskError:
        raise
    except Exception as error:
        own = isinstance(error, MagicalError)
        problem = f"{error}{imports.location(error)}" if own else imports.with_location(error)
        raise TaskError(f"{task} is invalid: {problem}") from error


def _check_variants(spec: TaskSpec) -> None:
    for variant in spec.variants:
        drawn = vary(spec, variant, 0)
        check_drawn(spec, variant, 0, drawn)
        if any(vary(spec, variant, 0) != drawn for _ in range(DRAWS)):
            raise TaskError(
                f"{spec.title}-{variant} draws different scenes for one seed: its rules must use no random numbers "
                "except those of the given generator"
            )


def check_drawn(spec: TaskSpec, variant: str, seed: int, scene: Scene) -> None:
    """Raises a `TaskError` unless an episode can start in the scene that was drawn from this seed."""
    try:
        check_scene(scene)
        spec.check(scene)
    except InvalidSceneError as error:
        drawn = "its own demo scene" if variant == "Demo" else f"the scene of {variant} with seed {seed}"
        raise TaskError(f"no episode of {spec.title} can start in {drawn}: {error}") from error
