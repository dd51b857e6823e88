"""One training run, in a folder of its own: config.toml, metrics.csv, tensorboard/, checkpoint and policy."""

from __future__ import annotations

import json
import math
import platform
import shlex
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import torch

from magical_mj import files
from magical_mj._version import __version__
from magical_mj.baselines import checkpoint
from magical_mj.baselines.adversarial import GAIL, WGAILGP
from magical_mj.baselines.apprenticeship import Apprenticeship
from magical_mj.baselines.bc import BehaviouralCloning
from magical_mj.baselines.config import MADE, from_toml, recorded, to_toml
from magical_mj.baselines.goals.method import GoalInference
from magical_mj.baselines.learner import Method, device, threads_for
from magical_mj.baselines.metrics import Metrics
from magical_mj.baselines.settings import TrainingSettings
from magical_mj.episodes import Policy
from magical_mj.errors import SettingsError, TrainingError, check_name
from magical_mj.evaluation.loading import sources
from magical_mj.evaluation.run import evaluate
from magical_mj.evaluation.settings import MUJOCO_VERSION, check_unchanged
from magical_mj.files import read_toml
from magical_mj.protocol import DEMONSTRATIONS, PROTOCOL

METHODS: Final[Mapping[str, Callable[[TrainingSettings], Method]]] = MappingProxyType(
    {"bc": BehaviouralCloning, "gail": GAIL, "wgail-gp": WGAILGP, "al": Apprenticeship, "goals": GoalInference}
)
CONFIG: Final = "config.toml"
CHECKPOINT: Final = "checkpoint.safetensors"
ROWS: Final = 200
"""Of metrics.csv for a whole training."""


@dataclass(frozen=True)
class Progress:
    """The progress of a training.

    Attributes:
        update: the number of updates so far.
        updates: the number of updates of a whole training.
        figures: the learner's metrics, means over the updates since the last report; empty between reports.
        scores: task -> mean score in the demo variant, if it was just measured.
    """

    update: int
    updates: int
    figures: Mapping[str, float]
    scores: Mapping[str, float]


def train(
    settings: TrainingSettings,
    out: Path | str,
    *,
    resume: bool = False,
    learner: Callable[[TrainingSettings], Method] | None = None,
    watch: Callable[[Progress], None] = lambda _: None,
) -> Policy:
    """Trains a policy and returns it; everything is in the folder, where `evaluate` finds it too.

    Args:
        settings: the settings; see `load_settings`.
        out: the run's folder.
        resume: continue a training in the folder, if there is one, with the same result as without interruption.
        learner: makes the learner, for a method of your own; None: the method that the settings name.
        watch: called after each update.

    Raises:
        SettingsError, UnknownNameError: if the settings are invalid, or differ from those of a resumed training.
        TrainingError: if the folder or its checkpoint cannot be used, or a loss becomes NaN or infinite.
    """
    folder = Path(out)
    if learner is None:
        check_name("method", settings.method, METHODS)
    _check(folder, settings, resume)
    policy = _policy(folder) if _is_finished(folder) else None
    if policy is not None:
        return policy
    with threads_for(settings):
        made = (learner or METHODS[settings.method])(settings)
        try:
            _start(folder, settings)
            with (folder / CONFIG).open("rb") as config:
                if not files.lock(config):
                    raise TrainingError(f"another process is training in {folder}; wait for it, or give a new folder")
                return _Run(folder, settings, made).play(watch)
        finally:
            made.close()


def _check(folder: Path, settings: TrainingSettings, resume: bool) -> None:
    """Raises an error unless the folder is new, or holds a training with these settings that shall be resumed."""
    config = folder / CONFIG
    if not config.exists():
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise TrainingError(f"{folder} holds something else than a training; give a new folder")
        return
    if not resume:
        raise TrainingError(f"{folder} holds a training already; --resume continues it (resume=True)")
    check_unchanged(folder, recorded(from_toml(config)), recorded(settings))
    begun = read_toml(config).get(MADE, {})
    for name, number in (("protocol", PROTOCOL), ("demonstrations", DEMONSTRATIONS)):
        if begun.get(name, number) != number:
            raise TrainingError(
                f"{folder} was begun with the {name} of number {begun[name]}, and this version has number {number}: "
                f"continue with magical_mj {begun.get('magical_mj')}, or train anew in another folder"
            )


def _is_finished(folder: Path) -> bool:
    if not (folder / CHECKPOINT).exists():
        return False
    kept = checkpoint.read(folder / CHECKPOINT)
    return kept.get("update") == kept.get("updates", 0)


def _policy(folder: Path) -> Any:
    """The policy in a run's folder; None if it was lost or damaged, so that the checkpoint must make it again."""
    try:
        return sources(folder.resolve())[0].load()
    except (SettingsError, TrainingError):
        return None


