"""Measures the scripted expert's score in each task with each body, for the table in docs/bodies.md.

    python tools/bodies.py [--tasks MoveToRegion,...] [--bodies shortstick,...] [--seeds 20] [--variants Demo,All]

Prints the mean score of each task and body over seeds of the dev split; successive seeds use successive variants.
Bodies that a task does not offer are tried as well. A task should not offer a body with a mean below 0.9. An evaluation
stops early when its mean can no longer reach that.
"""

from __future__ import annotations

import argparse
import itertools
from contextlib import closing

from magical_mj import tasks
from magical_mj.engine import Engine
from magical_mj.experts import expert_of
from magical_mj.scene.bodies import BODIES
from magical_mj.tasks.registry import SPLITS, task_spec
from magical_mj.utils.errors import MagicalError

OFFERED = 0.9
"""The mean score that a task requires to offer a body."""


def score(task: str, variant: str, seed: int, body: str) -> float:
    """The expert's score in one episode."""
    with closing(Engine(task, variant, seed=seed, body=body)) as engine:
        expert = expert_of(engine, task, 0)
        while not engine.step(expert()):
            pass
        return engine.score()


def mean_score(task: str, body: str, variants: list[str], seeds: int) -> str:
    """The mean score, the number of episodes, and the number of seeds without a scene for this body."""
    scores, impossible = [], 0
    for seed, variant in zip(range(SPLITS["dev"], SPLITS["dev"] + seeds), itertools.cycle(variants), strict=False):
        try:
            scores.append(score(task, variant, seed, body))
        except MagicalError:
            impossible += 1
        if sum(1 - each for each in scores) > (1 - OFFERED) * seeds:
            break
    mean = f"{sum(scores) / len(scores):.2f} ({len(scores)})" if scores else "-"
    return f"{mean}, {impossible} without a scene" if impossible else mean


def main() -> None:
    """Prints a line for each cell of the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--tasks", default=",".join(tasks.KNOWN))
    parser.add_argument("--bodies", default=",".join(BODIES))
    parser.add_argument("--variants", default="Demo,Layout,All")
    parser.add_argument("--seeds", type=int, default=20)
    options = parser.parse_args()
    for task in options.tasks.split(","):
        spec = task_spec(task)
        object.__setattr__(spec, "bodies", tuple(BODIES))  # try bodies that the task does not offer
        chosen = [variant for variant in options.variants.split(",") if variant in spec.variants]
        for body in options.bodies.split(","):
            print(f"{task:14} {body:12} {mean_score(task, body, chosen, options.seeds)}", flush=True)


if __name__ == "__main__":
    main()
