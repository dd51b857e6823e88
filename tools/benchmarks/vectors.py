"""Measures steps per second (wall time) of a vector, with and without load: ``python -m tools.benchmarks.vectors``.

The number of cores that it used shows whether the load or its own waiting makes it slow.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from multiprocessing import get_context
from statistics import median
from time import perf_counter, process_time
from typing import Annotated

import numpy as np
import typer

import magical_mj
from magical_mj.actions import ACTIONS
from magical_mj.envs.vector import VectorEnv
from magical_mj.utils.parallel import cores

TURN = 2.0  # seconds of steps


def main(
    task: str = "MatchRegions",
    variant: str = "Demo",
    preset: str = "LoRes4E",
    renderer: str = "software",
    num_envs: int = 32,
    busy: Annotated[int, typer.Option(help="The number of other processes that keep a core busy.")] = cores(),
    rounds: int = 5,
) -> None:
    """Prints the median and the minimum of alternating rounds: with one thread and all cores, with and without load."""
    rates: dict[tuple[int, int], list[tuple[float, float]]] = {}
    settings = {"variant": variant, "preset": preset, "renderer": renderer}
    for _ in range(rounds):
        for load in (0, busy):
            for threads in (1, cores()):
                with (
                    closing(magical_mj.make_vec(task, num_envs, threads=threads, **settings)) as envs,
                    busy_processes(load),
                ):
                    rates.setdefault((load, threads), []).append(rate(envs))
    for (load, threads), measured in rates.items():
        others = f"with {load} other busy processes" if load else "without load"
        steps, used = map(median, zip(*measured, strict=True))
        typer.echo(
            f"{threads} threads, {others}: {steps:,.0f} steps/s on {used:.2f} cores, at least {min(measured)[0]:,.0f}"
        )


def rate(envs: VectorEnv) -> tuple[float, float]:
    """Takes random actions for `TURN` seconds. Returns the total steps per second, and the number of cores used."""
    rng = np.random.default_rng(0)
    envs.reset(seed=0)
    count, start, before = 0, perf_counter(), process_time()
    while (taken := perf_counter() - start) < TURN:
        envs.step(rng.integers(len(ACTIONS), size=envs.num_envs))
        count += envs.num_envs
    return count / taken, (process_time() - before) / taken


@contextmanager
def busy_processes(count: int) -> Iterator[None]:
    """A context with `count` other processes that each keep a core busy."""
    processes = [get_context("spawn").Process(target=spin, daemon=True) for _ in range(count)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.join()


def spin() -> None:
    """Computes until it is killed."""
    while True:
        pass


if __name__ == "__main__":
    typer.run(main)
