"""Named intents: those of the benchmark's eight tasks, and the sets of intents. Also the names of intents' tasks.

The names of tasks are ``"intent:TEXT"``, ``"intent:SET/NUMBER"`` and ``"intent:SET"``; see
`magical_mj.tasks.languages`.

There is a set for training, one for development, and test sets that differ from the training set in one respect. They
are fixed by the protocol number `INTENTS` and the hash of sets.jsonl, which `python -m tools.intent_sets draw` wrote.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import cache
from types import MappingProxyType
from typing import Final

from magical_mj.intents.draws import in_sets
from magical_mj.intents.intent import Intent, parse
from magical_mj.intents.tasks import PREFIX, Task, spec_of, split_settings, task_of, with_settings
from magical_mj.tasks.registry import listed
from magical_mj.tasks.spec import TaskSpec
from magical_mj.utils.errors import IntentError, closest, short_repr

EIGHT: Final[Mapping[str, Intent]] = MappingProxyType(
    {
        task: parse(text)
        for task, text in {
            "MoveToCorner": "near corner(all, top left)",
            "MoveToRegion": "robot in()",
            "MatchRegions": "in(colour=region, region) & out(colour!=region)",
            "MakeLine": "line(all)",
            "FindDupe": "in(starts=in, region) & in(any, like=both, region) & out(like!=both)",
            "FixColour": "in(starts=matched, home) & out(starts=mismatched)",
            "ClusterColour": "clustered(all, by=colour)",
            "ClusterShape": "clustered(all, by=shape)",
        }.items()
    }
)
"""Task -> the intent that holds if and only if the task's score is 1."""
DIGEST: Final = "8614d63fde208a16444e7e9d44f73fbb6b2a23b92d52730024689e5549222266"
"""The SHA-256 of sets.jsonl."""
NAMES: Final[Mapping[str, str]] = {
    "train": "for training",
    "dev": "for inspection and tuning, drawn like the training set",
    "seen": "intents of the training set, with other demo scenes",
    "combined": "relations of the training set in new conjunctions",
    "selector": "blocks selected by odd= or farthest=, which no training intent uses",
    "relation": "the relations corner, apart and robot near, which no training intent uses",
    "long": "the relations of seen with a third one of the training set",
}
"""Set -> a description of its intents."""
TESTS: Final = ("seen", "combined", "selector", "relation", "long")
"""The test sets."""
OFFICIAL_VARIANTS: Final = ("Layout", "All")
OFFICIAL_EPISODES: Final = 2
"""The variants of the official evaluation on the test sets, and its number of episodes in each."""


@cache
def tasks_in(name: str) -> tuple[Task, ...]:
    """The tasks of a set."""
    return tuple(task_of(draws.task) for draws in in_sets() if draws.set == name)


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

_MEMBER: Final = re.compile(r"([a-z]+)(?:\s*/\s*(\d+))?")
_MOST_DIGITS: Final = 9
"""The number of digits in the number of an intent in a set."""


class Language:
    """The language of the prefix ``"intent:"``."""

    def canonical(self, text: str) -> str:
        """The canonical text of an intent or of a member of a set."""
        return str(_task(text))

    def spec(self, text: str) -> TaskSpec:
        """The task of a canonical text."""
        return spec_of(task_of(text))

    def members(self, text: str) -> tuple[str, ...]:
        """The texts of the tasks in a set; settings of demo scenes after its name apply to all."""
        name, settings = split_settings(text)
        return tuple(str(with_settings(task, settings)) for task in tasks_in(name)) if name in NAMES else ()

    def described(self, names: str) -> Iterator[str]:
        """Lines about sets of intents or single ones: the name, bits, text and sentence."""
        for name in listed(names, NAMES):
            name = name.removeprefix(PREFIX)
            if name in NAMES:
                tasks = {f"{PREFIX}{name}/{number}": task for number, task in enumerate(tasks_in(name))}
            else:
                tasks = {f"{PREFIX}{name}": _task(name)}
            for label, task in tasks.items():
                yield f"{label:<19} {task.intent.bits:2.0f} bits  {task}: {task.intent.sentence}"


def has_intent(task: str) -> bool:
    """Whether the language has the intent of a task, by its stored name."""
    return task.startswith(PREFIX) or task in EIGHT


def task_intent(task: str) -> Intent:
    """The intent of a task that has one."""
    return task_of(task.removeprefix(PREFIX)).intent if task.startswith(PREFIX) else EIGHT[task]


def _task(text: str) -> Task:
    member, settings = split_settings(text)
    found = _MEMBER.fullmatch(member)
    if found is None:
        return task_of(text)
    name, number = found.groups()
    if name not in NAMES:
        meant = closest(name, NAMES)
        like = f"{meant}{member[found.end(1) :]} {settings}".rstrip() if meant else ""
        raise IntentError(
            f"{short_repr(text)} is neither an intent, such as 'in(colour=red, region)', nor one of a set, such as "
            "'dev/3'. " + (f"Did you mean {short_repr(like)}?" if like else f"The sets are {', '.join(NAMES)}")
        )
    tasks = tasks_in(name)
    if number is None or len(number) > _MOST_DIGITS or int(number) >= len(tasks):
        raise IntentError(f"{short_repr(text)} does not exist: the set {name} has {name}/0 to {name}/{len(tasks) - 1}")
    return with_settings(tasks[int(number)], settings)


LANGUAGE: Final = Language()
