"""The settings of an evaluation: each with its type, default, bounds and meaning in one place."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from importlib.metadata import version
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Any, Final, Literal, get_args, get_origin, get_type_hints

from magical_mj._version import __version__
from magical_mj.envs.presets import preset_named
from magical_mj.tasks.plugins import code_digest
from magical_mj.tasks.protocol import DEMONSTRATIONS, PROTOCOL
from magical_mj.tasks.registry import TASKS, Names, Pair, environments
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import SettingsError, check_name, shown
from magical_mj.utils.parallel import Backend, check_backend

Vectorization = Literal["sync", "async"]
Worlds = Literal["single", "batched"]
WORLDS: Final[tuple[Worlds, ...]] = get_args(Worlds)
DEVICE: Final = "cuda"
UNOFFICIAL: Final = (
    "official scores come from MuJoCo in double precision, where an episode played again ends the same; batched worlds "
    "calculate in single precision, and their scores are approximate"
)

MUJOCO_VERSION: Final = version("mujoco")
"""Read from its package's metadata: importing it may fail where there is no OpenGL, and takes a while."""
LARGEST_SETTING: Final = 1_000_000
"""The greatest number that a setting may be: more episodes, workers or seconds than anybody waits for."""
SHOWN: Final = 300
"""The number of characters of a setting that an error shows."""


@dataclass(frozen=True)
class About:
    """The documentation of a setting.

    Attributes:
        text: its meaning.
        least: the smallest allowed number.
    """

    text: str
    least: float | None = None


@dataclass(frozen=True, kw_only=True)
class EvaluationSettings:
    """The settings of `evaluate`. `magical-mj evaluate` has an option for each setting, with the same default.

    Raises:
        SettingsError, UnknownNameError: if a name is unknown, a value out of range, or settings are incompatible.
    """

    tasks: Annotated[Names, About("Tasks, separated by commas.")] = "all"
    variants: Annotated[Names, About("Variants, separated by commas; pairs that do not exist are left out.")] = "all"
    episodes: Annotated[
        int, About("Episodes in each environment: those of seeds 0, 1, ... The paper plays 100.", 1)
    ] = 100
    preset: Annotated[str, About("The observations: a preset's name, or an empty one.")] = "LoRes4E"
    rules: Annotated[Rules, About("Scores and horizons of the paper, or of its released code.")] = "paper"
    out: Annotated[Path | str | None, About("The folder for the scores.")] = None
    resume: Annotated[bool, About("Go on with what is in the folder.")] = False
    jobs: Annotated[
        int | None, About("Number of worker processes; by default one per core, if there is enough work.", 1)
    ] = None
    backend: Annotated[Backend, About("Where the workers run: on this machine or on a cluster.")] = "local"
    address: Annotated[str | None, About("The cluster's address, such as tcp://host:8786.")] = None
    run: Annotated[int, About("The number of the (first) run of each method.", 0)] = 0
    time_limit: Annotated[float, About("Seconds after which an episode counts as failed.", 0.1)] = 300.0
    envs: Annotated[
        int, About("Episodes that each worker plays side by side, for policies that act in batches.", 1)
    ] = 1
    vectorization: Annotated[
        Vectorization, About("Vector environment: in the worker itself (sync), or one process each (async).")
    ] = "sync"
    worlds: Annotated[
        Worlds, About("Each in MuJoCo by itself (single), or ENVS of them in one batch on DEVICE (batched, extra gpu).")
    ] = "single"
    approximate: Annotated[bool, About("Play in batched worlds, although their scores are not official.")] = False
    device: Annotated[str, About("Of batched worlds: cuda, cuda:1 or cpu.")] = DEVICE
    trust: Annotated[bool, About("Load model files that contain code, and run it.")] = False

    def __post_init__(self) -> None:
        for name, (kind, about) in described(type(self)).items():
            object.__setattr__(self, name, _fitting(name, getattr(self, name), kind, about))
        _ = self.environments
        preset_named(self.preset)
        check_backend(self.backend, self.jobs, self.address)
        if self.batched and not self.approximate:
            raise SettingsError(f"{UNOFFICIAL}: --approximate (approximate=True) plays in them, and marks the scores")
        if self.approximate and not self.batched:
            raise SettingsError("approximate scores are those of batched worlds: give --worlds batched as well")
        if self.device != DEVICE and not self.batched:
            raise SettingsError(f"device is that of batched worlds, not {shown(self.device)}: give --worlds batched")
        if self.vectorization == "async" and (self.batched or self.envs == 1):
            raise SettingsError("vectorization async is of several single worlds: give --envs 2 or more")

    @property
    def batched(self) -> bool:
        """Whether worlds are batched."""
        return self.worlds == "batched"

    @property
    def environments(self) -> list[Pair]:
        """The pairs of tasks and variants that are played."""
        return environments(self.tasks, self.variants)

    def recorded(self) -> dict[str, Any]:
        """The settings that determine scores; an evaluation can be resumed only if they are the same."""
        others = dict.fromkeys(task for task, _ in self.environments if task not in TASKS)
        code = {f"code of {task}": code_digest(task) for task in others}
        return {
            "environments": [f"{task}-{variant}" for task, variant in self.environments],
            **{name: getattr(self, name) for name in ("episodes", "preset", "rules", "time_limit", "worlds")},
            "protocol": PROTOCOL,
            "demonstrations": DEMONSTRATIONS,
            "version": __version__,
            "mujoco": MUJOCO_VERSION,
            "gl": os.environ.get("MUJOCO_GL", ""),
            **code,
        }