def _start(folder: Path, settings: TrainingSettings) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / CONFIG).exists():
            files.write(folder / CONFIG, f"{to_toml(settings)}\n[{MADE}]\n{_circumstances()}")
    except OSError as error:
        raise TrainingError(f"cannot write into {folder}: {error.strerror}") from error


def _circumstances() -> str:
    """The time, command and versions with which a run is started, as TOML."""
    made = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": shlex.join(sys.argv),
        "magical_mj": __version__,
        "protocol": PROTOCOL,
        "demonstrations": DEMONSTRATIONS,
        "mujoco": MUJOCO_VERSION,
        "torch": torch.__version__,
        "python": platform.python_version(),
    }
    return "".join(f"{name} = {json.dumps(value)}\n" for name, value in made.items())


class _Run:
    def __init__(self, folder: Path, settings: TrainingSettings, learner: Method) -> None:
        self._folder, self._settings, self._learner = folder, settings, learner
        self._update, self._seconds = 0, 0.0
        self._device = device(settings.device).type
        if (folder / CHECKPOINT).exists():
            kept = checkpoint.read(folder / CHECKPOINT)
            self._check_device(kept.get("device", self._device))
            try:
                self._update, self._seconds = kept["update"], kept["seconds"]
                learner.restore(kept["learner"])
            except (KeyError, IndexError, TypeError, RuntimeError, ValueError) as error:
                raise TrainingError(
                    f"{folder / CHECKPOINT} does not fit this version of {settings.method} ({error!r}): continue with "
                    "the version that its config.toml names, or train anew in another folder"
                ) from error
        self._saved = self._update

    def _check_device(self, before: str) -> None:
        """Raises an error unless the training comes from this kind of device: here, it would go on otherwise."""
        if before != self._device:
            raise TrainingError(
                f"{self._folder} was trained on {before}, and this is {self._device}: continue where there is {before} "
                f"or train anew in another folder; magical-mj evaluate --policy {shlex.quote(str(self._folder))} plays "
                "what it has learnt so far"
            )

    def play(self, watch: Callable[[Progress], None]) -> Policy:
        updates, settings = self._learner.updates, self._settings
        policy = self._learner.policy()
        if self._update == updates and _policy(self._folder) is None:
            self._learner.save_policy(self._folder)
        started = time.monotonic() - self._seconds
        with Metrics(self._folder, self._update) as metrics:
            while self._update < updates:
                figures = self._learner.update()
                self._update += 1
                self._check(figures)
                metrics.add(figures)
                save = _due(self._update, updates, settings.checkpoints)
                evaluation = _due(self._update, updates, settings.evaluations)
                if evaluation or save:
                    self._learner.recalibrate()
                    fault = self._learner.fault()
                    if fault is not None:
                        self._give_up(fault)
                scores = self._scores(policy) if evaluation else {}
                means: Mapping[str, float] = {}
                if save or scores or _due(self._update, updates, ROWS):
                    self._seconds = time.monotonic() - started
                    means = metrics.write(self._update, self._seconds, scores)
                if save:
                    self._save()
                watch(Progress(self._update, updates, means, scores))
        return policy

    def _scores(self, policy: Policy) -> dict[str, float]:
        """Mean scores in the demo variant by task."""
        episodes = self._settings.episodes
        frame = evaluate(
            policy,
            tasks=self._settings.tasks,
            variants="Demo",
            episodes=episodes,
            preset=self._settings.preset,
            envs=min(episodes, 10),
            jobs=1,
        )
        return {str(task): float(score) for task, score in frame.groupby("task")["score"].mean().items()}

    def _check(self, figures: Mapping[str, float]) -> None:
        wrong = [name for name, value in figures.items() if not math.isfinite(value)]
        if wrong:
            self._give_up(f"{wrong[0]} is {figures[wrong[0]]}")

    def _save(self) -> None:
        kept: dict[str, Any] = {
            "update": self._update,
            "updates": self._learner.updates,
            "seconds": self._seconds,
            "device": self._device,
            "learner": self._learner.state(),
        }
        self._learner.save_policy(self._folder)  # first: a run with the last checkpoint is finished
        checkpoint.write(self._folder / CHECKPOINT, kept)
        self._saved = self._update

    def _give_up(self, reason: str) -> None:
        kept = f"the checkpoint of update {self._saved} is kept" if self._saved else "there is no checkpoint yet"
        raise TrainingError(f"{reason} at update {self._update}; {kept} in {self._folder}; try a lower learning rate")


def _due(update: int, updates: int, times: int) -> bool:
    """Whether something that is done `times` times in a training, the last time at its end, is due now."""
    return update * times // updates > (update - 1) * times // updates
