"""Worker processes of this machine: all work is done, the dead are replaced, and none outlives its caller."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical_mj.utils.errors import UnknownNameError, WorkerError
from magical_mj.utils.parallel import map_unordered
from magical_mj.utils.parallel.local import Pool


def square(number: int) -> int:
    return number**2


def test_all_the_work_is_done() -> None:
    assert sorted(map_unordered(square, range(20), jobs=np.int64(2))) == [number**2 for number in range(20)]
    assert list(map_unordered(square, [], jobs=2)) == []


def test_closures_are_sent_and_noise_does_no_harm(capfd: pytest.CaptureFixture[str]) -> None:
    factor = 3

    def loud(number: int) -> int:
        sys.stdout.write("noise\n")
        os.system("echo noise")
        assert sys.stdin.read() == ""
        return factor * number

    assert sorted(map_unordered(loud, range(4), jobs=2)) == [0, 3, 6, 9]
    assert capfd.readouterr().err.count("noise") == 8


def test_errors_come_back_with_their_origin() -> None:
    def fail(number: int) -> int:
        raise UnknownNameError(f"no {number}")

    with pytest.raises(UnknownNameError, match="no 7") as caught:
        list(map_unordered(fail, [7], jobs=1))
    assert "in fail" in caught.value.__notes__[0]


class LockedError(Exception):
    """Cannot be pickled."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.lock = threading.Lock()


class TwoPartError(Exception):
    """Can be pickled, and not be unpickled."""

    def __init__(self, text: str, more: str = "", *, number: int) -> None:
        super().__init__(text)


@pytest.mark.parametrize("error", [LockedError, lambda text: TwoPartError(text, number=1)])
def test_errors_that_cannot_be_sent_keep_their_reason(error: Callable[[str], Exception]) -> None:
    def fail(_: int) -> int:
        raise error("the reason")

    with pytest.raises(WorkerError, match=r"a worker process raised \w+Error\('the reason'\)") as caught:
        list(map_unordered(fail, [0], jobs=1))
    assert "in fail" in caught.value.__notes__[0]


class Piece:
    """Counts how often a piece of work is pickled."""

    sent = 0

    def __reduce__(self) -> Any:
        Piece.sent += 1
        time.sleep(0.001)
        return int, ()


def test_work_that_is_given_up_is_not_sent_any_more() -> None:
    results = map_unordered(square, [Piece() for _ in range(1000)], jobs=1)
    assert next(results) == 0
    threads = threading.active_count()
    results.close()  # type: ignore[attr-defined]
    wait_for(lambda: threading.active_count() < threads, 10)
    assert Piece.sent < 1000


def test_what_cannot_be_sent_is_an_error() -> None:
    with pytest.raises(TypeError, match="pickle"):
        list(map_unordered(square, [(_ for _ in ())], jobs=1))  # type: ignore[list-item]


def dies(once: Path) -> Callable[[int], int]:
    def work(number: int) -> int:
        if number == 1 and not once.exists():
            once.touch()
            os._exit(3)
        return number

    return work


def test_a_dead_worker_is_replaced(tmp_path: Path) -> None:
    assert sorted(map_unordered(dies(tmp_path / "once"), range(6), jobs=2)) == list(range(6))


def test_work_that_kills_every_worker_is_given_up() -> None:
    with pytest.raises(WorkerError, match=r"3 worker processes died of the same piece of work \(exit code 3\)"):
        list(map_unordered(lambda _: os._exit(3), [0], jobs=1))


PROGRAM = """
import os, time
import magical_mj
from magical_mj.utils.parallel import map_unordered

def work(number):
    if number > 1:
        os.fork()
    with open({folder!r} + f"/{{os.getpid()}}", "w"):
        pass
    if number < 2:
        return number
    if number == 2:
        time.sleep(1000)
    while True:
        pass

for result in map_unordered(work, [0, 1, 2, 3], jobs=2):
    print(result, flush=True)
"""


def running(folder: Path) -> list[int]:
    """The processes that left their number in the folder and are still there."""
    return [int(path.name) for path in folder.iterdir() if Path(f"/proc/{path.name}/cmdline").exists()]


def wait_for(condition: Callable[[], Any], seconds: float = 60) -> None:
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < seconds
        time.sleep(0.05)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL, signal.SIGINT])
def test_workers_end_with_their_caller(how: signal.Signals, tmp_path: Path) -> None:
    """One of them asleep, one busy for ever, both with a fork; from a script without a guard for `__main__`."""
    script, folder = tmp_path / "script.py", tmp_path / "workers"
    folder.mkdir()
    script.write_text(PROGRAM.format(folder=str(folder)))
    caller = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    with caller:
        assert caller.stdout is not None
        assert sorted(caller.stdout.readline() for _ in range(2)) == ["0\n", "1\n"]
        try:
            wait_for(lambda: len(running(folder)) == 4)
            caller.send_signal(how)
            caller.wait(30)
            wait_for(lambda: not running(folder), 10)
        finally:
            caller.kill()  # else `with` waits for it


def forking(folder: Path) -> Callable[[int], int]:
    """Leaves a process behind that sleeps; at its first piece of work, the worker dies."""

    def work(number: int) -> int:
        child = os.fork()
        if child == 0:
            time.sleep(1000)
        first = not any(folder.iterdir())
        (folder / str(child)).touch()
        if first:
            os._exit(3)
        return number

    return work


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
def test_what_workers_fork_ends_with_them(tmp_path: Path) -> None:
    assert sorted(map_unordered(forking(tmp_path), range(3), jobs=1)) == [0, 1, 2]
    assert len(list(tmp_path.iterdir())) == 4
    wait_for(lambda: not running(tmp_path), 10)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
def test_work_is_handed_over_piece_by_piece(tmp_path: Path) -> None:
    """One piece after another, failures of some no matter; closing kills what is busy and cancels what waits."""

    def work(number: int) -> float:
        (tmp_path / str(os.getpid())).touch()
        time.sleep(1000 * (number > 1))
        return 1 / number

    pool = Pool(1)
    assert pool.submit(work, 1).result() == 1.0
    with pytest.raises(ZeroDivisionError):
        pool.submit(work, 0).result()
    busy, waiting = pool.submit(work, 2), pool.submit(work, 3)
    wait_for(busy.running)
    for _ in range(2):
        pool.close()
    assert waiting.cancelled()
    with pytest.raises(WorkerError):
        busy.result()
    assert not running(tmp_path)


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
def test_a_pool_that_is_forgotten_is_closed(tmp_path: Path) -> None:
    pool = Pool(1)
    pool.submit(lambda _: (tmp_path / str(os.getpid())).touch(), 0).result()
    assert running(tmp_path)
    del pool
    wait_for(lambda: not running(tmp_path))


class Unreadable:
    """Can be sent, and not be read."""

    def __reduce__(self) -> Any:
        return int, ("x",)


def test_an_answer_that_cannot_be_read_ends_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("magical_mj.utils.parallel.local.GRACE", 0.1)
    with pytest.raises(
        WorkerError, match=r"the answer of a worker process cannot be read: invalid literal for int\(\)"
    ):
        list(map_unordered(lambda _: Unreadable(), [1], jobs=1))
