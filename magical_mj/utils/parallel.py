"""Parallel work in several processes, on this machine or on a dask cluster.

Workers are new processes, not forks, since OpenGL does not survive a fork. They do not import the caller's `__main__`,
so that scripts need no guard. A worker's standard input is a pipe from the caller's process. It closes when that
process ends for any reason. Then the worker ends at once, with all processes that it has forked. On a cluster, each
thread of a dask worker has one such process.

Two libraries were tried instead. With joblib's loky, one dead worker fails all unfinished work items, and with it and
with pebble's `ProcessPool`, a killed or interrupted caller leaves busy workers and their forks running
(`test_workers_end_with_their_caller`).

Functions may return a `Timed` or a `Split` instead of a result.
"""

from __future__ import annotations

import math
import os
import pickle
import queue
import re
import secrets
import signal
import subprocess
import sys
import threading
import traceback
import weakref
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import IO, Any, Final, Generic, Literal, TypeVar, get_args

import cloudpickle

from magical_mj.utils.errors import SettingsError, WorkerError, check_name, short_repr
from magical_mj.utils.extras import check_extra

Backend = Literal["local", "dask"]

Item = TypeVar("Item")
Result = TypeVar("Result")

ATTEMPTS: Final = 3
"""The number of attempts per work item, if workers die."""
GRACE: Final = 10.0
"""The time in seconds for a worker to close its files."""
PATIENCE: Final = 10
"""The time in seconds within which a dask cluster must have a worker."""
ONE_THREAD: Final = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""One thread per worker: rounding depends on the number of threads, and workers share the cores."""
AHEAD: Final = 2
"""The number of submitted work items per worker. With a second one, no worker waits for the caller."""
_ADDRESS: Final = re.compile(r"(\w+://)?[^/]+:\d+|inproc://.+")


@dataclass(frozen=True)
class Timed(Generic[Result]):
    """The rest of a work item, with a time limit.

    Attributes:
        seconds: the time limit of `call`. A worker process that exceeds it is killed.
        call: computes the rest, and returns the result.
        late: the result if the process was killed.
    """

    seconds: float
    call: Callable[[], Result]
    late: Result


class Split(list[Item]):
    """A result: smaller work items that replace one. They are done next."""


def cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_backend(backend: str, address: str | None) -> None:
    """Raises a `SettingsError` or an `UnknownNameError` unless `map_unordered` accepts this combination."""
    check_name("backend", backend, get_args(Backend))
    if backend == "dask" and not _ADDRESS.fullmatch(address or ""):
        raise SettingsError(
            f"the dask backend needs the scheduler's address, such as tcp://host:8786; not {short_repr(address)}"
        )
    if backend == "local" and address:
        raise SettingsError("only the dask backend has an address: choose the dask backend")


def map_unordered(
    function: Callable[[Item], Any],
    items: Sequence[Item],
    jobs: int | None = None,
    backend: str = "local",
    address: str | None = None,
) -> Generator[Any]:
    """The function's result for each work item, computed by worker processes, in order of completion.

    If a worker dies, it is replaced, and its item is done again. Exceptions of the function are raised here and end all
    work.

    Args:
        function: a function of one work item. Each worker process receives it once and keeps it for all items. The
            function and the items are pickled (by cloudpickle).
        items: the work items, the longest first.
        jobs: the number of processes; None: one per core, or all of the cluster.
        backend: "local" or "dask".
        address: the address of the cluster's scheduler; see `check_backend`.

    Raises:
        WorkerError: if several workers died of the same item, or the cluster does not respond.
        MissingExtraError: if the packages for the cluster are not installed.
    """
    if backend == "local":
        return _map_locally(function, items, jobs or cores())
    return _map_on_dask(function, items, jobs, address)


def map_here(function: Callable[[Item], Any], items: Sequence[Item]) -> Generator[Any]:
    """Like `map_unordered`, but in this process and in order. Time limits have no effect."""
    waiting = deque(items)
    while waiting:
        result = function(waiting.popleft())
        result = result.call() if isinstance(result, Timed) else result
        if isinstance(result, Split):
            waiting.extendleft(reversed(result))
        else:
            yield result


def _results(submit: Callable[[Item], Future[Any]], items: Sequence[Item], most: float) -> Generator[Any]:
    """The results of the work items. At most `most` items are submitted at once."""
    waiting, running = deque(items), set[Future[Any]]()
    while waiting or running:
        while waiting and len(running) < most:
            running.add(submit(waiting.popleft()))
        done, running = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            result = future.result()
            if isinstance(result, Split):
                waiting.extendleft(reversed(result))
            else:
                yield result


def _map_locally(function: Callable[[Item], Any], items: Sequence[Item], jobs: int) -> Generator[Any]:
    pickled = cloudpickle.dumps(function)
    with closing(Pool(jobs)) as pool:
        yield from _results(partial(pool.submit_pickled, pickled), items, AHEAD * jobs)
        pool.finish()


def _map_on_dask(
    function: Callable[[Item], Any], items: Sequence[Item], jobs: int | None, address: str | None
) -> Generator[Any]:
    """`map_unordered` on a cluster, with at most `jobs` items at the same time; None: all items."""
    check_extra("workers of dask", "dask")
    from distributed import Client, KilledWorker

    try:
        client = Client(address)
    except (OSError, ValueError) as error:  # ValueError for an invalid address
        raise WorkerError(f"no dask scheduler answers at {address}: {error}") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError as error:
            raise WorkerError(f"the dask cluster has no workers: start some with `dask worker {address}`") from error
        name = secrets.token_hex(8)
        pickled = client.submit(bytes, cloudpickle.dumps(function), key=f"function-{name}")  # once for all items
        executor = client.get_executor(pure=False)
        try:
            yield from _results(partial(executor.submit, _do_on_cluster, name, pickled), items, jobs or math.inf)
        except KilledWorker as error:
            raise WorkerError(f"several workers of the cluster died of the same work item: {error}") from error
        finally:
            executor.shutdown(wait=False)
            with suppress(OSError, TimeoutError):  # the cluster may be gone
                client.run(_end_on_cluster, name)


_ON_CLUSTER: Final[dict[tuple[str, int], _Worker]] = {}
"""In a dask worker: the process for each call of `map_unordered` and each thread."""


def _do_on_cluster(name: str, function: bytes, item: Any) -> Any:
    """Runs in a thread of a dask worker, and passes the item to the thread's process."""
    worker = _ON_CLUSTER.setdefault((name, threading.get_ident()), _Worker())
    return worker.do(function, item)


