"""Parallel work in several processes, on this machine or on a dask cluster."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Any, Final, Literal, TypeVar, get_args

from magical_mj.utils.errors import SettingsError, WorkerError, check_name, short_repr
from magical_mj.utils.extras import missing_extra
from magical_mj.utils.parallel.local import map_locally

Backend = Literal["local", "dask"]
BACKENDS: Final[tuple[str, ...]] = get_args(Backend)

Piece = TypeVar("Piece")
Result = TypeVar("Result")

PATIENCE: Final = 10
"""Seconds within which a dask cluster must have a worker."""
_ADDRESS: Final = re.compile(r"(\w+://)?[^/]+:\d+|inproc://.+")

__all__ = ["BACKENDS", "Backend", "check_backend", "cores", "map_unordered"]


def cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_backend(backend: str, address: str | None) -> None:
    """Raises a `SettingsError` or an `UnknownNameError` unless `map_unordered` can take these arguments together."""
    check_name("backend", backend, BACKENDS)
    if backend == "dask" and not _ADDRESS.fullmatch(address or ""):
        raise SettingsError(
            f"the dask backend needs the scheduler's address, such as tcp://host:8786; not {short_repr(address)}"
        )
    if backend == "local" and address:
        raise SettingsError("only clusters have an address: choose the dask backend")


def map_unordered(
    function: Callable[[Piece], Result],
    pieces: Sequence[Piece],
    jobs: int | None = None,
    backend: str = "local",
    address: str | None = None,
) -> Iterator[Result]:
    """The function's result for each piece of work, computed by worker processes, in order of completion.

    A worker that dies is replaced, and its piece is done again. Exceptions of the function are raised here and end all
    work.

    Args:
        function: a function of one piece. It and the pieces are pickled (by cloudpickle).
        pieces: the pieces of work, the longest first.
        jobs: the number of processes; None: one per core, or all of the cluster.
        backend: "local" or "dask".
        address: the address of the cluster's scheduler.

    Raises:
        SettingsError, UnknownNameError: if backend and address are invalid; see `check_backend`.
        WorkerError: if several workers died of the same piece, or the cluster does not respond.
        MissingExtraError: if the packages for the cluster are not installed.
    """
    check_backend(backend, address)
    if backend == "local":
        return map_locally(function, pieces, jobs or cores())
    return _map_on_dask(function, pieces, jobs, address)


def _map_on_dask(
    function: Callable[[Piece], Result], pieces: Sequence[Piece], jobs: int | None, address: str | None
) -> Iterator[Result]:
    """At most `jobs` pieces are on the cluster at once; None: all."""
    with _dask_client(address) as client:
        from distributed import KilledWorker, as_completed

        waiting = (client.submit(function, piece, pure=False) for piece in pieces)
        running = as_completed(islice(waiting, jobs))
        try:
            for future in running:
                yield future.result()
                running.update(islice(waiting, 1))
        except KilledWorker as error:
            raise WorkerError(f"several workers of the cluster died of the same piece of work: {error}") from error


def _dask_client(address: str | None) -> Any:
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise missing_extra("the dask backend", "dask") from None
    try:
        client = Client(address)
    except (OSError, ValueError) as error:  # the latter if it is not of the form of an address
        raise WorkerError(f"no dask scheduler answers at {address}: {error}") from error
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError as error:
        client.close()
        raise WorkerError(f"the dask cluster has no workers: start some with `dask worker {address}`") from error
    return client
