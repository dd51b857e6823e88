"""Many pieces of work in several processes, with a progress bar."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Annotated, Any, TypeVar

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

Jobs = Annotated[int | None, typer.Option(min=1, help="Worker processes.", show_default="one per core")]

_T = TypeVar("_T")


def cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_parallel(
    screen: Console, label: str, function: Callable[..., _T], work: Sequence[tuple[Any, ...]], jobs: int | None
) -> Iterator[_T]:
    """The results of `function(*piece)` for each piece of work, in the order in which they are ready.

    The processes are spawned: a forked one may hang once its parent has drawn.
    """
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    context = multiprocessing.get_context("spawn")
    number = max(1, min(jobs or cores(), len(work)))
    with ProcessPoolExecutor(number, mp_context=context) as pool, Progress(*columns, console=screen) as progress:
        bar = progress.add_task(label, total=len(work))
        futures = [pool.submit(function, *piece) for piece in work]
        try:
            for future in as_completed(futures):
                yield future.result()
                progress.advance(bar)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
