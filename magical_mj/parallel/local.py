"""Worker processes of this machine.

They are new processes, not forks, since OpenGL does not survive a fork. They do not import the caller's `__main__`, so
that scripts need no guard. A worker's standard input is a pipe from the caller's process, which closes when that
process ends for any reason; then the worker ends at once.
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
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import IO, Any, Final, TypeVar

import cloudpickle

from magical_mj.errors import WorkerError

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


def spread_here(function: Callable[[Piece], Result], pieces: Sequence[Piece], jobs: int) -> Iterator[Result]:
    """See `magical_mj.parallel.spread`."""
    todo: queue.SimpleQueue[tuple[Callable[[Any], Any], Any]] = queue.SimpleQueue()
    for piece in pieces:
        todo.put((function, piece))
    done: queue.SimpleQueue[Answer] = queue.SimpleQueue()
    workers = [_Worker() for _ in range(min(jobs, len(pieces)))]
    try:
        for worker in workers:
            threading.Thread(target=_attend, args=(worker, todo, done), daemon=True).start()
        for _ in pieces:
            fine, result = done.get()
            if not fine:
                raise result
            yield result
        for worker in workers:
            worker.end()
    finally:
        for worker in workers:
            worker.kill()


def _attend(worker: _Worker, todo: queue.SimpleQueue[Any], done: queue.SimpleQueue[Answer]) -> None:
    """Gives pieces of work to a worker, one after another, until there are no more or it is killed."""
    with suppress(queue.Empty):
        while not worker.killed:
            work = todo.get_nowait()
            try:
                done.put(worker.do(cloudpickle.dumps(work)))
            except Exception as error:  # noqa: BLE001 it cannot be pickled
                done.put((False, error))


class _Worker:
    """A worker process, which is replaced if it dies.

    Attributes:
        killed: whether it was killed for good.
    """

    def __init__(self) -> None:
        self._lock, self.killed = threading.Lock(), False
        self._start()

    def do(self, piece: bytes) -> Answer:
        """The answer to a piece of work: a pickled function and its argument."""
        code = 0
        for _ in range(LIVES):
            try:
                _send(self._process.stdin, piece)
                return _receive(self._process.stdout)
            except (EOFError, OSError, ValueError, pickle.UnpicklingError) as error:
                try:
                    code = self._process.wait(GRACE)
                except subprocess.TimeoutExpired:  # it has not died
                    self._process.kill()
                    self._process.wait()
                    self._start()
                    return False, WorkerError(f"the answer of a worker process cannot be read: {error}")
                self._start()
        cause = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return False, WorkerError(
            f"{LIVES} worker processes died of the same piece of work ({cause}), perhaps because memory ran out"
        )

    def end(self) -> None:
        """Lets the process close its files, and waits for it to end."""
        with suppress(OSError, subprocess.TimeoutExpired):
            _send(self._process.stdin, None)
            self._process.wait(GRACE)

    def kill(self) -> None:
        """Kills the process."""
        with self._lock:
            self.killed = True
            self._process.kill()
            self._close()

    def _start(self) -> None:
        with self._lock:
            if self.killed:
                return
            if hasattr(self, "_process"):
                self._close()
            deaf = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"  # Ctrl-C is the caller's to handle
            program = f"{deaf}; import sys; sys.path[:] = {sys.path!r}; from {__name__} import serve; serve()"
            self._process = subprocess.Popen(
                [sys.executable, "-c", program],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**ONE_THREAD, **os.environ},
            )

    def _close(self) -> None:
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                pipe.close()  # type: ignore[union-attr]


def serve() -> None:
    """The main function of a worker process. Printed output goes to standard error."""
    source, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    pieces: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(source, pieces), daemon=True).start()
    while (piece := pieces.get()) is not None:
        _send(answers, _answer(piece))


def _listen(source: IO[bytes], pieces: queue.SimpleQueue[bytes | None]) -> None:
    with suppress(EOFError):
        while True:
            pieces.put(_receive(source))
    os._exit(0)  # the caller's process is gone


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
