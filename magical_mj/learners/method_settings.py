"""The settings of each method: the paper's, the quick ones and those for states, with changes."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import fields, is_dataclass, replace
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import Any, Final, TypeVar, get_type_hints

from magical_mj.learners.settings import ALL_PARTS, STATE, TrainingSettings, fitting
from magical_mj.tasks.registry import TASKS, listed, task_name
from magical_mj.utils.errors import SettingsError, check_name
from magical_mj.utils.imports import with_place

PARTS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "bc": ("network", "bc"),
        "gail": ("network", "ppo", "discriminator"),
        "wgail-gp": ("network", "ppo", "discriminator"),
        "al": ("network", "ppo", "features"),
    }
)
"""Method of this package -> the parts of the settings that it uses."""
GROUP: Final = "magical_mj.methods"
"""The entry-point group in which installed packages announce methods, such as ``mine = "package.module:Mine"``."""
_USERS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "augment": ("bc", "gail", "wgail-gp"),
        "precision": ("bc",),
        "discriminator.gradient_penalty": ("wgail-gp",),
    }
)
"""Setting -> the methods that use it, where these are not all that use its part."""
_OF_PICTURES: Final = ("network.first_kernel", "network.first_stride", "network.first_channels", "network.channels")
_OF_STATES: Final = ("network.entity", "network.attention")

_SHORT: Final[Mapping[str, Any]] = MappingProxyType(
    {
        "ppo.steps": 16,
        "ppo.epochs": 4,
        "ppo.learning_rate": 3e-4,
        "ppo.discount": 0.9,
        "ppo.entropy": 0.003,
        "ppo.clip": 0.2,
        "ppo.anneal_clip": False,
        "ppo.normalise_advantages": True,
        "discriminator.steps": 6,
        "discriminator.learning_rate": 1e-4,
        "features.batches": 1_000,
        "features.learning_rate": 1e-3,
    }
)
"""Of trainings that are short enough for two cores, from pictures or states."""

QUICK: Final[Mapping[str, Any]] = MappingProxyType(
    {
        **_SHORT,
        "network.first_stride": 4,
        "network.first_channels": 32,
        "network.channels": 64,
        "evaluations": 5,
        "checkpoints": 10,
        "bc.batches": 1_000,
        "bc.optimizer": "adam",
        "bc.final_learning_rate": 1e-5,
        "ppo.total_steps": 80_000,
        "discriminator.batch_size": 32,
    }
)
"""The changes made by `quick`: a smaller network and shorter training, for two cores without an accelerator."""

STATE_TRACK: Final[Mapping[str, Any]] = MappingProxyType(
    {
        **_SHORT,
        "evaluations": 2,
        "checkpoints": 10,
        "bc.batches": 6_000,
        "bc.batch_size": 64,
        "bc.optimizer": "adam",
        "bc.learning_rate": 2e-3,
        "bc.final_learning_rate": 1e-5,
        "bc.heads": "uniform",
        "ppo.total_steps": 1_000_000,
        "ppo.minibatch": 128,
        "ppo.entropy": 0.02,
        "ppo.clip": 0.05,
        "ppo.averaging": 0.995,
        "discriminator.batch_size": 128,
        "discriminator.rollouts": 4,
    }
)
"""The changes for the preset State, which the paper does not have."""

SHORT_AL: Final[Mapping[str, Any]] = MappingProxyType(
    {"ppo.learning_rate": 6e-5, "ppo.entropy": 1e-5, "ppo.clip": 0.01, "features.samples": 4096}
)
"""The paper's PPO in short trainings of AL, whose rewards change more than others' from one update to the next."""

T = TypeVar("T")


def load_settings(
    method: str, tasks: str | tuple[str, ...], *, quick: bool = False, **changes: Any
) -> TrainingSettings:
    """The settings of a method: the paper's, changed for short trainings (`quick`, preset State), then by `changes`.

    Args:
        method: one of `magical_mj.learners.METHODS`, or the name of a method of the user's own.
        tasks: the tasks, as a tuple or separated by commas; "all" is all eight.
        quick: use a smaller network and a shorter training on pictures.
        changes: by field; those of parts with dots, as in ``**{"ppo.clip": 0.02}``.

    Raises:
        UnknownNameError: for an unknown task or setting.
        SettingsError: if a value is invalid, or `quick` is asked for with the preset State.
    """
    tasks = tuple(task_name(task) for task in listed(tasks, TASKS))
    settings, short = TrainingSettings(method, tasks), QUICK if quick else {}
    if isinstance(chosen := changes.get("preset"), str) and chosen == STATE:
        if quick:
            raise SettingsError("quick is for pictures: learning from states is quick as it is")
        short = STATE_TRACK
    if short and method == "al":
        short = {**short, **SHORT_AL}
    return changed(settings, {**short, **changes})


def check_changes(changes: Iterable[str], given: Collection[str]) -> None:
    """Raises a `SettingsError` if one of the changes is among what is given in another place."""
    for name in changes:
        if name in given:
            raise SettingsError(f"{name} is given by itself, and not among the settings that are changed")


def announced_methods() -> Mapping[str, EntryPoint]:
    """The entry points of methods of installed packages, by name."""
    return MappingProxyType({point.name: point for point in entry_points(group=GROUP) if point.name not in PARTS})


def load_method(name: str) -> Any:
    """The class of an announced method.

    Raises:
        SettingsError: if its module fails when it is imported, or has no such class.
    """
    point = announced_methods()[name]
    try:
        return point.load()
    except Exception as error:
        raise SettingsError(f"the method {name!r} ({point.value}) cannot be imported: {with_place(error)}") from error


def parts_of(method: str) -> tuple[str, ...]:
    """The parts of the settings that a method uses; one that no package announces may use all of them."""
    return PARTS.get(method) or (load_method(method).parts if method in announced_methods() else ALL_PARTS)


def users(name: str) -> tuple[str, ...]:
    """The methods of this package that use a setting."""
    part, dot, _ = name.partition(".")
    return _USERS.get(name) or tuple(method for method, parts in PARTS.items() if not dot or part in parts)


def uses(method: str, name: str) -> bool:
    """Whether a method may use a setting."""
    if method in PARTS:
        return method in users(name)
    part, dot, _ = name.partition(".")
    return not dot or part in parts_of(method)


def check_used(changes: Mapping[str, Any], methods: Collection[str]) -> None:
    """Raises a `SettingsError` if a change is of a setting that none of the methods uses, or not with this preset."""
    preset = changes.get("preset", TrainingSettings.preset)
    for name in changes:
        if name in (_OF_PICTURES if preset == STATE else _OF_STATES):
            seen = "pictures" if preset == STATE else "states"
            raise SettingsError(f"{name} is for {seen}, and of no use with the preset {preset}")
        if users(name) and not any(uses(method, name) for method in methods):
            raise SettingsError(f"{name} is for {', '.join(users(name))}, and of no use to {' or '.join(methods)}")


def changed(settings: T, changes: Mapping[str, Any]) -> T:
    """The settings, or a part of them, with other values; values given as text are converted to the field's type.

    Raises:
        UnknownNameError: if there is no such field.
        SettingsError: if a value is invalid.
    """
    known = names(settings)
    for name in changes:
        check_name("setting", name, known)
    return _changed(settings, changes, "")


def _changed(part: T, changes: Mapping[str, Any], prefix: str) -> T:
    values = {}
    for name, kind in get_type_hints(type(part)).items():
        path = prefix + name
        if is_dataclass(kind):
            values[name] = _changed(getattr(part, name), changes, f"{path}.")
        elif path in changes:
            values[name] = fitting(path, changes[path], kind)
    return replace(part, **values)  # pyright: ignore[reportArgumentType]


def names(settings: Any, prefix: str = "") -> list[str]:
    """The names of all fields; those of nested parts contain dots."""
    found = []
    for item in fields(settings):
        value = getattr(settings, item.name)
        found += names(value, f"{prefix}{item.name}.") if is_dataclass(value) else [f"{prefix}{item.name}"]
    return found
