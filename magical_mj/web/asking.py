"""Questions for people: the page choose.html shows them in pictures, as models are asked by `choose`."""

from __future__ import annotations

from typing import Any, Final

from magical_mj.intents.choices import SHORTCUTS
from magical_mj.intents.intent import parse
from magical_mj.intents.question import Question, questions
from magical_mj.web.page_data import scene_data

SET: Final = "combined"
SCENES: Final = 2
"""The number of demonstrations, each in its own demo scene."""
ASKED: Final = 24
"""The number of questions on the documentation site."""


def asked(limit: int = ASKED) -> list[Question]:
    """The questions of the page."""
    return list(questions("choose", SET, scenes=SCENES, limit=limit))


def question_data(question: Question, *, answers: bool) -> dict[str, Any]:
    """The page's data of a question. In studies, it is sent without the answer and what the options follow."""
    data: dict[str, Any] = {
        "id": question.id,
        "demonstrations": [[scene_data(shown[0]), scene_data(shown[-1])] for shown in question.demonstrations],
        "scene": scene_data(question.scene),
        "options": [scene_data(option) for option in question.options],
    }
    if answers:
        readings = [question.intent.sentence if one == "intended" else _words(one) for one in question.readings]
        data |= {"answer": question.answer, "readings": readings}
    return data


def _words(reading: str) -> str:
    return f"{reading}." if reading in SHORTCUTS else parse(reading).sentence
