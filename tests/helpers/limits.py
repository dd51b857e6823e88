"""Limits of files, memory and time, as a full disk and a small machine have them."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
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
    said: str


MEASURED = """
import json, os, sys
child = os.fork()
if child == 0:
    os.execvp(sys.argv[1], sys.argv[1:])
_, status, spent = os.wait4(child, 0)
with open("spent.json", "w") as file:
    json.dump([os.waitstatus_to_exitcode(status), spent.ru_utime + spent.ru_stime, spent.ru_maxrss], file)
"""
"""Runs a command and writes what it used. It is small, since Linux counts the memory of what starts a process."""


def used(command: list[str], folder: Path) -> Used:
    """Runs a command in a folder. It is stopped after `MOST_SECONDS`, and cannot allocate more than `MOST_MEMORY`."""
    limited = f'ulimit -t {MOST_SECONDS} -v {MOST_MEMORY // 1024}; exec "$@"'
    with (folder / "said.txt").open("w+") as file:
        process = subprocess.Popen(
            ["bash", "-c", limited, "limited", sys.executable, "-c", MEASURED, *command],
            cwd=folder,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        watch = threading.Timer(PATIENCE, os.killpg, (process.pid, signal.SIGKILL))
        watch.start()
        process.wait()
        watch.cancel()
        file.seek(0)
        said = " ".join(file.read(5_000_000)[-3000:].split())
    spent = folder / "spent.json"
    code, seconds, kilobytes = json.loads(spent.read_text()) if spent.exists() else (-1, PATIENCE, 0)
    return Used(None if code < 0 else code, seconds, kilobytes / 1024, said)
