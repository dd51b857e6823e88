"""Worker processes of this machine.

They are new processes, not forks, since OpenGL does not survive a fork. They do not import the caller's `__main__`, so
that scripts need no guard. A worker's standard input is a pipe from the caller's process, which closes when that
process ends for any reason; then the worker ends at once, with all that it has forked.

joblib's loky was tried in its place: one dead worker fails all pieces that are not done, a caller that is killed leaves
busy workers and their forks behind, and one that is interrupted waits for them.
"""

from __future__ import annotations

import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import traceback
import weakref
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from contextlib import suppress
from typing import IO, Any, Final, TypeVar

import cloudpickle

from magical_mj.utils.errors import WorkerError

Piece = TypeVar("Piece")
Result = TypeVar("Result")
Answer = tuple[bool, Any]
"""(success, the result or the error)."""

LIVES: Final = 3
"""The number of workers that may die of one piece of work."""
GRACE: Final = 10.0
"""Seconds that a worker has to close its files."""
ONE_THREAD: Final = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""One thread per worker: sums depend on how they are split, and workers share the cores."""


def map_locally(function: Callable[[Piece], Result], pieces: Sequence[Piece], jobs: int) -> Iterator[Result]:
    """See `magical_mj.utils.parallel.map_unordered`."""
    pool = Pool(jobs)
    try:
        for future in as_completed([pool.submit(function, piece) for piece in pieces]):
            yield future.result()
        pool.finish()
    finally:
        pool.close()


class Pool:
    """Worker processes, each of which is started when there is work for it, and does one piece after another.

    Args:
        workers: how many at most.
    """

    def __init__(self, workers: int) -> None:
        self._workers = [_Worker() for _ in range(workers)]
        self._idle: queue.LifoQueue[_Worker] = queue.LifoQueue()  # so that those that have started come first
        for worker in self._workers:
            self._idle.put(worker)
        self._threads = ThreadPoolExecutor(workers)
        self._end = weakref.finalize(self, _end, self._threads, self._workers)

    def submit(self, function: Callable[[Piece], Result], piece: Piece) -> Future[Result]:
        """The function's result for a piece of work, or its exception, to come.

        A worker that dies is replaced, and its piece is done again; a `WorkerError` comes if three have died of it.

        Args:
            function: a function of one piece. It and the piece are pickled (by cloudpickle) when a worker is free.
            piece: the piece of work.
        """
        return self._threads.submit(_do, self._idle, function, piece)

    def finish(self) -> None:
        """Lets workers that have nothing to do close their files, and waits for them to end."""
        for worker in self._workers:
            worker.end()

    def close(self) -> None:
        """Kills all workers and what they have forked; what was not begun is cancelled. May be called twice.

        A pool that is no longer used by anyone is closed as well.
        """
        self._end()


def _do(idle: queue.LifoQueue[_Worker], function: Callable[[Piece], Result], piece: Piece) -> Result:
    worker = idle.get()
    try:
        return worker.do(cloudpickle.dumps((function, piece)))
    finally:
        idle.put(worker)


def _end(threads: ThreadPoolExecutor, workers: Sequence[_Worker]) -> None:
    threads.shutdown(wait=False, cancel_futures=True)
    for worker in workers:
        worker.kill()


class _Worker:
    """A worker process, which is started with its first piece of work, and replaced if it dies.

    It leads a process group, so that what it forks can be killed with it, and Ctrl-C is left to the caller.
    """

    def __init__(self) -> None:
        self._lock, self._killed = threading.Lock(), False
        self._process: subprocess.Popen[bytes] | None = None

    def do(self, piece: bytes) -> Any:
        """The result of a piece of work: a pickled function and its argument."""
        code = 0
        for _ in range(LIVES):
            process = self._running()
            try:
                _send(process.stdin, piece)
                fine, result = _receive(process.stdout)
            except (EOFError, OSError, ValueError, pickle.UnpicklingError) as error:
                try:
                    code = process.wait(GRACE)
                except subprocess.TimeoutExpired:  # it has not died
                    raise WorkerError(f"the answer of a worker process cannot be read: {error}") from None
                finally:
                    self._clear()
                continue
            if fine:
                return result
            raise result
        cause = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        raise WorkerError(
            f"{LIVES} worker processes died of the same piece of work ({cause}), perhaps because memory ran out"
        )

    def end(self) -> None:
        """Lets the process close its files, and waits for it to end."""
        if (process := self._process) is not None:
            with suppress(OSError, subprocess.TimeoutExpired):
                _send(process.stdin, None)
                process.wait(GRACE)

    def kill(self) -> None:
        """Kills the process for good."""
        self._killed = True
        self._clear()

    def _running(self) -> subprocess.Popen[bytes]:
        with self._lock:
            if self._killed:
                raise WorkerError("the worker processes were stopped")
            if self._process is None:
                program = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve()"
                self._process = subprocess.Popen(
                    [sys.executable, "-c", program],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    env={**ONE_THREAD, **os.environ},
                    process_group=0,  # not a session: on Linux each has its own share of the cores, whatever its `nice`
                )
            return self._process

    def _clear(self) -> None:
        with self._lock:
            if (process := self._process) is None:
                return
            self._process = None
            _kill_group(process.pid)
            process.wait()
            for pipe in (process.stdin, process.stdout):
                with suppress(OSError):
                    pipe.close()  # type: ignore[union-attr]


def _kill_group(leader: int) -> None:
    """Kills a worker and what it has forked."""
    with suppress(ProcessLookupError, PermissionError):  # all have ended; some systems say the latter
        if hasattr(os, "killpg"):
            os.killpg(leader, signal.SIGKILL)
        else:  # on Windows, where there are no groups
            os.kill(leader, signal.SIGTERM)


def serve() -> None:
    """The main function of a worker process. Printed output goes to standard error."""
    source, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)

    def let_go() -> None:  # else the caller would not see the end of this process while one that it forked is there
        for pipe in (source, answers):
            os.dup2(nothing, pipe.fileno())

    if hasattr(os, "register_at_fork"):  # not on Windows
        os.register_at_fork(after_in_child=let_go)
    pieces: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(source, pieces), daemon=True).start()
    while (piece := pieces.get()) is not None:
        _send(answers, _answer(piece))


def _listen(source: IO[bytes], pieces: queue.SimpleQueue[bytes | None]) -> None:
    with suppress(EOFError):
        while True:
            pieces.put(_receive(source))
    _kill_group(os.getpid())  # the caller's process is gone


def _answer(piece: bytes) -> Answer:
    try:
        function, argument = pickle.loads(piece)  # noqa: S301 from the process that started this one
        answer = True, function(argument)
        cloudpickle.dumps(answer)
    except Exception as error:  # noqa: BLE001 the caller gets it
        return False, _sendable(error, f"in a worker process:\n{''.join(traceback.format_exception(error))}")
    return answer


def _sendable(error: Exception, note: str) -> Exception:
    """The error, or one that says the same if it does not survive pickling, as those that hold a lock."""
    try:
        pickle.loads(cloudpickle.dumps(error))  # noqa: S301 our own
    except Exception:  # noqa: BLE001 classes may raise anything
        error = WorkerError(f"a worker process raised {error!r}")
    error.add_note(note)
    return error


def _send(pipe: IO[bytes] | None, message: Any) -> None:
    cloudpickle.dump(message, pipe)
    pipe.flush()  # type: ignore[union-attr]


def _receive(pipe: IO[bytes] | None) -> Any:
    return pickle.load(pipe)  # type: ignore[arg-type]  # noqa: S301 from our own process