def _end_on_cluster(name: str) -> None:
    for key in [key for key in _ON_CLUSTER if key[0] == name]:
        _ON_CLUSTER.pop(key).stop()


class Pool:
    """A limited number of worker processes. Each is started when it is first needed, and does one work item at a time.

    A pool that is garbage-collected is closed.
    """

    def __init__(self, workers: int) -> None:
        self._workers = [_Worker() for _ in range(workers)]
        self._idle: queue.LifoQueue[_Worker] = queue.LifoQueue()  # so that started workers come first
        for worker in self._workers:
            self._idle.put(worker)
        self._threads = ThreadPoolExecutor(workers)
        self.close = weakref.finalize(self, _close, self._threads, self._workers)
        """Kills all workers and their forks, and cancels items that have not begun. May be called twice."""

    def submit(self, function: Callable[[Item], Result], item: Item) -> Future[Result]:
        """The future result of the function for a work item, or its exception. Both are pickled (by cloudpickle).

        If a worker dies, it is replaced, and the item is done again. After three deaths, a `WorkerError` is raised.
        """
        return self.submit_pickled(cloudpickle.dumps(function), item)

    def submit_pickled(self, function: bytes, item: Any) -> Future[Any]:
        """Submits a pickled function, as `submit` does. A worker that has it already does not receive it again."""
        return self._threads.submit(_do, self._idle, function, item)

    def finish(self) -> None:
        """Asks idle workers to close their files, and waits for them to end."""
        for worker in self._workers:
            worker.end()


def _do(idle: queue.LifoQueue[_Worker], function: bytes, item: Any) -> Any:
    worker = idle.get()
    try:
        return worker.do(function, item)
    finally:
        idle.put(worker)


def _close(threads: ThreadPoolExecutor, workers: Sequence[_Worker]) -> None:
    threads.shutdown(wait=False, cancel_futures=True)
    for worker in workers:
        worker.stop()


