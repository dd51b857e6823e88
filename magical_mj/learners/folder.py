"""The folder of a training: whether it may be used, what it holds, and how it begins."""

from __future__ import annotations

import json
import math
import platform
import shlex
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import torch

from magical_mj._version import __version__
from magical_mj.evaluation.settings import MUJOCO_VERSION
from magical_mj.learners import checkpoint
from magical_mj.learners.metrics import METRICS
from magical_mj.learners.settings import TrainingSettings
from magical_mj.learners.settings_file import MADE, from_toml, recorded, to_toml, toml_value
from magical_mj.policies.folders import loader_in
from magical_mj.policies.loading import sources
from magical_mj.tasks.protocol import DEMONSTRATIONS, PROTOCOL
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError, TrainingError, shown
from magical_mj.utils.files import read_toml
from magical_mj.utils.imports import trust
from magical_mj.utils.settings import check_unchanged

CONFIG: Final = "config.toml"
CHECKPOINT: Final = "checkpoint.safetensors"
MOST_THREADS: Final = 1024
"""More than any processor has cores for."""


@dataclass(frozen=True)
class Checkpoint:
    """What a training goes on from.

    Attributes:
        update: the number of updates so far.
        seconds: how long they took.
        device: the type of device on which they were made; None in checkpoints of early versions.
        finished: whether they were the last ones.
        learner: the learner's state.
    """

    update: int
    seconds: float
    device: str | None
    finished: bool
    learner: Any


def check(folder: Path, settings: TrainingSettings, resume: bool) -> None:
    """Checks that a folder is new, or holds a training with these settings that shall be resumed.

    Raises:
        SettingsError: if the settings are others.
        TrainingError: if the folder cannot be used.
    """
    config = folder / CONFIG
    if not config.exists():
        if folder.exists() and not (folder.is_dir() and files.is_empty(folder)):
            raise TrainingError(f"{folder} holds something else than a training; give a new folder")
        return
    if not resume:
        raise TrainingError(f"{folder} holds a training already; --resume continues it (resume=True)")
    trust(*settings.tasks)
    check_unchanged(folder, recorded(from_toml(config)), recorded(settings))
    begun = read_toml(config).get(MADE, {})
    for name, number in (("protocol", PROTOCOL), ("demonstrations", DEMONSTRATIONS)):
        if begun.get(name, number) != number:
            raise TrainingError(
                f"{folder} was begun with the {name} of number {begun[name]}, and this version has number {number}: "
                f"continue with magical_mj {begun.get('magical_mj')}, or train anew in another folder"
            )
    policy = loader_in(folder)
    if policy is not None and not (folder / CHECKPOINT).exists():
        raise TrainingError(
            f"{folder} holds a policy ({policy.name}), and {CHECKPOINT} is missing, from which its training would go "
            f"on: put it back; or delete {policy.name} and {METRICS}, and the training begins anew"
        )


def last_checkpoint(folder: Path, settings: TrainingSettings) -> Checkpoint | None:
    """The checkpoint in a run's folder; None if there is none yet.

    Raises:
        TrainingError: if it is damaged, or of a training with other settings.
    """
    path = folder / CHECKPOINT
    if not path.exists():
        return None
    kept = checkpoint.read(path)
    try:
        update, seconds, updates = kept["update"], kept["seconds"], kept.get("updates")
        before = json.loads(kept.get("settings", "{}"))  # checkpoints of early versions do not tell
        if type(update) is not int or not 0 <= update <= (update if updates is None else updates):
            raise ValueError(f"update {shown(update)} of {shown(updates)}")
        if not 0 <= seconds < math.inf:
            raise ValueError(f"{shown(seconds)} seconds")
        found = Checkpoint(update, seconds, kept.get("device"), update == updates, kept["learner"])
        others = [name for name, value in recorded(settings).items() if before.get(name, value) != value]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise misfit(folder, settings, error) from error
    if others:
        raise TrainingError(
            f"{path} is of another training ({others[0]}: {shown(before[others[0]])}): put back this training's own, "
            "or train anew in another folder"
        )
    return found


def misfit(folder: Path, settings: TrainingSettings, error: Exception) -> TrainingError:
    """The error for a checkpoint with which this version can do nothing."""
    return TrainingError(
        f"{folder / CHECKPOINT} is damaged, or does not fit this version of {settings.method} ({error!r}): continue "
        "with the version that its config.toml names, or train anew in another folder"
    )


def kept_policy(folder: Path, settings: TrainingSettings) -> Any:
    """The policy in a run's folder; None if it was lost or damaged, so that the checkpoint must make it again.

    Raises:
        TrainingError: if it is of other tasks, or of another preset.
    """
    try:
        policy = sources(folder.resolve())[0].load()
    except (SettingsError, TrainingError):
        return None
    for name, ours in (("tasks", settings.tasks), ("preset", settings.preset)):
        found = getattr(policy, name, ours)
        if found != ours:
            raise TrainingError(
                f"the policy in {folder} is of another training ({name}: {shown(found)}, and here {shown(ours)}): "
                "move it away, and --resume writes this training's own again"
            )
    return policy


def threads(folder: Path) -> int | None:
    """The number of threads with which the training in a folder was begun; None if it does not say.

    Raises:
        SettingsError: if it is no number of threads.
    """
    begun = read_toml(folder / CONFIG).get(MADE, {}) if (folder / CONFIG).exists() else {}
    found = begun.get("threads")
    if found is not None and (type(found) is not int or not 1 <= found <= MOST_THREADS):
        raise SettingsError(
            f"threads in {folder / CONFIG} must be an integer from 1 to {MOST_THREADS}, not {shown(found)}; "
            "put back the number with which the training was begun"
        )
    return found


def begin(folder: Path, settings: TrainingSettings) -> None:
    """Makes the folder with its config.toml, unless it is there.

    Raises:
        TrainingError: if it cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / CONFIG).exists():
            files.write(folder / CONFIG, f"{to_toml(settings)}\n[{MADE}]\n{_circumstances()}")
    except OSError as error:
        raise TrainingError(f"cannot write into {folder}: {error.strerror}") from error


def _circumstances() -> str:
    """The time, command, versions and threads with which a run is started, as TOML."""
    made = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": shlex.join(sys.argv),
        "magical_mj": __version__,
        "protocol": PROTOCOL,
        "demonstrations": DEMONSTRATIONS,
        "mujoco": MUJOCO_VERSION,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "threads": torch.get_num_threads(),
    }
    return "".join(f"{name} = {toml_value(value)}\n" for name, value in made.items())
