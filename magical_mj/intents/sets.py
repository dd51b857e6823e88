"""The sets of intents: for training, for development, and test sets that differ from the training set in one respect.

They are fixed by the protocol number `INTENTS` and the hash of sets.txt, which `python -m tools.intents draw` wrote.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Final

from magical_mj.intents.intent import Intent
from magical_mj.intents.tasks import Task, task_of

DIGEST: Final = "5324e54880e1b2b8e811e2584d7911724ce025c917896eca3df9675ad9b5f3e7"
"""The SHA-256 of sets.txt."""
NAMES: Final[Mapping[str, str]] = {
    "train": "for training",
    "dev": "for inspection and tuning, drawn like the training set",
    "seen": "intents of the training set, with other demo scenes",
    "combined": "relations of the training set in new conjunctions",
    "selector": "blocks selected by odd= or farthest=, which no training intent uses",
    "relation": "the relations corner, apart and robot near, which no training intent uses",
    "long": "three relations of the training set",
}
"""Set -> what is in it."""
FILE: Final = Path(__file__).with_name("sets.txt")


@cache
def tasks_in(name: str) -> tuple[Task, ...]:
    """The tasks of a set."""
    return tuple(map(task_of, _lines()[name]))


@cache
def _lines() -> Mapping[str, list[str]]:
    """Set -> the texts of its tasks. In the file, each set follows a line with its name."""
    sections = (section.strip().split("\n") for section in FILE.read_text("utf-8").split("# ")[1:])
    return {name: texts for name, *texts in sections}


class Sets(Mapping[str, tuple[Intent, ...]]):
    """Set -> its intents, which are read at the first use."""

    def __getitem__(self, name: str) -> tuple[Intent, ...]:
        if name not in NAMES:
            raise KeyError(name)
        return tuple(task.intent for task in tasks_in(name))

    def __iter__(self) -> Iterator[str]:
        return iter(NAMES)

    def __len__(self) -> int:
        return len(NAMES)


SETS: Final = Sets()
"""Set -> its intents, of `train`, `dev`, `seen`, `combined`, `selector`, `relation` and `long`."""
