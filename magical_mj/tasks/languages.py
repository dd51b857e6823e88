"""Languages of tasks: names such as ``"intent:in(colour=red, region)"``, a prefix and a text of the language.

An installed package announces a language by an entry point, ``intent = "magical_mj.intents.names:LANGUAGE"``. Its name
is the prefix, and the object has the methods of `TaskLanguage`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import EntryPoint
from typing import Final, Protocol

from magical_mj.tasks.spec import TaskSpec
from magical_mj.utils.errors import TaskError
from magical_mj.utils.imports import announced, imported

LANGUAGE_GROUP: Final = "magical_mj.task_languages"
"""The entry-point group of languages."""


class TaskLanguage(Protocol):
    """What an entry point of `LANGUAGE_GROUP` refers to. All texts are without the prefix."""

    def canonical(self, text: str) -> str:
        """The text that results store. Texts of the same task have the same one.

        Raises:
            MagicalError: if the text is not in the language.
        """
        ...

    def spec(self, text: str) -> TaskSpec:
        """The task of a canonical text. The same text always gives an equal task, on every machine.

        Raises:
            MagicalError: if the task does not exist.
        """
        ...

    def members(self, text: str) -> tuple[str, ...]:
        """The texts of the tasks in the set with this name; empty if no set has this name."""
        ...

    def described(self, names: str) -> Iterable[str]:
        """Lines about the tasks of sets and about single ones, separated by commas; "all" means all sets."""
        ...


@cache
def languages() -> Mapping[str, EntryPoint]:
    """The entry points of announced languages by prefix."""
    return announced("task language", LANGUAGE_GROUP, (), str.isalnum, 'intent = "magical_mj.intents.names:LANGUAGE"')


@cache
def _language(prefix: str) -> TaskLanguage:
    return imported("task language", prefix, languages()[prefix], TaskError)


def in_language(task: object) -> bool:
    """Whether a name has the prefix of a language."""
    return isinstance(task, str) and task.partition(":")[0] in languages() and ":" in task


@cache
def canonical_name(task: str) -> str:
    """The name that results store for a name with the prefix of a language.

    Raises:
        MagicalError: if its text is not in the language.
    """
    prefix, _, text = task.partition(":")
    return f"{prefix}:{_language(prefix).canonical(text)}"


@cache
def language_spec(name: str) -> TaskSpec:
    """The task with this canonical name."""
    prefix, _, text = name.partition(":")
    return _language(prefix).spec(text)


def members(task: str) -> list[str]:
    """The names of the tasks in a set of a language, or the name itself."""
    if not in_language(task):
        return [task]
    prefix, _, text = task.partition(":")
    return [f"{prefix}:{member}" for member in _language(prefix).members(text)] or [task]


def described_tasks(prefix: str, names: str) -> Iterable[str]:
    """Lines about tasks of the language with this prefix; see `TaskLanguage.described`."""
    return _language(prefix).described(names)
