"""One training in its own folder: config.toml, metrics.csv, tensorboard/, checkpoint and policy."""

from __future__ import annotations

import math
import shlex
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Final

import torch

from magical_mj.learners.learner import Method
from magical_mj.learners.run_folder import Checkpoint, Metrics, RunFolder
from magical_mj.learners.settings import METHODS, TrainingSettings
from magical_mj.policies.interface import Policy
from magical_mj.policies.models import torch_settings
from magical_mj.utils import files
from magical_mj.utils.errors import TrainingError, unknown_name

ROWS: Final = 200
"""The number of rows of metrics.csv for a whole training."""


@dataclass(frozen=True)
class Progress:
    """The progress of a training.

    Attributes:
        update: the number of updates so far.
        updates: the number of updates of a whole training.
        metrics: the means of the learner's metrics since the last report; empty between reports.
        scores: task -> mean score in the demo variant, after an evaluation; otherwise empty.
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
    """Trains a policy and returns it. All results are written into the folder, from where `evaluate` loads the policy.

    A KeyboardInterrupt, for example by Ctrl-C, ends the training after the current update and saves it. A second one
    ends it at once.

    Args:
        settings: the settings, for example from `load_settings`.
        out: the run's folder.
        resume: continue a training in the folder, if there is one, with the same result as an uninterrupted training.
        learner: creates the learner, for your own method. None: the method in the settings.
        watch: called after each update.

    Raises:
        SettingsError, UnknownNameError: if the settings are invalid, or differ from those of a resumed training.
        DemonstrationError: if a task has too few demonstrations.
        TrainingError: if the folder or its checkpoint cannot be used, a loss becomes NaN or infinite, or memory is
            exhausted.
    """
    if learner is None and settings.method not in METHODS:
        raise unknown_name("method", settings.method, METHODS)
    folder = RunFolder(files.to_path(out), settings, resume=resume)
    if folder.finished is not None:
        return folder.finished
    with (
        torch_settings(folder.threads),
        _enough_memory(folder.path),
        closing((learner or METHODS[settings.method])(settings)) as method,
        folder.locked(method) as last,
    ):
        return _Training(folder, last, settings, method).run(watch)


@contextmanager
def _enough_memory(folder: Path) -> Iterator[None]:
    """Turns out-of-memory errors into `TrainingError`."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:  # PyTorch has a special type only for accelerators
        known = isinstance(error, MemoryError | torch.OutOfMemoryError)
        if not known and not (type(error) is RuntimeError and "allocate memory" in str(error)):
            raise
        raise TrainingError(
            f"not enough memory for the training in {folder}: choose smaller sizes, such as batch sizes, in another "
            "folder"
        ) from error


@contextmanager
def _interrupted_at_the_end() -> Iterator[None]:
    """A context that delays Ctrl-C: the KeyboardInterrupt is raised at its end. A second Ctrl-C interrupts at once.

    It has no effect in other threads, or if the program has its own handler.
    """
    usual = signal.default_int_handler
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is not usual:
        yield
        return
    pressed = False

    def note(_: int, __: FrameType | None) -> None:
        nonlocal pressed
        pressed = True
        signal.signal(signal.SIGINT, usual)

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)
    if pressed:
        raise KeyboardInterrupt


class _Training:
    """The loop of a training. It continues from the folder's checkpoint."""

    def __init__(self, folder: RunFolder, last: Checkpoint | None, settings: TrainingSettings, learner: Method) -> None:
        self._folder, self._settings, self._learner = folder, settings, learner
        self._update, self._seconds = 0, 0.0
        if last is not None:
            if last.device != learner.device.type:  # another device would give another result
                raise TrainingError(
                    f"{folder.path} was trained on {last.device}, not on {learner.device}: continue on a machine "
                    f"with {last.device}, or train in another folder; magical-mj evaluate --policy "
                    f"{shlex.quote(str(folder.path))} evaluates the present policy"
                )
            self._update, self._seconds = last.update, last.seconds
            try:
                if last.update > learner.updates:
                    raise ValueError(f"update {last.update} of {learner.updates}")
                learner.set_state(last.learner)
            except Exception as error:
                raise folder.unusable_checkpoint(error) from error
        self._saved = self._update

    def run(self, watch: Callable[[Progress], None]) -> Policy:
        """Completes the training and returns the policy."""
        if self._update == self._learner.updates:  # finished, but its policy is missing
            self._learner.save_policy(self._folder.path)
        with closing(Metrics(self._folder.path, self._update, self._seconds)) as table:
            whole = True  # no update is incomplete
            try:
                while self._update < self._learner.updates:
                    with _interrupted_at_the_end():
                        whole = False
                        table.add(self._improve())
                        whole = True
                    watch(self._report(table))
            except KeyboardInterrupt:
                if whole and self._update > self._saved:
                    self._recalibrate()
                    if table.pending:
                        table.write(self._update, {})
                    self._save(table.seconds)
                raise
        return self._learner.policy()

    def _improve(self) -> Mapping[str, float]:
        metrics = self._learner.update()
        self._update += 1
        for name, value in metrics.items():
            if not math.isfinite(value):
                self._give_up(f"{name} is {value}")
        return metrics

    def _report(self, table: Metrics) -> Progress:
        """Evaluates, writes a row, and saves, each if it is due."""
        updates, settings = self._learner.updates, self._settings
        save = _due(self._update, updates, settings.checkpoints)
        evaluation = _due(self._update, updates, settings.evaluations)
        if evaluation or save:
            self._recalibrate()
        scores = self._learner.demo_scores(settings.episodes) if evaluation else {}
        row = save or scores or _due(self._update, updates, ROWS)
        means = table.write(self._update, scores) if row else {}
        if save:
            self._save(table.seconds)
        return Progress(self._update, updates, means, scores)

    def _recalibrate(self) -> None:
        self._learner.recalibrate()
        fault = self._learner.fault()
        if fault is not None:
            self._give_up(fault)

    def _save(self, seconds: float) -> None:
        learner, path = self._learner, self._folder.path
        if self._saved:  # before the checkpoint: a run with the last checkpoint counts as finished
            learner.save_policy(path)
        self._folder.save(self._update, learner.updates, seconds, learner.device.type, learner.get_state())
        if not self._saved:  # after the checkpoint: a folder with a policy must have a checkpoint
            learner.save_policy(path)
        self._saved = self._update

    def _give_up(self, reason: str) -> None:
        last = f"the checkpoint of update {self._saved} is kept" if self._saved else "there is no checkpoint yet"
        where = f"{last} in {self._folder.path}"
        raise TrainingError(f"{reason} at update {self._update}; {where}; try a lower learning rate")


def _due(update: int, updates: int, times: int) -> bool:
    """Whether an action that happens `times` times in a training, the last time at its end, is due now."""
    return update * times // updates > (update - 1) * times // updates
