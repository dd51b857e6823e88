"""The names ``"intent:TEXT"``, ``"intent:SET/NUMBER"`` and ``"intent:SET"``; see `magical_mj.tasks.languages`."""

from __future__ import annotations

import re
from typing import Final

from magical_mj.intents import EIGHT
from magical_mj.intents.intent import Intent
from magical_mj.intents.sets import NAMES, tasks_in
from magical_mj.intents.tasks import PREFIX, Task, spec_of, task_of, with_settings
from magical_mj.tasks.spec import TaskSpec
from magical_mj.utils.errors import IntentError, closest

_MEMBER: Final = re.compile(r"\s*([a-z]+)\s*(?:/\s*(\d+))?\s*(\[[^\[\]]*\])?\s*")


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
        found = _MEMBER.fullmatch(text)
        if found is None or found[1] not in NAMES or found[2] is not None:
            return ()
        return tuple(str(with_settings(task, found[3] or "")) for task in tasks_in(found[1]))


def has_intent(task: str) -> bool:
    """Whether the language has the intent of a task, by its stored name."""
    return task.startswith(PREFIX) or task in EIGHT


def task_intent(task: str) -> Intent:
    """The intent of a task that has one."""
    return task_of(task.removeprefix(PREFIX)).intent if task.startswith(PREFIX) else EIGHT[task]


def _task(text: str) -> Task:
    found = _MEMBER.fullmatch(text)
    if found is None:
        return task_of(text)
    if found[1] not in NAMES:
        like = f"{meant}{text[found.end(1) :]}" if (meant := closest(found[1], NAMES)) else ""
        raise IntentError(
            f"{text!r} is neither an intent, such as 'in(colour=red, region)', nor one of a set, such as 'dev/3'. "
            + (f"Did you mean {like!r}?" if like else f"The sets are {', '.join(NAMES)}")
        )
    tasks = tasks_in(found[1])
    if found[2] is None or int(found[2]) >= len(tasks):
        raise IntentError(f"{text} names no task: the set {found[1]} has {found[1]}/0 to {found[1]}/{len(tasks) - 1}")
    return with_settings(tasks[int(found[2])], found[3] or "")


LANGUAGE: Final = Language()