class _Worker:
    """A worker process. It is started with its first work item, and replaced if it dies.

    It leads a process group, so that its forks can be killed with it, and Ctrl-C reaches only the caller.
    """

    def __init__(self) -> None:
        self._lock, self._stopped = threading.Lock(), False
        self._process: subprocess.Popen[bytes] | None = None
        self._function: bytes | None = None
        """The last function that was sent to the process."""

    def do(self, function: bytes, item: Any) -> Any:
        """The result of a pickled function for a work item."""
        code, argument = 0, cloudpickle.dumps(item)
        for _ in range(ATTEMPTS):
            process = self._start()
            late: list[Any] = []
            try:
                _send(process.stdin, (None if function == self._function else function, argument))
                self._function = function
                kind, result = _receive(process.stdout)
                if kind == "timed":
                    seconds, instead = result
                    kind, result = self._receive_within(process, seconds, instead, late)
            except (EOFError, OSError, ValueError, pickle.UnpicklingError):  # it has died during the work
                self._kill()
                if late:
                    return late[0]
                code = process.returncode
                continue
            if kind == "done":
                return result
            raise result
        cause = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        raise WorkerError(
            f"{ATTEMPTS} worker processes died of the same work item ({cause}), possibly because memory was exhausted"
        )

    def _receive_within(self, process: subprocess.Popen[bytes], seconds: float, instead: Any, late: list[Any]) -> Any:
        """The process's message. After the time limit, the process is killed, and `instead` is appended to `late`."""

        def kill() -> None:
            late.append(instead)
            self._kill()

        timer = threading.Timer(min(seconds, threading.TIMEOUT_MAX), kill)
        timer.daemon = True
        timer.start()
        try:
            return _receive(process.stdout)
        finally:
            timer.cancel()
            timer.join()  # afterwards, it cannot kill a later process

    def end(self) -> None:
        """Asks the process to close its files, and waits for it to end."""
        if (process := self._process) is not None:
            with suppress(OSError, subprocess.TimeoutExpired):
                _send(process.stdin, None)
                process.wait(GRACE)

    def stop(self) -> None:
        """Kills the process. It is not replaced."""
        self._stopped = True
        self._kill()

    def _start(self) -> subprocess.Popen[bytes]:
        """Starts the process unless it is running."""
        with self._lock:
            if self._stopped:
                raise WorkerError("the worker processes were stopped")
            if self._process is None:
                program = "import gc, sys; gc.set_threshold(10_000); "  # imports are faster, as in `cli.main`
                program += f"sys.path[:] = {sys.path!r}; from {__name__} import serve; serve()"
                self._process = subprocess.Popen(
                    [sys.executable, "-c", program],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    env={**ONE_THREAD, **os.environ},
                    # not a session: on Linux, each session has its own share of the cores, independent of `nice`
                    process_group=0,
                )
            return self._process

    def _kill(self) -> None:
        with self._lock:
            process, self._process, self._function = self._process, None, None
            if process is None:
                return
            _kill_group(process.pid)
            process.wait()
            for pipe in (process.stdin, process.stdout):
                with suppress(OSError):
                    pipe.close()  # type: ignore[union-attr]


def _kill_group(leader: int) -> None:
    """Kills a worker and its forks."""
    with suppress(ProcessLookupError, PermissionError):  # all have ended; some systems raise the latter
        if hasattr(os, "killpg"):
            os.killpg(leader, signal.SIGKILL)
        else:  # Windows has no groups
            os.kill(leader, signal.SIGTERM)


def serve() -> None:
    """The main function of a worker process. Printed output goes to standard error."""
    source, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)

    def close_pipes() -> None:  # otherwise the caller would not notice the end of this process while a fork is running
        for pipe in (source, answers):
            os.dup2(nothing, pipe.fileno())

    if hasattr(os, "register_at_fork"):  # not on Windows
        os.register_at_fork(after_in_child=close_pipes)
    messages: queue.SimpleQueue[Any] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(source, messages), daemon=True).start()
    function = b""
    while (message := messages.get()) is not None:
        sent, item = message
        function = function if sent is None else sent
        for answer in _answers(function, item):
            answers.write(answer)
            answers.flush()


@lru_cache(maxsize=1)
def _unpickled(function: bytes) -> Callable[[Any], Any]:
    return pickle.loads(function)  # noqa: S301 from the process that started this one


def _listen(source: IO[bytes], messages: queue.SimpleQueue[Any]) -> None:
    with suppress(EOFError, pickle.UnpicklingError):  # the latter if the caller was killed in the middle of a message
        while True:
            messages.put(_receive(source))
    _kill_group(os.getpid())  # the caller's process is gone


def _answers(function: bytes, item: bytes) -> Iterator[bytes]:
    """A worker's pickled answers: a time limit if there is one, then the result or the error."""
    try:
        result = _unpickled(function)(pickle.loads(item))  # noqa: S301 from the same process
        if isinstance(result, Timed):
            yield _readable("timed", (result.seconds, result.late))
            result = result.call()
        yield _readable("done", result)
    except Exception as error:  # noqa: BLE001 the caller gets it
        note = f"in a worker process:\n{''.join(traceback.format_exception(error))}"
        error.add_note(note)
        try:
            yield _readable("failed", error)
        except Exception:  # noqa: BLE001 the error cannot be pickled, for example because it holds a lock
            substitute = WorkerError(f"a worker process raised {error!r}")
            substitute.add_note(note)
            yield _readable("failed", substitute)


def _readable(kind: str, content: Any) -> bytes:
    """The pickled answer. Raises an error if the caller could not unpickle it."""
    text = cloudpickle.dumps((kind, content))
    pickle.loads(text)  # noqa: S301 pickled above
    return text


def _send(pipe: IO[bytes] | None, message: Any) -> None:
    cloudpickle.dump(message, pipe)
    pipe.flush()  # type: ignore[union-attr]


def _receive(pipe: IO[bytes] | None) -> Any:
    return pickle.load(pipe)  # type: ignore[arg-type]  # noqa: S301 from our own process
