"""Work in several processes: of this machine, or of a dask or ray cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from typing import Final, Literal, TypeVar, get_args

from magical_mj.errors import SettingsError, unknown_name

Backend = Literal["local", "dask", "ray"]
BACKENDS: Final[tuple[str, ...]] = get_args(Backend)

Piece = TypeVar("Piece")
Result = TypeVar("Result")

__all__ = ["BACKENDS", "Backend", "check_backend", "cores", "spread"]


def cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_backend(backend: str, jobs: int | None, address: str | None) -> None:
    """Raises a `SettingsError` unless these arguments of `spread` go together."""
    if backend not in BACKENDS:
        raise unknown_name("backend", backend, BACKENDS)
    if jobs is not None and jobs < 1:
        raise SettingsError(f"jobs must be at least 1, not {jobs}")
    if backend == "dask" and not address:
        raise SettingsError("the dask backend needs the scheduler's address, such as tcp://host:8786")
    if backend == "local" and address:
        raise SettingsError("an address is of a cluster: choose the dask or the ray backend")


def spread(
    function: Callable[[Piece], Result],
    pieces: Sequence[Piece],
    jobs: int | None = None,
    backend: str = "local",
    address: str | None = None,
) -> Iterator[Result]:
    """The function's result for each piece of work, done by worker processes, in the order in which they are ready.

    A worker that dies is replaced, and its piece is done again. What the function raises is raised here, and ends all.

    Args:
        function: of one piece. It and the pieces are pickled (by cloudpickle).
        pieces: the work, what takes longest first.
        jobs: how many processes work; None: one for each core, or as many as the cluster has.
        backend: "local", "dask" or "ray".
        address: of the cluster.

    Raises:
        WorkerError: if a piece has cost several workers their lives, or the cluster is not there.
        MissingExtraError: if what the cluster needs is not installed.
    """
    if backend == "local":
        from magical_mj.parallel.local import spread_here

        return spread_here(function, pieces, jobs or cores())
    from magical_mj.parallel.clusters import spread_there

    return spread_there(function, pieces, jobs, backend, address)
