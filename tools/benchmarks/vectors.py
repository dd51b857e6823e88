"""Steps per second of wall time of a vector, alone and beside busy processes: ``python -m tools.benchmarks.vectors``.

How many of the cores it was given says whether others' work or its own waiting makes it slow.
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
from magical_mj.envs.vector import VectorEnv
from magical_mj.scene.actions import ACTIONS
from magical_mj.utils.parallel import cores

TURN = 2.0  # seconds of steps


def main(
    task: str = "MatchRegions",
    variant: str = "Demo",
    preset: str = "LoRes4E",
    renderer: str = "software",
    worlds: int = 32,
    busy: Annotated[int, typer.Option(help="Processes that keep a core busy beside it.")] = cores(),
    rounds: int = 5,
) -> None:
    """Prints the median and the least of rounds that alternate: one thread, and all cores; alone, and beside others."""
    rates: dict[tuple[int, int], list[tuple[float, float]]] = {}
    settings = {"variant": variant, "preset": preset, "renderer": renderer}
    for _ in range(rounds):
        for load in (0, busy):
            for threads in (1, cores()):
                with closing(magical_mj.make_vec(task, worlds, threads=threads, **settings)) as envs, busy_beside(load):
                    rates.setdefault((load, threads), []).append(rate(envs))
    for (load, threads), measured in rates.items():
        beside = f"beside {load} busy processes" if load else "alone"
        steps, given = map(median, zip(*measured, strict=True))
        typer.echo(
            f"{threads} threads, {beside}: {steps:,.0f} steps/s on {given:.2f} cores, at least {min(measured)[0]:,.0f}"
        )


def rate(envs: VectorEnv) -> tuple[float, float]:
    """Steps per second of all worlds, of random actions for `TURN` seconds, and how many cores that took."""
    rng = np.random.default_rng(0)
    envs.reset(seed=0)
    count, start, before = 0, perf_counter(), process_time()
    while (taken := perf_counter() - start) < TURN:
        envs.step(rng.integers(len(ACTIONS), size=envs.num_envs))
        count += envs.num_envs
    return count / taken, (process_time() - before) / taken


@contextmanager
def busy_beside(count: int) -> Iterator[None]:
    """So many processes that do nothing but compute."""
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
