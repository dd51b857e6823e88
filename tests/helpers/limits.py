"""Limits of files, memory and time, as a full disk and a small machine have them."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple

MOST_SECONDS: Final = 30
"""The processor time of a limited process, in seconds."""
PATIENCE: Final = 300.0
"""The wall-clock time after which it is killed in any case, in seconds."""
MOST_MEMORY: Final = 3_000_000_000
"""The largest address space of a limited process, in bytes."""


@contextmanager
def full_disk(size: int) -> Iterator[None]:
    """A context in which no file of this process can grow beyond this size in bytes: writes stop there, and fail."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


class Used(NamedTuple):
    """What a process used, and what it said."""

    code: int | None
    """The exit code; None if it was stopped."""
    seconds: float
    """Processor time, which does not depend on other processes of the machine."""
    megabytes: float
    """At least as many as the process that started it has used, since Linux does not count anew."""
    said: str


def used(command: list[str], folder: Path) -> Used:
    """Runs a command in a folder. It is stopped after `MOST_SECONDS`, and cannot allocate more than `MOST_MEMORY`."""
    with (folder / "said.txt").open("w+") as file:
        process = subprocess.Popen(
            ["bash", "-c", f'ulimit -t {MOST_SECONDS} -v {MOST_MEMORY // 1024}; exec "$@"', "limited", *command],
            cwd=folder,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        watch = threading.Timer(PATIENCE, os.killpg, (process.pid, signal.SIGKILL))
        watch.start()
        _, status, resources = os.wait4(process.pid, 0)  # of this process and its children
        watch.cancel()
        seconds = resources.ru_utime + resources.ru_stime
        process.returncode = os.waitstatus_to_exitcode(status)
        file.seek(0)
        said = " ".join(file.read(5_000_000)[-3000:].split())
    return Used(None if process.returncode < 0 else process.returncode, seconds, resources.ru_maxrss / 1024, said)
