"""The folder of a training: checks of its contents, its provenance, its checkpoint, and its metrics.csv."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import platform
import shlex
import sys
import time
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
from magical_mj.evaluation.scores import MUJOCO_VERSION
from magical_mj.learners import checkpoint
from magical_mj.learners.checkpoint import CHECKPOINT
from magical_mj.learners.config import START, as_toml, from_toml, recorded, to_toml
from magical_mj.learners.data import digest
from magical_mj.learners.learner import Method, threads_for
from magical_mj.learners.policy import POLICY
from magical_mj.learners.settings import TrainingSettings
from magical_mj.policies.facts import CONFIG
from magical_mj.policies.interface import Policy
from magical_mj.policies.loading import loader_in, sources
from magical_mj.protocol import DEMONSTRATIONS, PROTOCOL
from magical_mj.tasks import KNOWN
from magical_mj.tasks.registry import code_digest
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError, TrainingError, as_integer, short_repr
from magical_mj.utils.files import read_toml
from magical_mj.utils.settings import check_unchanged

CODE: Final = "code"
"""The name of the hash of the modules that define tasks outside the benchmark."""
METRICS: Final = "metrics.csv"
TENSORBOARD: Final = "tensorboard"
MOST_THREADS: Final = 1024
FIRST_COLUMNS: Final = ["update", "seconds"]
"""The first columns of metrics.csv."""


class Checkpoint(msgspec.Struct):
    """A checkpoint of a training. The fields are in the order of the file."""

    update: Annotated[int, Meta(ge=0)]
    """The number of updates so far."""
    updates: int
    """The number of updates of the whole training."""
    seconds: float
    """The duration of the updates so far."""
    device: str
    """The device type of the updates so far."""
    settings: str
    """The settings of the training, as JSON."""
    learner: dict[str, Any]
    """The learner's state."""


class RunFolder:
    """The folder of a training. It is new, or with `resume` may contain a training to be continued.

    Raises:
        SettingsError: if the training in it has other settings.
        TrainingError: if it cannot be used.

    Attributes:
        path: the folder.
        threads: the number of PyTorch's threads for the training.
        finished: the policy of a finished training. None if the training is not finished, or if the policy is missing
            or damaged and must be restored from the checkpoint.
    """

    def __init__(self, path: Path, settings: TrainingSettings, *, resume: bool) -> None:
        self.path, self._settings = path, settings
        begun = None
        if (path / CONFIG).exists():
            if not resume:
                raise TrainingError(f"{path} already contains a training; --resume (resume=True) continues it")
            begun = self._check_config()
        elif path.exists() and not (path.is_dir() and all(map(files.is_unfinished, path.iterdir()))):
            raise TrainingError(f"{path} contains files that are not from a training; give a new folder")
        self.threads = threads_for(settings, begun)
        policy = loader_in(path)
        if policy is not None and not (path / CHECKPOINT).exists():
            raise TrainingError(
                f"{path} contains a policy ({policy.name}), but {CHECKPOINT} is missing, and its training cannot "
                f"continue: restore that file, or delete {policy.name} and {METRICS} to start again"
            )
        last = self.last_checkpoint()
        self.finished = self._policy() if last is not None and last.update == last.updates else None

    def _policy(self) -> Policy | None:
        """The policy in the folder, if it can be read. Raises a `TrainingError` if its tasks or its preset differ."""
        try:
            policy = cast("Policy", sources(self.path.resolve())[0].load())
        except (SettingsError, TrainingError):
            return None
        for name, wanted in (("tasks", self._settings.tasks), ("preset", self._settings.preset)):
            value = getattr(policy, name, wanted)
            if value != wanted:
                raise TrainingError(
                    f"the policy in {self.path} is from another training ({name}: {short_repr(value)} instead of "
                    f"{short_repr(wanted)}): move it away, and --resume restores this training's own policy"
                )
        return policy

    @contextmanager
    def locked(self, method: Method) -> Iterator[Checkpoint | None]:
        """A context that locks the folder against other processes. Creates it, with its config.toml, if needed.

        config.toml records what `method` learns from in addition to the settings.

        Yields the last checkpoint. It is read again, since another process may have continued the training.

        Raises a `TrainingError` if another process is training in the folder, or it is not writable.
        """
        config = self.path / CONFIG
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            if not config.exists():
                files.write(config, f"{to_toml(self._settings)}\n{_provenance(self._settings, method)}")
        except OSError as error:
            raise TrainingError(f"cannot write into {self.path}: {error.strerror}") from error
        busy = TrainingError(f"another process is training in {self.path}; wait until it ends, or give a new folder")
        with files.locked(config, busy=busy):
            yield self.last_checkpoint()

    def last_checkpoint(self) -> Checkpoint | None:
        """The last checkpoint, if any. Raises a `TrainingError` if it is damaged or of another training."""
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
                f"{path} is from another training ({others[0]}: {short_repr(before[others[0]])}): restore this "
                "training's own checkpoint, or train in another folder"
            )
        return last

    def save(self, update: int, updates: int, seconds: float, device: str, learner: dict[str, Any]) -> None:
        """Replaces the last checkpoint. If that fails, raises a `TrainingError` and keeps the last one."""
        settings = json.dumps(recorded(self._settings))
        contents = msgspec.structs.asdict(Checkpoint(update, updates, seconds, device, settings, learner))
        checkpoint.write(self.path / CHECKPOINT, contents)

    def unusable_checkpoint(self, error: Exception) -> TrainingError:
        """The error for a checkpoint that this version cannot use."""
        return TrainingError(
            f"{self.path / CHECKPOINT} is damaged, or does not fit this version of {self._settings.method} "
            f"({error!r}): continue with the version in its config.toml, or train in another folder"
        )

    def _check_config(self) -> int | None:
        """Checks that the folder's training has the same settings and protocol. Returns its number of threads."""
        config = self.path / CONFIG
        begun = from_toml(config, trusted=self._settings.tasks)
        check_unchanged(self.path, recorded(begun), recorded(self._settings))
        start = read_toml(config).get(START, {})
        for name, number in (("protocol", PROTOCOL), ("demonstrations", DEMONSTRATIONS)):
            if start.get(name, number) != number:
                raise TrainingError(
                    f"{self.path} was started with {name} number {start[name]}, but this version has number "
                    f"{number}: continue with magical_mj {start.get('magical_mj')}, or train in another folder"
                )
        for name, (what, now) in _sources(self._settings).items():
            if start.get(name, now if name == CODE else "") != now:  # older versions did not write the code
                raise TrainingError(
                    f"{what} changed since {self.path} was begun: restore the files, or train in another folder"
                )
        return as_integer(start.get("threads"), 1, MOST_THREADS)


