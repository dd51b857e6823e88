"""Files of lines of JSON that are only appended to: scores, demonstrations of the expert, and the log of a study.

A process that is killed, or a disk that is full, may leave an incomplete last line. Readers ignore it, and it is
removed before more lines are appended. So a whole line is never altered, and nothing follows an incomplete one.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Final

from magical_mj.utils import files
from magical_mj.utils.errors import MagicalError

LONGEST_LINE: Final = 10_000_000
"""The largest size of a line in bytes. Ours have 3,000 at most, apart from tasks with thousands of steps."""


def read_lines(path: Path, error: type[MagicalError]) -> Iterator[tuple[int, bytes]]:
    """Yields the number of each whole line, from 1 on, and the line. Raises `error` if one is too long."""
    with path.open("rb") as file:
        for number in itertools.count(1):
            line = file.readline(LONGEST_LINE + 1)
            if len(line) > LONGEST_LINE:
                raise error(f"{path}, line {number}: it has more than {LONGEST_LINE:,} bytes, the limit for a line")
            if not line or _is_half(line):
                return
            yield number, line


@contextmanager
def appending(path: Path, *, busy: Exception | None = None) -> Iterator[Appender]:
    """A context that lets this process alone append to a file, which is created if it is missing.

    If another process is in the context, this one waits, or raises `busy`.
    """
    with path.open("a+b", buffering=0) as file, files.locked(path, busy=busy):
        yield Appender(file)


class Appender:
    """Appends lines to a file that is open for reading and appending."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._cut()

    def append(self, lines: bytes, *, durable: bool = False) -> None:
        """Appends whole lines. After an error, only whole lines of them are in the file. `durable`: waits for the disk.

        Raises:
            OSError: if they cannot be written; its `filename` is the path.
        """
        try:
            self._cut()  # after an earlier error, if this failed as well
            while lines:  # a full disk may write only a part before it raises an error
                lines = lines[self._file.write(lines) :]
            if durable:
                os.fsync(self._file.fileno())
        except OSError as error:
            with suppress(OSError):
                self._cut()
            raise OSError(error.errno, error.strerror, self._file.name) from error

    def clear(self) -> None:
        """Removes all lines."""
        self._file.truncate(0)

    def _cut(self) -> None:
        """Removes an incomplete last line."""
        size = self._file.seek(0, os.SEEK_END)
        self._file.seek(max(0, size - 1))
        if self._file.read(1) in (b"", b"\n"):
            return
        self._file.seek(max(0, size - LONGEST_LINE))
        end = self._file.read(LONGEST_LINE)
        line = end[end.rfind(b"\n") + 1 :]
        if _is_half(line):
            self._file.truncate(size - len(line))


def _is_half(line: bytes) -> bool:
    """Whether a killed process left this line incomplete. A line with several records has lost line ends instead.

    All records of a file begin with the same name.
    """
    return not line.endswith(b"\n") and line.count(line[: line.find(b":") + 1] or line) < 2
