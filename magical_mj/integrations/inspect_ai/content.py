"""Texts and scenes as models receive them."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from typing import Final

from inspect_ai.model import Content, ContentImage, ContentText

from magical_mj.intents.question_pictures import png
from magical_mj.intents.question_text import table
from magical_mj.scene import Scene

FORMS: Final = ("text", "pictures", "both")
"""How scenes are shown: as tables of poses, as pictures with numbered blocks, or as both."""


def contents(part: str | Scene, form: str) -> Iterator[Content]:
    """A part of a question; see `FORMS`."""
    if isinstance(part, str):
        yield ContentText(text=part)
        return
    if form != "pictures":
        yield ContentText(text=table(part))
    if form != "text":
        yield ContentImage(image=f"data:image/png;base64,{base64.b64encode(png(part)).decode()}")
