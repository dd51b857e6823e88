"""The commands of intents, as `magical_mj.cli.app.COMMANDS` lists those of the core."""

from __future__ import annotations

from typing import Final

COMMANDS: Final = {
    "demos intents": ("magical_mj.intents.cli.make:make_intents", "Make demonstrations of intents."),
    "demos questions": ("magical_mj.intents.cli.questions:make_questions", "Make questions about demonstrations."),
}
