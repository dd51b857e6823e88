"""Measures the time and memory of a report of many episodes: ``python tools/benchmarks/reports.py [EPISODES]``."""

from __future__ import annotations

import json
import resource
import tempfile
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from magical_mj.evaluation.reports.report import report
from magical_mj.evaluation.scores import SCORES
from magical_mj.tasks.registry import ENVIRONMENTS

SEEDS = 100
RUNS = 5
LENGTH = 80  # actions of an episode


def write(path: Path, episodes: int) -> None:
    """Writes `episodes` scores of several methods with five runs of a hundred episodes in each environment."""
    rng = np.random.default_rng(0)
    row = {"seconds": 0.5, "rules": "paper", "preset": "LoRes4E", "version": "0.1.0", "mujoco": "3.17.0", "gl": "egl"}
    with path.open("w") as file:
        for number in range(episodes):
            rest, seed = divmod(number, SEEDS)
            rest, environment = divmod(rest, len(ENVIRONMENTS))
            method, run = divmod(rest, RUNS)
            task, variant = ENVIRONMENTS[environment]
            episode = {"policy": f"method {method}", "run": run, "task": task, "variant": variant, "seed": seed}
            played = {"score": float(rng.integers(5)) / 4, "steps": LENGTH, "actions": "a" * LENGTH, "failure": None}
            scene = {"scene": f"{environment * SEEDS + seed:016x}", "worlds": "single"}
            file.write(json.dumps({**episode, **row, **played, **scene}) + "\n")


def main(episodes: Annotated[int, typer.Argument(min=1)] = 100_000) -> None:
    """Prints the duration of a report of this many episodes, and its peak memory."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / SCORES, episodes)
        wall, processor = time.perf_counter(), time.process_time()
        report([folder], Path(folder) / "report")
        wall, processor = time.perf_counter() - wall, time.process_time() - processor
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000
    typer.echo(f"{episodes} episodes: {wall:.1f} s, {processor:.1f} s of processor time, {memory:.0f} MB at most")


if __name__ == "__main__":
    typer.run(main)
