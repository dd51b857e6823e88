"""The folder of a training: whether it may be used, how it begins, its checkpoint, and its metrics.csv."""

from __future__ import annotations

import csv
import io
import json
import platform
import shlex
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Final, cast

import msgspec
import torch
from msgspec import Meta
from torch.utils.tensorboard.writer import SummaryWriter

from magical_mj._version import __version__
from magical_mj.evaluation.settings import MUJOCO_VERSION
from magical_mj.learners import checkpoint
from magical_mj.learners.config import START, from_toml, recorded, to_toml, toml_value
from magical_mj.learners.data import digest
from magical_mj.learners.learner import threads_for
from magical_mj.learners.settings import TrainingSettings
from magical_mj.policies.interface import Policy
from magical_mj.policies.loading import loader_in, sources
from magical_mj.tasks.protocol import DEMONSTRATIONS, PROTOCOL
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError, TrainingError, as_integer, short_repr
from magical_mj.utils.files import read_toml
from magical_mj.utils.imports import trust
from magical_mj.utils.settings import check_unchanged

CONFIG: Final = "config.toml"
CHECKPOINT: Final = "checkpoint.safetensors"
METRICS: Final = "metrics.csv"
TENSORBOARD: Final = "tensorboard"
MOST_THREADS: Final = 1024
FIRST_COLUMNS: Final = ["update", "seconds"]
"""The first columns of metrics.csv."""


class Checkpoint(msgspec.Struct):
    """A checkpoint, from which a training goes on; fields in the order of the file."""

    update: Annotated[int, Meta(ge=0)]
    """The number of updates so far."""
    updates: int
    """That of the whole training."""
    seconds: float
    """How long the updates took."""
    device: str
    """The type of device on which they were made."""
    settings: str
    """The settings of the training, as JSON."""
    learner: dict[str, Any]
    """The learner's state."""


class RunFolder:
    """The folder of a training: new, or with `resume` one with a training that shall go on.

    Raises:
        SettingsError: if the training in it has other settings.
        TrainingError: if it cannot be used.

    Attributes:
        path: the folder.
        threads: the number of PyTorch's threads for the training.
        finished: the policy of a training that has come to its end; None if there is none, or it was lost or damaged,
            so that the checkpoint must make it again.
    """

    def __init__(self, path: Path, settings: TrainingSettings, *, resume: bool) -> None:
        self.path, self._settings = path, settings
        begun = None
        if (path / CONFIG).exists():
            if not resume:
                raise TrainingError(f"{path} holds a training already; --resume continues it (resume=True)")
            begun = self._check_config()
        elif path.exists() and not (path.is_dir() and all(map(files.is_unfinished, path.iterdir()))):
            raise TrainingError(f"{path} holds something else than a training; give a new folder")
        self.threads = threads_for(settings, begun)
        policy = loader_in(path)
        if policy is not None and not (path / CHECKPOINT).exists():
            raise TrainingError(
                f"{path} holds a policy ({policy.name}), and {CHECKPOINT} is missing, from which its training would go "
                f"on: put it back; or delete {policy.name} and {METRICS}, and the training begins anew"
            )
        last = self.last_checkpoint()
        self.finished = self._policy() if last is not None and last.update == last.updates else None

    def _policy(self) -> Policy | None:
        """The policy in it, if it can be read; raises a `TrainingError` if it is of other tasks, or another preset."""
        try:
            policy = cast("Policy", sources(self.path.resolve())[0].load())
        except (SettingsError, TrainingError):
            return None
        for name, wanted in (("tasks", self._settings.tasks), ("preset", self._settings.preset)):
            value = getattr(policy, name, wanted)
            if value != wanted:
                raise TrainingError(
                    f"the policy in {self.path} is of another training ({name}: {short_repr(value)}, and here "
                    f"{short_repr(wanted)}): move it away, and --resume writes this training's own again"
                )
        return policy

    @contextmanager
    def locked(self) -> Iterator[Checkpoint | None]:
        """A context in which no other process trains in it; makes it with its config.toml, unless it is there.

        Yields the last checkpoint, read again, for another process may have gone on meanwhile.

        Raises a `TrainingError` if another process is training in it, or it cannot be written.
        """
        config = self.path / CONFIG
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            if not config.exists():
                files.write(config, f"{to_toml(self._settings)}\n[{START}]\n{_provenance(self._settings)}")
        except OSError as error:
            raise TrainingError(f"cannot write into {self.path}: {error.strerror}") from error
        busy = TrainingError(f"another process is training in {self.path}; wait for it, or give a new folder")
        with files.locked(config, busy=busy):
            yield self.last_checkpoint()

    def last_checkpoint(self) -> Checkpoint | None:
        """The last one, if any; raises a `TrainingError` if it is damaged, or of a training with other settings."""
        path = self.path / CHECKPOINT
        if not path.exists():
            return None
        contents = checkpoint.read(path)
        try:
            last = msgspec.convert(contents, Checkpoint)
            before = json.loads(last.settings)
            others = [name for name, value in recorded(self._settings).items() if before.get(name, value) != value]
        except (msgspec.ValidationError, ValueError, AttributeError) as error:
            raise self.unusable_checkpoint(error) from error
        if others:
            raise TrainingError(
                f"{path} is of another training ({others[0]}: {short_repr(before[others[0]])}): put back this "
                "training's own, or train anew in another folder"
            )
        return last

    def save(self, update: int, updates: int, seconds: float, device: str, learner: dict[str, Any]) -> None:
        """Writes a `Checkpoint` in place of the last one; if it cannot, raises a `TrainingError`, and keeps that."""
        settings = json.dumps(recorded(self._settings))
        contents = msgspec.structs.asdict(Checkpoint(update, updates, seconds, device, settings, learner))
        checkpoint.write(self.path / CHECKPOINT, contents)

    def unusable_checkpoint(self, error: Exception) -> TrainingError:
        """The error for a checkpoint with which this version can do nothing."""
        return TrainingError(
            f"{self.path / CHECKPOINT} is damaged, or does not fit this version of {self._settings.method} "
            f"({error!r}): continue with the version that its config.toml names, or train anew in another folder"
        )

    def _check_config(self) -> int | None:
        """Checks that the training in it has the same settings and protocol; returns its number of threads."""
        config = self.path / CONFIG
        trust(*self._settings.tasks)
        check_unchanged(self.path, recorded(from_toml(config)), recorded(self._settings))
        start = read_toml(config).get(START, {})
        for name, number in (("protocol", PROTOCOL), ("demonstrations", DEMONSTRATIONS)):
            if start.get(name, number) != number:
                raise TrainingError(
                    f"{self.path} was begun with the {name} of number {start[name]}, and this version has number "
                    f"{number}: continue with magical_mj {start.get('magical_mj')}, or train anew in another folder"
                )
        if start.get("recordings", "") != digest(self._settings):
            raise TrainingError(
                f"the demonstrations in {self._settings.recordings} have changed since {self.path} was begun: put them "
                "back, or train anew in another folder"
            )
        return as_integer(start.get("threads"), 1, MOST_THREADS)


