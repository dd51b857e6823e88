"""The metrics of a run over time: metrics.csv, and the same for TensorBoard."""

from __future__ import annotations

import contextlib
import csv
import io
import os
import platform
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Final, Self

from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from magical_mj.utils import files
from magical_mj.utils.errors import TrainingError

METRICS: Final = "metrics.csv"
TENSORBOARD: Final = "tensorboard"
FIRST: Final = ["update", "seconds"]
"""The first columns of metrics.csv."""


class Metrics:
    """Appends rows to a run's metrics.csv: updates done, seconds, the learner's metrics, the scores by task.

    Args:
        folder: of the run.
        update: where the run goes on: rows after it belong to a past that did not last, and are dropped.
    """

    def __init__(self, folder: Path, update: int) -> None:
        self._path = folder / METRICS
        self._sums: dict[str, float] = {}
        self._count = 0
        self._rows = [row for row in read_metrics(folder) if int(row["update"]) <= update]
        self._write()
        self._board = _Board(folder / TENSORBOARD, update + 1)

    def add(self, metrics: Mapping[str, float]) -> None:
        """Takes in the metrics of one update."""
        for name, value in metrics.items():
            self._sums[name] = self._sums.get(name, 0.0) + value
        self._count += 1

    def write(self, update: int, seconds: float, scores: Mapping[str, float]) -> dict[str, float]:
        """Writes a row, and returns the means of the metrics since the last one."""
        means = {name: total / self._count for name, total in self._sums.items()}
        self._sums, self._count = {}, 0
        values = {**means, **{f"score {task}": score for task, score in scores.items()}}
        self._board.add(values, update)
        row = {"update": str(update), "seconds": f"{seconds:.1f}"}
        self._rows.append(row | {name: f"{value:.6g}" for name, value in values.items()})
        self._write()
        return means

    def __enter__(self) -> Self:
        """For `with`, which closes it."""
        return self

    def __exit__(self, *error: object) -> None:
        """Closes the file for TensorBoard."""
        self._board.close()

    def _write(self) -> None:
        """The file as a whole: columns come when their first value comes."""
        columns = list(dict.fromkeys(name for row in self._rows for name in row)) or FIRST
        text = io.StringIO()
        writer = csv.DictWriter(text, columns)
        writer.writeheader()
        writer.writerows(self._rows)
        try:
            files.write(self._path, text.getvalue(), overwrite=True)
        except OSError as error:
            raise TrainingError(
                f"cannot write {self._path}: {error.strerror}; what was saved before is kept"
            ) from error


class _Board:
    """The same for TensorBoard, in a file of its own for each time that a run goes on.

    PyTorch's `SummaryWriter` writes from a thread, and where the disk is full, that thread is all that learns of it.

    Args:
        folder: of all these files.
        first: the first update that is to come: what earlier files say from there on did not last.
    """

    def __init__(self, folder: Path, first: int) -> None:
        self._path = folder / f"events.out.tfevents.{time.time_ns()}.{platform.node()}.{os.getpid()}"
        try:
            folder.mkdir(exist_ok=True)
            self._file = self._path.open("wb")
        except OSError as error:
            raise self._failed(error) from error
        self._records = RecordWriter(self._file)
        self._write(Event(wall_time=time.time(), file_version="brain.Event:2"))
        self._write(Event(wall_time=time.time(), step=first, session_log=SessionLog(status=SessionLog.START)))

    def add(self, values: Mapping[str, float], update: int) -> None:
        summary = Summary(value=[Summary.Value(tag=name, simple_value=value) for name, value in values.items()])
        self._write(Event(wall_time=time.time(), step=update, summary=summary))

    def close(self) -> None:
        with contextlib.suppress(OSError):  # which was told before
            self._file.close()

    def _write(self, event: Event) -> None:
        try:
            self._records.write(event.SerializeToString())
            self._records.flush()
        except OSError as error:
            raise self._failed(error) from error

    def _failed(self, error: OSError) -> TrainingError:
        return TrainingError(f"cannot write {self._path}: {error.strerror}; what was saved before is kept")


def read_metrics(folder: Path) -> list[dict[str, str]]:
    """The rows of a run's metrics.csv; none if there is no such file yet.

    Raises:
        TrainingError: if it is damaged, or not one that a training has written.
    """
    path = folder / METRICS
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            rows, columns = list(reader), list(reader.fieldnames or [])
        if columns[:2] != FIRST:
            raise ValueError(f"its first columns are not {' and '.join(FIRST)}, as a training writes them")
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
