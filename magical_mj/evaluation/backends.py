"""Where units of work are done: in this process, in local processes, or on a dask or ray cluster, through joblib."""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final, Literal, TypeVar, get_args

from magical_mj.errors import EvaluationError, SettingsError, unknown_name
from magical_mj.evaluation.scores import Score
from magical_mj.evaluation.worker import Unit, play_unit, player
from magical_mj.extras import missing_extra

Backend = Literal["local", "dask", "ray"]
BACKENDS: Final[tuple[str, ...]] = get_args(Backend)

Piece = TypeVar("Piece")
Result = TypeVar("Result")

ROUND: Final = 4
"""Pieces for each worker between two looks at the results, where results cannot be had one by one (ray)."""


def check_backend(backend: str, jobs: int | None, address: str | None) -> None:
    """Raises a `SettingsError` unless these go together."""
    if backend not in BACKENDS:
        raise unknown_name("backend", backend, BACKENDS)
    if jobs is not None and jobs < 1:
        raise SettingsError(f"jobs must be at least 1, not {jobs}")
    if backend == "dask" and not address:
        raise SettingsError("the dask backend needs the scheduler's address, such as tcp://host:8786")
    if backend == "local" and address:
        raise SettingsError("an address is of a cluster: choose the dask or the ray backend")


def play_units(
    units: Sequence[Unit], backend: str = "local", jobs: int | None = 1, address: str | None = None
) -> Iterator[list[Score]]:
    """Plays all units and yields their scores as they come in, in any order.

    Raises:
        EvaluationError: if a worker dies, the cluster is not there, or an extra is missing.
    """
    if backend == "local" and jobs == 1:
        for unit in units:
            yield from ([score] for score in player().play(unit))
        return
    try:
        yield from spread(play_unit, units, backend, jobs, address)
    except pickle.PicklingError as error:
        raise SettingsError(f"the policy cannot be sent to workers ({error}); give it as module:object") from error


def spread(
    function: Callable[[Piece], Result],
    pieces: Sequence[Piece],
    backend: str = "local",
    jobs: int | None = None,
    address: str | None = None,
) -> Iterator[Result]:
    """The function's result for each piece of work, done by worker processes, in any order.

    Raises:
        EvaluationError: if a worker dies, the cluster is not there, or an extra is missing.
    """
    with _parallel(backend, jobs, address) as (joblib, kwargs):
        task = joblib.delayed(function)
        try:
            if backend == "ray":
                size = ROUND * joblib.effective_n_jobs(kwargs["n_jobs"])
                for start in range(0, len(pieces), size):
                    yield from joblib.Parallel(**kwargs)(task(piece) for piece in pieces[start : start + size])
            else:
                yield from joblib.Parallel(return_as="generator_unordered", **kwargs)(task(piece) for piece in pieces)
        except joblib.externals.loky.process_executor.TerminatedWorkerError as error:
            raise EvaluationError("a worker process died, perhaps for want of memory; --resume goes on") from error


@contextmanager
def _parallel(backend: str, jobs: int | None, address: str | None) -> Iterator[tuple[Any, dict[str, Any]]]:
    """The joblib module, set to the backend, and the arguments that its `Parallel` needs."""
    try:
        import joblib
    except ModuleNotFoundError:
        raise missing_extra("several jobs", "eval") from None
    kwargs = {"n_jobs": jobs or -1, "batch_size": 1}
    if backend == "local":  # loky starts fresh processes, as it must be: OpenGL does not survive a fork
        with joblib.parallel_config("loky", inner_max_num_threads=1):
            yield joblib, kwargs
    elif backend == "dask":
        with _dask_client(address) as client, joblib.parallel_config("dask", client=client):
            yield joblib, kwargs
    else:
        _start_ray(address)
        with joblib.parallel_config("ray"):
            yield joblib, kwargs


def _dask_client(address: str | None) -> Any:
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise missing_extra("the dask backend", "dask") from None
    try:
        return Client(address)
    except OSError as error:
        raise EvaluationError(f"no dask scheduler answers at {address}") from error


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
            raise EvaluationError(f"no ray cluster answers at {address}: {error}") from error
