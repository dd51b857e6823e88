"""Worker processes of a dask cluster, or of a ray cluster through joblib."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Any, Final, TypeVar

from magical_mj.utils.errors import WorkerError
from magical_mj.utils.extras import missing_extra

Piece = TypeVar("Piece")
Result = TypeVar("Result")

ROUND: Final = 4
"""Pieces per worker in a batch, for backends that cannot return results one by one (ray)."""
PATIENCE: Final = 10
"""Seconds within which a dask cluster must have a worker."""


def map_on_cluster(
    function: Callable[[Piece], Result], pieces: Sequence[Piece], jobs: int | None, backend: str, address: str | None
) -> Iterator[Result]:
    """See `magical_mj.utils.parallel.map_unordered`."""
    yield from (_through_dask if backend == "dask" else _through_ray)(function, pieces, jobs, address)


def _through_dask(
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


def _through_ray(
    function: Callable[[Piece], Result], pieces: Sequence[Piece], jobs: int | None, address: str | None
) -> Iterator[Result]:
    _start_ray(address)
    import joblib

    task, arguments = joblib.delayed(function), {"n_jobs": jobs or -1, "batch_size": 1}
    with joblib.parallel_config("ray"):
        size = ROUND * joblib.effective_n_jobs(arguments["n_jobs"])
        for start in range(0, len(pieces), size):
            yield from joblib.Parallel(**arguments)(task(piece) for piece in pieces[start : start + size])


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


def _start_ray(address: str | None) -> None:
    try:
        import ray  # pyright: ignore[reportMissingImports]
        from ray.util.joblib import register_ray  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError:
        raise missing_extra("the ray backend", "ray") from None
    register_ray()
    if not ray.is_initialized():
        try:
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
        except (ConnectionError, ValueError) as error:
            raise WorkerError(f"no ray cluster answers at {address}: {error}") from error
