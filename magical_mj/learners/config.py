"""The settings that each method uses, the changes for short trainings, and settings as TOML files."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, Final

from magical_mj.learners.settings import ALL_PARTS, METHODS, OWN, STATE, TrainingSettings
from magical_mj.tasks.registry import listed_tasks, tasks_in_file
from magical_mj.utils.errors import SettingsError
from magical_mj.utils.files import read_toml
from magical_mj.utils.settings import described, with_changes

START: Final = "made"
"""The table of a config.toml with the time and the versions of a run's start. It contains no settings."""

_SHORT: Final[Mapping[str, Any]] = {
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
"""The changes for trainings that are short enough for two cores, from images or states."""

QUICK: Final[Mapping[str, Any]] = {
    **_SHORT,
    "renderer": "software",
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
"""The changes made by `quick`: a smaller network and shorter training, for two cores without an accelerator."""

STATE_TRACK: Final[Mapping[str, Any]] = {
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
"""The changes for the preset State, which is not in the paper."""


def load_settings(
    method: str, tasks: str | tuple[str, ...], *, quick: bool = False, **changes: Any
) -> TrainingSettings:
    """The settings of a method: the paper's, with the changes of `quick` and the preset State, and then `changes`.

    Args:
        method: one of `magical_mj.learners.METHODS`, or the name of your own method.
        tasks: the tasks, as a tuple or separated by commas; "all" means all eight.
        quick: use a smaller network and a shorter training on pictures.
        changes: values by field. Fields of parts contain a dot, as in ``**{"ppo.clip": 0.02}``. `recordings`,
            `reward.run` and `bc.encoder` become absolute paths.

    Raises:
        UnknownNameError: for an unknown task or setting.
        SettingsError: if a value is invalid, or `quick` is used with the preset State.
    """
    tasks = tuple(listed_tasks(tasks))
    short = QUICK if quick else {}
    if isinstance(chosen := changes.get("preset"), str) and chosen == STATE:
        if quick:
            raise SettingsError("quick is for pictures: trainings on states are already short")
        short = STATE_TRACK
    for name in ("recordings", "reward.run", "bc.encoder"):  # runs of an experiment are trained in other folders
        if isinstance(folder := changes.get(name), str | Path) and str(folder):
            changes[name] = str(Path(folder).absolute())
    if method in METHODS:
        kind = METHODS[method]
        short = {**short, **(kind.short if short else {}), **kind.defaults}
    return with_changes(settings_type(method), {**short, "method": method, "tasks": tasks, **changes})


def settings_type(method: str) -> type[TrainingSettings]:
    """The class of a method's settings."""
    return METHODS[method].settings_type if method in METHODS else TrainingSettings


def parts_of(method: str) -> tuple[str, ...]:
    """The parts of the settings that a method uses. A method without a name in `METHODS` may use all of them."""
    parts = METHODS[method].parts if method in METHODS else ALL_PARTS
    return tuple(dict.fromkeys(("demos", *parts)))


def users(name: str) -> tuple[str, ...]:
    """The methods of this package that use a setting."""
    return tuple(method for method in OWN if uses(method, name))


def uses(method: str, name: str) -> bool:
    """Whether a method may use a setting."""
    part, dot, _ = name.partition(".")
    unused = METHODS[method].unused if method in METHODS else ()
    return name not in unused and (not dot or part in parts_of(method))


def check_changes(
    changes: Mapping[str, Any], methods: Collection[str], preset: Any = None, *, elsewhere: Collection[str]
) -> None:
    """Checks that each change has an effect. `preset` None means the preset in `changes`, or the default.

    Raises:
        SettingsError: if a change is of a setting in `elsewhere`, or no method uses it, or not with this preset.
    """
    preset, known = preset or changes.get("preset", TrainingSettings.preset), described(TrainingSettings)
    for name in changes:
        if name in elsewhere:
            raise SettingsError(f"{name} has its own option or entry: give it there, not among the changed settings")
        kind = known[name].observes if name in known else ""
        if kind not in ("", "states" if preset == STATE else "pictures"):
            raise SettingsError(f"{name} is for {kind} and has no effect with the preset {preset}")
        if users(name) and not any(uses(method, name) for method in methods):
            raise SettingsError(f"{name} is for {', '.join(users(name))} and has no effect with {' or '.join(methods)}")


def to_toml(settings: TrainingSettings) -> str:
    """The settings that the method uses, as TOML; `from_toml` reads them."""
    parts = parts_of(settings.method)
    plain = {name: value for name, value in vars(settings).items() if not is_dataclass(value) and value is not None}
    return as_toml(plain | {name: vars(value) for name, value in vars(settings).items() if name in parts})


def as_toml(table: dict[str, Any]) -> str:
    """A table as TOML. Characters that cannot be encoded, such as invalid UTF-8 in a file name, are escaped twice."""
    import tomli_w  # imported late: the command line lists settings without the extra

    return re.sub("[\ud800-\udfff]", lambda match: rf"\\u{ord(match[0]):x}", tomli_w.dumps(table))


def recorded(settings: TrainingSettings) -> dict[str, Any]:
    """Name -> value of every setting that `to_toml` writes. Names of nested parts contain dots."""
    return flattened(tomllib.loads(to_toml(settings)))


def from_toml(path: Path, trusted: Collection[str] = ()) -> TrainingSettings:
    """The settings in a file, which may name these tasks by reference.

    Raises:
        SettingsError, UnknownNameError: if it is not TOML, or contains invalid settings.
        UntrustedNameError: if it contains another reference to a task.
    """
    table = read_toml(path)
    if not isinstance(table.pop(START, {}), dict):
        raise SettingsError(f"{START} in {path} must be a table, as written by a training: remove it")
    if "method" not in table or "tasks" not in table:
        raise SettingsError(f"{path} must give a method and tasks")
    table["tasks"] = tuple(tasks_in_file(table["tasks"], path, trusted))
    return with_changes(settings_type(table["method"]), flattened(table))


def flattened(table: dict[str, Any]) -> dict[str, Any]:
    """Name -> value. Names in sub-tables contain dots."""
    flat = {}
    for name, value in table.items():
        if isinstance(value, dict):
            flat |= {f"{name}.{inner}": item for inner, item in value.items()}
        else:
            flat[name] = value
    return flat