def _fitting(name: str, value: Any, kind: Any, about: About) -> Any:
    """The value of a setting as a plain one of its type.

    Raises:
        SettingsError, UnknownNameError: if it is invalid.
    """
    if get_origin(kind) is Literal:
        check_name(name, value, get_args(kind))
    elif about.least is not None and value is not None:
        number, said = (Real, "a number") if kind is float else (Integral, "an integer")
        if not issubclass(type(value), number) or type(value) is bool:
            raise SettingsError(f"{name} must be {said}, not {shown(value)}")
        if not value >= about.least:
            raise SettingsError(f"{name} must be at least {about.least}, not {shown(value)}")
        if value > LARGEST_SETTING:
            raise SettingsError(f"{name} must be at most {LARGEST_SETTING}, not {shown(value)}")
        value = float(value) if kind is float else int(value)
    elif kind == Names:
        value = list(value) if isinstance(value, Iterator) else value  # which is read more than once
    elif not isinstance(value, kind):
        raise SettingsError(f"{name} must be {getattr(kind, '__name__', kind)}, not {shown(value)}")
    return value


def described(settings: type) -> dict[str, tuple[Any, About]]:
    """The type and the documentation of each setting, by name."""
    hints = get_type_hints(settings, include_extras=True)
    return {setting.name: get_args(hints[setting.name]) for setting in fields(settings)}


def settings_from(arguments: Mapping[str, Any]) -> EvaluationSettings:
    """The settings with these values.

    Raises:
        UnknownNameError: if there is no such setting.
        SettingsError: see `EvaluationSettings`.
    """
    known = described(EvaluationSettings)
    for name in arguments:
        check_name("setting", name, known)
    return EvaluationSettings(**arguments)


def check_unchanged(folder: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Raises a `SettingsError` that names what differs from the settings that a folder was started with."""
    differences = [
        f"{name} was {_short(before.get(name))} and is {_short(value)}"
        for name, value in now.items()
        if before.get(name) != value
    ]
    if differences:
        raise SettingsError(f"{folder} was started with other settings: {'; '.join(differences)}")


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= SHOWN else f"{text[: SHOWN // 2]} ... {text[-SHOWN // 2 :]}"
