"""Intents: a language of goals over scenes.

An intent is one to three relations, joined by ``&``. A relation says what must hold for some blocks in the final scene.
The blocks are selected in the initial scene. docs/intents-language.md describes the language.

Every intent is a task: its name is ``"intent:"`` and the text, or ``"intent:combined/17"`` for an intent of `SETS`.

Example:
    >>> intent = magical_mj.intents.parse("in(colour=red, region) & untouched(others)")
    >>> intent.sentence
    'Bring all red blocks into the region, and leave all other blocks where they are.'
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from magical_mj.intents.ambiguity import explain, rivals
from magical_mj.intents.floors import shortcuts
from magical_mj.intents.intent import Intent, parse
from magical_mj.intents.names import EIGHT, SETS
from magical_mj.intents.question import question_of, questions

if TYPE_CHECKING:
    from magical_mj.intents.expert_data import dataset

__all__ = [
    "EIGHT",
    "SETS",
    "Intent",
    "dataset",
    "explain",
    "parse",
    "question_of",
    "questions",
    "rivals",
    "shortcuts",
]


def __getattr__(name: str) -> Any:
    """Imports `dataset` at first use, since it loads the simulator, which the help of commands does not need."""
    if name == "dataset":
        from magical_mj.intents.expert_data import dataset

        return dataset
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
