"""Worker processes of this machine: all work is done, the dead are replaced, and none outlives its caller."""

from __future__ import annotations

import os
import pickle
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
from magical_mj.utils.parallel import Pool, Split, Timed, map_here, map_unordered

needs_proc = pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")


def test_all_the_work_is_done_whatever_it_prints(capfd: pytest.CaptureFixture[str]) -> None:
    factor = 3

    def loud(number: int) -> int:
        sys.stdout.write("noise\n")
        os.system("echo noise")
        assert sys.stdin.read() == ""
        return factor * number

    assert sorted(map_unordered(loud, range(20), jobs=np.int64(2))) == [3 * number for number in range(20)]
    assert capfd.readouterr().err.count("noise") == 40
    assert list(map_unordered(loud, [], jobs=2)) == []


class LockedError(Exception):
    """Cannot be pickled."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.lock = threading.Lock()


class TwoPartError(Exception):
    """Can be pickled, and not be unpickled."""

    def __init__(self, text: str, more: str = "", *, number: int) -> None:
        super().__init__(text)


class Unreadable:
    """Can be sent, and not be read."""

    def __reduce__(self) -> Any:
        return int, ("x",)


def fail(error: Exception) -> None:
    raise error


def test_errors_have_their_origin_and_the_worker_continues() -> None:
    """Those that cannot be sent, with their words in another."""
    pool = Pool(1)
    for work, kind, reason in (
        (lambda _: fail(UnknownNameError("no 7")), UnknownNameError, "no 7"),
        (lambda _: fail(LockedError("why")), WorkerError, r"LockedError\('why'\)"),
        (lambda _: fail(TwoPartError("why", number=1)), WorkerError, r"TwoPartError\('why'\)"),
        (lambda _: Unreadable(), ValueError, "literal"),
    ):
        with pytest.raises(kind, match=reason) as caught:
            pool.submit(work, 0).result()
        assert "in a worker process" in caught.value.__notes__[0]
    with pytest.raises(TypeError, match="pickle"):
        pool.submit(abs, (_ for _ in ())).result()  # type: ignore[arg-type]
    assert pool.submit(abs, -1).result() == 1
    pool.close()


def test_work_that_kills_every_worker_is_given_up() -> None:
    with pytest.raises(WorkerError, match=r"3 worker processes died .* \(exit code 3\)"):
        list(map_unordered(lambda _: os._exit(3), [0], jobs=1))


def test_work_past_its_time_is_ended_and_replaced() -> None:
    """By another result, or by smaller pieces; what is done in time is not."""

    def work(piece: Any) -> Any:
        if isinstance(piece, str):
            return f"part {piece}"
        late = "late" if piece == 1 else Split(["a", "b"])
        return Timed(1.0, lambda: time.sleep(1000 * piece) or f"done {piece}", late)

    assert sorted(map_unordered(work, range(3), jobs=2)) == ["done 0", "late", "part a", "part b"]
    assert list(map_here(work, [0, "c"])) == ["done 0", "part c"]


class Large:
    """A function that leaves a file wherever it is unpickled, and splits pieces that are large."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__ = state
        (self.folder / f"{os.getpid()}-{time.monotonic()}").touch()

    def __call__(self, piece: int) -> Any:
        return Split([piece // 2, piece - piece // 2]) if piece > 1 else piece


def test_each_worker_gets_the_function_once_and_what_is_split_is_done(tmp_path: Path) -> None:
    assert list(map_unordered(Large(tmp_path), [8, 3, 1], jobs=2)) == [1] * 12
    assert list(map_here(Large(tmp_path), [8, 3, 1])) == [1] * 12
    assert len(list(tmp_path.iterdir())) <= 2


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


@needs_proc
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
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


@needs_proc
@needs_proc
def test_a_worker_ends_if_its_caller_was_killed_in_the_middle_of_a_message() -> None:
    message = pickle.dumps((b"x" * 100_000, b""))
    worker = subprocess.Popen(
        [sys.executable, "-c", "from magical_mj.utils.parallel import serve; serve()"],
        stdin=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        process_group=0,
    )
    with worker:
        assert worker.stdin is not None
        worker.stdin.write(message[:50_000])
        worker.stdin.close()
        try:
            assert worker.wait(30) == -signal.SIGKILL
        finally:
            worker.kill()


def test_a_dead_worker_is_replaced_and_what_it_has_forked_ends(tmp_path: Path) -> None:
    def work(number: int) -> int:
        child = os.fork()
        if child == 0:
            time.sleep(1000)
        first = not any(tmp_path.iterdir())
        (tmp_path / str(child)).touch()
        if first:
            os._exit(3)
        return number

    assert sorted(map_unordered(work, range(3), jobs=1)) == [0, 1, 2]
    assert len(list(tmp_path.iterdir())) == 4
    wait_for(lambda: not running(tmp_path), 10)


@needs_proc
@pytest.mark.parametrize("forgotten", [False, True])
def test_closing_a_pool_kills_what_is_busy_and_cancels_what_waits(forgotten: bool, tmp_path: Path) -> None:
    """As if it were forgotten."""

    def work(number: int) -> int:
        (tmp_path / str(os.getpid())).touch()
        time.sleep(1000 * (number > 1))
        return number

    pool = Pool(1)
    assert pool.submit(work, 1).result() == 1
    busy, waiting = pool.submit(work, 2), pool.submit(work, 3)
    wait_for(busy.running)
    if forgotten:
        del pool
    else:
        pool.close()
        pool.close()
    assert waiting.cancelled()
    with pytest.raises(WorkerError):
        busy.result()
    assert not running(tmp_path)
