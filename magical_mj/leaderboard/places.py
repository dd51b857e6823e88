"""The environments that entries can hold: the benchmark's, also with shifts, and those of the test sets of intents."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from itertools import product

from magical_mj.intents.names import OFFICIAL_EPISODES, OFFICIAL_VARIANTS, TESTS, tasks_in
from magical_mj.intents.tasks import PREFIX
from magical_mj.protocol import SEEDS
from magical_mj.shifts import expand_shifts, shift_label
from magical_mj.tasks.registry import ENVIRONMENTS, Pair


@cache
def intents() -> tuple[Pair, ...]:
    """The environments of the official evaluation on intents."""
    tasks = (f"{PREFIX}{task}" for name in TESTS for task in tasks_in(name))
    return tuple(product(tasks, OFFICIAL_VARIANTS))


@cache
def places() -> Mapping[Pair, int]:
    """Environment -> the number of its episodes that count. Demo of intents has a place, but is not required."""
    demos = ((task, "Demo") for task, _ in intents())
    return dict.fromkeys(ENVIRONMENTS, SEEDS) | dict.fromkeys((*intents(), *demos), OFFICIAL_EPISODES)


@cache
def track(task: str) -> tuple[str, ...]:
    """A task's shift track, in its demo variant: the labels of the built-in shifts that it supports, all strengths."""
    return tuple(map(shift_label, expand_shifts("all", task)))


def in_track(task: str, variant: str, shift: str) -> bool:
    """Whether a shifted episode is in the shift track."""
    return variant == "Demo" and (task, variant) in ENVIRONMENTS and shift in track(task)


def place_of(environment: str) -> tuple[str, str, str]:
    """The task, the variant and the shift of an environment with a name such as "FindDupe-Demo camera:3"."""
    if environment.startswith(PREFIX):  # its text contains spaces
        task, _, variant = environment.rpartition("-")
        return task, variant, ""
    pair, _, shift = environment.partition(" ")
    task, _, variant = pair.partition("-")
    return task, variant, shift
