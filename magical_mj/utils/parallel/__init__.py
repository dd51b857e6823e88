"""Parallel work in several processes, on this machine or on a dask or ray cluster."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from numbers import Integral
from typing import Final, Literal, TypeVar, get_args

from magical_mj.utils.errors import SettingsError, check_name, shown

Backend = Literal["local", "dask", "ray"]
BACKENDS: Final[tuple[str, ...]] = get_args(Backend)

Piece = TypeVar("Piece")
Result = TypeVar("Result")

_DASK: Final = re.compile(r"(\w+://)?[^/]+:\d+|inproc://.+")

__all__ = ["BACKENDS", "Backend", "check_backend", "cores", "map_unordered"]


def cores() -> int:
    """The number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_backend(backend: str, jobs: int | None, address: str | None) -> None:
    """Raises a `SettingsError` or an `UnknownNameError` unless `map_unordered` can take these arguments together."""
    check_name("backend", backend, BACKENDS)
    if jobs is not None and (not isinstance(jobs, Integral) or jobs < 1):
        raise SettingsError(f"jobs must be an integer of at least 1, not {shown(jobs)}")
    if backend == "dask" and not _DASK.fullmatch(address or ""):
        raise SettingsError(
            f"the dask backend needs the scheduler's address, such as tcp://host:8786; not {shown(address)}"
        )
    if backend == "local" and address:
        raise SettingsError("only clusters have an address: choose the dask or the ray backend")


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
        backend: "local", "dask" or "ray".
        address: the cluster's address.

    Raises:
        SettingsError, UnknownNameError: if jobs, backend and address are invalid; see `check_backend`.
        WorkerError: if several workers died of the same piece, or the cluster does not respond.
        MissingExtraError: if the packages for the cluster are not installed.
    """
    check_backend(backend, jobs, address)
    if backend == "local":
        from magical_mj.utils.parallel.local import map_locally

        return map_locally(function, pieces, jobs or cores())
    from magical_mj.utils.parallel.clusters import map_on_cluster

    return map_on_cluster(function, pieces, jobs, backend, address)
