"""The methods by name, the settings that each uses, the changes for short trainings, and settings as TOML files."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from magical_mj.learners.settings import ALL_PARTS, PARTS, STATE, TrainingSettings
from magical_mj.tasks.registry import listed_tasks, tasks_in_file
from magical_mj.utils.errors import SettingsError
from magical_mj.utils.files import read_toml
from magical_mj.utils.imports import announced, imported, resolve_installed
from magical_mj.utils.settings import changed

if TYPE_CHECKING:
    from magical_mj.learners.learner import Method

START: Final = "made"
"""The table of a config.toml with the time and the versions of a run's start. It contains no settings."""
METHOD_GROUP: Final = "magical_mj.methods"
"""The entry-point group for methods of installed packages, such as ``mine = "package.module:Mine"``."""

_USERS: Final[Mapping[str, tuple[str, ...]]] = {
    "augment": ("bc", "gail", "wgail-gp", "airl", "iq-learn", "point"),
    "precision": ("bc",),
    "bc.encoder": ("bc",),
    "discriminator.gradient_penalty": ("wgail-gp",),
}
"""Setting -> the methods that use it. For other settings, these are all methods that use the part."""
_OF_PICTURES: Final = (
    "renderer",
    "bc.encoder",
    *(f"network.{name}" for name in ("first_kernel", "first_stride", "first_channels", "channels", "frames")),
)
_OF_STATES: Final = ("network.entity", "network.attention")

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
"""The changes for trainings that are short enough for two cores, from pictures or states."""

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

SHORT_AL: Final[Mapping[str, Any]] = {
    "ppo.learning_rate": 6e-5,
    "ppo.entropy": 1e-5,
    "ppo.clip": 0.01,
    "features.samples": 4096,
}
"""The paper's PPO settings, for short trainings of AL: its rewards change more between updates than other methods'."""


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
    settings = settings_type(method)(method, tasks)
    short = QUICK if quick else {}
    if isinstance(chosen := changes.get("preset"), str) and chosen == STATE:
        if quick:
            raise SettingsError("quick is for pictures: trainings on states are already short")
        short = STATE_TRACK
    if short and method == "al":
        short = {**short, **SHORT_AL}
    for name in ("recordings", "reward.run", "bc.encoder"):  # runs of an experiment are trained in other folders
        if isinstance(folder := changes.get(name), str | Path) and str(folder):
            changes[name] = str(Path(folder).absolute())
    defaults = METHODS[method].defaults if method in announced_methods() else {}
    return changed(settings, {**short, **defaults, **changes})


class _Methods(Mapping[str, "type[Method]"]):
    """The methods of this package, and those that other packages announce. They are imported at their first use."""

    _OWN: Final = MappingProxyType(
        {
            "bc": "bc:BehaviouralCloning",
            "gail": "gail:GAIL",
            "wgail-gp": "gail:WGAILGP",
            "airl": "gail:AIRL",
            "al": "apprenticeship:Apprenticeship",
            "iq-learn": "bc:IQLearn",
            "point": "bc:Point",
            "ppo": "rewards:OnLearntReward",
        }
    )

    def __getitem__(self, name: str) -> type[Method]:
        if name in self._OWN:
            return resolve_installed(f"magical_mj.learners.{self._OWN[name]}")
        return imported("method", name, announced_methods()[name], SettingsError)

    def __iter__(self) -> Iterator[str]:
        return iter((*self._OWN, *announced_methods()))

    def __len__(self) -> int:
        return len(self._OWN) + len(announced_methods())


METHODS: Final = _Methods()
"""Name -> class of all methods that `train` supports by name."""


@cache
def announced_methods() -> Mapping[str, EntryPoint]:
    """The entry points of methods of installed packages, by name."""
    return announced("method", METHOD_GROUP, PARTS, re.compile(r"[\w-]+").fullmatch, 'mine = "package.module:Mine"')


def settings_type(method: str) -> type[TrainingSettings]:
    """The class of a method's settings, which announced methods may extend with their own settings."""
    return METHODS[method].settings_type if method in announced_methods() else TrainingSettings


def parts_of(method: str) -> tuple[str, ...]:
    """The parts of the settings that a method uses. A method that is not announced may use all of them."""
    parts = PARTS.get(method) or (METHODS[method].parts if method in announced_methods() else ALL_PARTS)
    return tuple(dict.fromkeys(("demos", *parts)))


def users(name: str) -> tuple[str, ...]:
    """The methods of this package that use a setting."""
    return tuple(method for method in PARTS if uses(method, name))


def uses(method: str, name: str) -> bool:
    """Whether a method may use a setting."""
    part, dot, _ = name.partition(".")
    in_use = method not in PARTS or method in _USERS.get(name, (method,))
    return in_use and (not dot or part in parts_of(method))


def check_changes(
    changes: Mapping[str, Any], methods: Collection[str], preset: Any = None, *, elsewhere: Collection[str]
) -> None:
    """Checks that each change has an effect. `preset` None means the preset in `changes`, or the default.

    Raises:
        SettingsError: if a change is of a setting in `elsewhere`, or no method uses it, or not with this preset.
    """
    preset = preset or changes.get("preset", TrainingSettings.preset)
    for name in changes:
        if name in elsewhere:
            raise SettingsError(f"{name} has its own option or entry: give it there, not among the changed settings")
        if name in (_OF_PICTURES if preset == STATE else _OF_STATES):
            kind = "pictures" if preset == STATE else "states"
            raise SettingsError(f"{name} is for {kind} and has no effect with the preset {preset}")
        if users(name) and not any(uses(method, name) for method in methods):
            raise SettingsError(f"{name} is for {', '.join(users(name))} and has no effect with {' or '.join(methods)}")


def to_toml(settings: TrainingSettings) -> str:
    """The settings that the method uses, as TOML; `from_toml` reads them."""
    plain, tables, parts = [], [], parts_of(settings.method)
    for item in fields(settings):
        value = getattr(settings, item.name)
        if is_dataclass(value) and item.name in parts:
            lines = [f"{inner.name} = {toml_value(getattr(value, inner.name))}" for inner in fields(value)]
            tables.append("\n".join([f"[{item.name}]", *lines]))
        elif not is_dataclass(value) and value is not None:
            plain.append(f"{item.name} = {toml_value(value)}")
    return "\n\n".join(["\n".join(plain), *tables]) + "\n"


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
    method, tasks = table.pop("method"), tuple(tasks_in_file(table.pop("tasks"), path, trusted))
    return changed(settings_type(method)(method, tasks), flattened(table))


def flattened(table: dict[str, Any]) -> dict[str, Any]:
    """Name -> value. Names in sub-tables contain dots."""
    flat = {}
    for name, value in table.items():
        if isinstance(value, dict):
            flat |= {f"{name}.{inner}": item for inner, item in value.items()}
        else:
            flat[name] = value
    return flat


def toml_value(value: Any) -> str:
    """A value as TOML. Characters that cannot be encoded, such as invalid UTF-8 in a file name, are escaped twice."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, str):
        text = value.encode(errors="backslashreplace").decode()
        return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
    return json.dumps(value) if isinstance(value, bool) else repr(value)