class Metrics:
    """Appends rows to a run's metrics.csv: updates done, seconds, the learner's metrics, the scores by task.

    The same goes to TensorBoard, into a file of its own for each time that a run goes on; rows after the update where
    it does are discarded.

    Attributes:
        pending: the number of updates since the last row.
    """

    def __init__(self, folder: Path, update: int) -> None:
        self._path = folder / METRICS
        self._sums: dict[str, float] = {}
        self.pending = 0
        self._rows = [row for row in read_metrics(folder) if int(row["update"]) <= update]
        with _disk(folder):
            self._write()
            self._board = SummaryWriter(str(folder / TENSORBOARD), purge_step=update + 1)

    def add(self, metrics: Mapping[str, float]) -> None:
        """Takes in the metrics of one update."""
        for name, value in metrics.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
        self.pending += 1

    def write(self, update: int, seconds: float, scores: Mapping[str, float]) -> dict[str, float]:
        """Writes a row, and returns the means of the metrics since the last one."""
        means = {name: total / self.pending for name, total in self._sums.items()}
        self._sums, self.pending = {}, 0
        values = {**means, **{f"score {task}": score for task, score in scores.items()}}
        row = {"update": str(update), "seconds": f"{seconds:.1f}"}
        self._rows.append(row | {name: f"{value:.6g}" for name, value in values.items()})
        with _disk(self._path.parent):
            self._write()
            for name, value in values.items():
                self._board.add_scalar(name, value, update)
            self._board.flush()
        return means

    def close(self) -> None:
        """Closes the file for TensorBoard."""
        with suppress(OSError):  # which was told before
            self._board.close()

    def _write(self) -> None:
        """The file as a whole: columns come when their first value comes."""
        columns = list(dict.fromkeys(name for row in self._rows for name in row)) or FIRST_COLUMNS
        text = io.StringIO()
        writer = csv.DictWriter(text, columns)
        writer.writeheader()
        writer.writerows(self._rows)
        files.write(self._path, text.getvalue(), overwrite=True)


@contextmanager
def _disk(folder: Path) -> Iterator[None]:
    """Turns what cannot be written into a `TrainingError`."""
    try:
        yield
    except OSError as error:
        where = error.filename or folder
        raise TrainingError(f"cannot write {where}: {error.strerror}; what was saved before is kept") from error


def read_metrics(folder: Path) -> list[dict[str, str]]:
    """The rows of a run's metrics.csv, none if there is no such file; raises a `TrainingError` if it is damaged."""
    path = folder / METRICS
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            rows, columns = list(reader), list(reader.fieldnames or [])
        if columns[:2] != FIRST_COLUMNS:
            raise ValueError(f"its first columns are not {' and '.join(FIRST_COLUMNS)}, as a training writes them")
        for row in rows:
            if None in row or None in row.values():  # which stands for fields without a column, or the reverse
                raise ValueError(f"the row of update {row['update']} has another number of fields than the first line")
            int(row["update"])
    except FileNotFoundError:
        return []
    except (csv.Error, KeyError, ValueError) as error:
        raise TrainingError(
            f"{path} is damaged: {error}; delete it or move it away, and the training continues without the rows so far"
        ) from error
    return rows


def _provenance(settings: TrainingSettings) -> str:
    """The time, command, versions and threads with which a run is started, and a hash of recordings, as TOML."""
    start = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": shlex.join(sys.argv),
        "magical_mj": __version__,
        "protocol": PROTOCOL,
        "demonstrations": DEMONSTRATIONS,
        "mujoco": MUJOCO_VERSION,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "threads": torch.get_num_threads(),
        **({"recordings": digest(settings)} if settings.recordings else {}),
    }
    return "".join(f"{name} = {toml_value(value)}\n" for name, value in start.items())
