"""The shift `words`: other sentences with the same meaning, 25 for each task.

Those of the benchmark's tasks are in words.txt. Other tasks, such as intents, define theirs in `TaskSpec.wordings`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Final

from magical_mj.shifts.shift import Factor, Shift
from magical_mj.tasks.registry import task_name, task_spec
from magical_mj.tasks.spec import as_sentence


def _sentences() -> dict[str, list[list[str]]]:
    """The content of words.txt: for each task its name, and a paragraph of sentences for each strength."""
    text = Path(__file__).with_name("words.txt").read_text("utf-8")
    sections = (section.strip().split("\n\n") for section in text.split("# ")[1:])
    return {task: [group.split("\n") for group in groups] for task, *groups in sections}


SENTENCES: Final[Mapping[str, list[list[str]]]] = MappingProxyType(_sentences())
"""Task -> five sentences for each strength. Strength 1 changes the verb, strength 5 all of the words."""


class Words(Shift):
    """Another instruction with the same meaning, in `info["instruction"]` and in dict observations."""

    name = "words"
    summary = "the instruction: the sentence that describes the task"
    factors = (
        Factor(
            "distance",
            "1 another verb, 2 and 3 other sentences, 4 other nouns, 5 a description",
            (1, 2, 3, 4, 5),
            "exact",
        ),
        Factor("sentence", "which one of that distance", (5, 5, 5, 5, 5), "choice"),
    )

    @classmethod
    def supports(cls, task: str) -> str | None:
        """Supports tasks that have other sentences."""
        return None if _of(task) else "it has no other sentences"

    def instruction(self, instruction: str, task: str) -> str:
        """The drawn sentence. Without the shift, `instruction`."""
        distance = int(self.values["distance"])
        return as_sentence(_of(task)[distance - 1][int(self.values["sentence"])]) if distance else instruction


def _of(task: str) -> Sequence[Sequence[str]]:
    """A task's other sentences by strength; empty if it has none."""
    return SENTENCES.get(task_name(task)) or task_spec(task).wordings