class Metrics:
    """Appends rows to a run's metrics.csv: updates done, seconds, the learner's metrics, the scores by task.

    The values also go to TensorBoard, into a new file whenever the run is continued. When a run continues from a
    checkpoint, later rows are discarded.

    Attributes:
        pending: the number of updates since the last row.
        seconds: the duration of the updates up to the last row.
    """

    def __init__(self, folder: Path, update: int, seconds: float) -> None:
        self._path = folder / METRICS
        self.seconds, self._started = seconds, time.monotonic() - seconds
        self._sums: dict[str, float] = {}
        self.pending = 0
        self._rows = [row for row in read_metrics(folder) if int(row["update"]) <= update]
        with _disk(folder):
            self._write()
            self._board = SummaryWriter(str(folder / TENSORBOARD), purge_step=update + 1)

    def add(self, metrics: Mapping[str, float]) -> None:
        """Adds the metrics of one update."""
        for name, value in metrics.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
        self.pending += 1

    def write(self, update: int, scores: Mapping[str, float]) -> dict[str, float]:
        """Writes a row, and returns the means of the metrics since the last one."""
        self.seconds = time.monotonic() - self._started
        means = {name: total / self.pending for name, total in self._sums.items()}
        self._sums, self.pending = {}, 0
        values = {**means, **{f"score {task}": score for task, score in scores.items()}}
        row = {"update": str(update), "seconds": f"{self.seconds:.1f}"}
        self._rows.append(row | {name: f"{value:.6g}" for name, value in values.items()})
        with _disk(self._path.parent):
            self._write()
            for name, value in values.items():
                self._board.add_scalar(name, value, update)
            self._board.flush()
        return means

    def close(self) -> None:
        """Closes the file for TensorBoard."""
        with suppress(OSError):  # already reported
            self._board.close()

    def _write(self) -> None:
        """Writes the whole file. A column is added with its first value."""
        columns = list(dict.fromkeys(name for row in self._rows for name in row)) or FIRST_COLUMNS
        text = io.StringIO()
        writer = csv.DictWriter(text, columns)
        writer.writeheader()
        writer.writerows(self._rows)
        files.write(self._path, text.getvalue(), overwrite=True)


@contextmanager
def _disk(folder: Path) -> Iterator[None]:
    """Turns errors in writing into a `TrainingError`."""
    try:
        yield
    except OSError as error:
        where = error.filename or folder
        raise TrainingError(f"cannot write {where}: {error.strerror}; previously saved files are kept") from error


def read_metrics(folder: Path) -> list[dict[str, str]]:
    """The rows of a run's metrics.csv. Empty if the file is missing. Raises a `TrainingError` if it is damaged."""
    path = folder / METRICS
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            rows, columns = list(reader), list(reader.fieldnames or [])
        if columns[:2] != FIRST_COLUMNS:
            raise ValueError(f"its first columns must be {' and '.join(FIRST_COLUMNS)}")
        for row in rows:
            if None in row or None in row.values():  # a field without a column, or a column without a field
                raise ValueError(f"the row of update {row['update']} has the wrong number of fields")
            int(row["update"])
    except FileNotFoundError:
        return []
    except (csv.Error, KeyError, ValueError) as error:
        raise TrainingError(
            f"{path} is damaged: {error}; delete or move it to continue the training without the previous rows"
        ) from error
    return rows


def _sources(settings: TrainingSettings) -> dict[str, tuple[str, str]]:
    """The training's external inputs: name -> the beginning of an error message, and the SHA-256 ("" if not used)."""
    own = [task for task in settings.tasks if task not in KNOWN]
    code = hashlib.sha256("".join(map(code_digest, own)).encode()).hexdigest() if own else ""
    return {
        "recordings": (f"the demonstrations in {settings.recordings} have", digest(settings)),
        "reward": (f"the reward in {settings.reward.run} has", _file_digest(settings.reward.run, CHECKPOINT)),
        "encoder": (f"the encoder in {settings.bc.encoder} has", _file_digest(settings.bc.encoder, POLICY)),
        CODE: (f"the code of {', '.join(own)} has", code),
    }


def _file_digest(name: str, inner: str) -> str:
    """The SHA-256 of a file, or of the file `inner` in a folder. Empty without a name or file."""
    path = Path(name) / inner if Path(name).is_dir() else Path(name)
    return hashlib.sha256(path.read_bytes()).hexdigest() if name and path.is_file() else ""


def _provenance(settings: TrainingSettings, method: Method) -> str:
    """The time, command, versions, threads and external inputs of a run's start, as a table of TOML."""
    learnt = msgspec.structs.replace(method.learnt, demonstration_set=1)  # which is a setting
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
        **{name: now for name, (_, now) in _sources(settings).items() if now},
        **msgspec.to_builtins(learnt),
    }
    return as_toml({START: start})
