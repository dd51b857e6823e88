"""One training run, in a folder of its own: config.toml, metrics.csv, tensorboard/, checkpoint and policy."""

from __future__ import annotations

import json
import math
import shlex
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import torch

from magical_mj.evaluation.run import evaluate
from magical_mj.learners import checkpoint
from magical_mj.learners.adversarial import GAIL, WGAILGP
from magical_mj.learners.apprenticeship import Apprenticeship
from magical_mj.learners.bc import BehaviouralCloning
from magical_mj.learners.folder import CHECKPOINT, CONFIG, begin, check, kept_policy, last_checkpoint, misfit, threads
from magical_mj.learners.learner import Method, device, threads_for
from magical_mj.learners.method_settings import announced_methods, load_method
from magical_mj.learners.metrics import Metrics
from magical_mj.learners.settings import TrainingSettings
from magical_mj.learners.settings_file import recorded
from magical_mj.policies.interface import Policy
from magical_mj.policies.models import torch_threads
from magical_mj.utils import files
from magical_mj.utils.errors import TrainingError, check_name


class _Methods(Mapping[str, type[Method]]):
    """The methods of this package, and those that other packages announce, which are imported when asked for."""

    _OWN: Final = MappingProxyType({"bc": BehaviouralCloning, "gail": GAIL, "wgail-gp": WGAILGP, "al": Apprenticeship})

    def __getitem__(self, name: str) -> type[Method]:
        return self._OWN.get(name) or load_method(name)

    def __iter__(self) -> Iterator[str]:
        return iter((*self._OWN, *announced_methods()))

    def __len__(self) -> int:
        return len(self._OWN) + len(announced_methods())


METHODS: Final = _Methods()
"""Name -> class of every method that `train` knows by name."""
ROWS: Final = 200
"""Of metrics.csv for a whole training."""


@dataclass(frozen=True)
class Progress:
    """The progress of a training.

    Attributes:
        update: the number of updates so far.
        updates: the number of updates of a whole training.
        metrics: the learner's, means over the updates since the last report; empty between reports.
        scores: task -> mean score in the demo variant, if it was just measured.
    """

    update: int
    updates: int
    metrics: Mapping[str, float]
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
        DemonstrationError: if a task has too few demonstrations.
        TrainingError: if the folder or its checkpoint cannot be used, a loss becomes NaN or infinite, or memory runs
            out.
    """
    folder = Path(out)
    if learner is None:
        check_name("method", settings.method, METHODS)
    check(folder, settings, resume)
    kept = last_checkpoint(folder, settings)
    policy = kept_policy(folder, settings) if kept is not None and kept.finished else None
    if policy is not None:
        return policy
    with torch_threads(threads_for(settings, threads(folder))), _enough_memory(folder):
        made = (learner or METHODS[settings.method])(settings)
        try:
            begin(folder, settings)
            busy = TrainingError(f"another process is training in {folder}; wait for it, or give a new folder")
            with files.locked(folder / CONFIG, busy=busy):
                return _Run(folder, settings, made).play(watch)
        finally:
            made.close()


@contextmanager
def _enough_memory(folder: Path) -> Iterator[None]:
    """A context in which a lack of memory is told as a `TrainingError`."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:  # PyTorch has a type of its own for accelerators only
        known = isinstance(error, MemoryError | torch.OutOfMemoryError)
        if not known and not (type(error) is RuntimeError and "allocate memory" in str(error)):
            raise
        raise TrainingError(
            f"there is not enough memory for the training in {folder}: choose smaller sizes, such as batch sizes, in "
            "another folder"
        ) from error


class _Run:
    def __init__(self, folder: Path, settings: TrainingSettings, learner: Method) -> None:
        self._folder, self._settings, self._learner = folder, settings, learner
        self._update, self._seconds = 0, 0.0
        self._device = device(settings.device).type
        kept = last_checkpoint(folder, settings)
        if kept is not None:
            self._check_device(kept.device or self._device)
            self._update, self._seconds = kept.update, kept.seconds
            try:
                if kept.update > learner.updates:
                    raise ValueError(f"update {kept.update} of {learner.updates}")
                learner.restore(kept.learner)
            except Exception as error:
                raise misfit(folder, settings, error) from error
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
        if self._update == updates and kept_policy(self._folder, settings) is None:
            self._learner.save_policy(self._folder)
        started = time.monotonic() - self._seconds
        with Metrics(self._folder, self._update) as table:
            while self._update < updates:
                metrics = self._learner.update()
                self._update += 1
                self._check(metrics)
                table.add(metrics)
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
                    means = table.write(self._update, self._seconds, scores)
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

    def _check(self, metrics: Mapping[str, float]) -> None:
        wrong = [name for name, value in metrics.items() if not math.isfinite(value)]
        if wrong:
            self._give_up(f"{wrong[0]} is {metrics[wrong[0]]}")

    def _save(self) -> None:
        kept: dict[str, Any] = {
            "update": self._update,
            "updates": self._learner.updates,
            "seconds": self._seconds,
            "device": self._device,
            "settings": json.dumps(recorded(self._settings)),
            "learner": self._learner.state(),
        }
        if self._saved:  # before the checkpoint, since a run with the last checkpoint is finished
            self._learner.save_policy(self._folder)
        checkpoint.write(self._folder / CHECKPOINT, kept)
        if not self._saved:  # after the checkpoint: where there is a policy, there is one
            self._learner.save_policy(self._folder)
        self._saved = self._update

    def _give_up(self, reason: str) -> None:
        kept = f"the checkpoint of update {self._saved} is kept" if self._saved else "there is no checkpoint yet"
        raise TrainingError(f"{reason} at update {self._update}; {kept} in {self._folder}; try a lower learning rate")


def _due(update: int, updates: int, times: int) -> bool:
    """Whether something that is done `times` times in a training, the last time at its end, is due now."""
    return update * times // updates > (update - 1) * times // updates
