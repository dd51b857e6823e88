"""The folder of an evaluation: starting one, and going on in one only with the settings that it was started with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from magical_mj.errors import EvaluationError, SettingsError
from magical_mj.evaluation.scores import SCORES, Score, ScoreFile, read

SETTINGS: Final = "run.json"
SHOWN: Final = 300
"""Letters of a setting that an error shows."""


def prepare(folder: Path, settings: dict[str, Any], resume: bool) -> list[Score]:
    """Makes the folder, or reads what is in it.

    Raises:
        EvaluationError: if it cannot be written to, or holds something else, or something and `resume` is false.
        SettingsError: if it was started with other settings.
    """
    started = (folder / SETTINGS).exists() or (folder / SCORES).exists()
    if started and not resume:
        raise EvaluationError(f"{folder} holds an evaluation already; --resume goes on with it (resume=True)")
    if not started:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / SETTINGS).write_text(json.dumps(settings, indent=2) + "\n")
        except OSError as error:
            raise EvaluationError(f"cannot write into {folder}: {error.strerror}") from error
        return []
    _compare(folder, settings)
    with ScoreFile(folder):  # which mends its end
        return read(folder) if (folder / SCORES).stat().st_size else []


def _compare(folder: Path, settings: dict[str, Any]) -> None:
    """Raises a `SettingsError` that names what differs from the settings that the folder was started with."""
    try:
        before = json.loads((folder / SETTINGS).read_text())
    except (OSError, ValueError) as error:
        raise EvaluationError(f"{folder / SETTINGS} cannot be read ({error}); start again in another folder") from error
    differences = [
        f"{name} was {_short(before.get(name))} and is {_short(now)}"
        for name, now in settings.items()
        if before.get(name) != now
    ]
    if differences:
        raise SettingsError(f"{folder} was started with other settings: {'; '.join(differences)}")


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= SHOWN else f"{text[: SHOWN // 2]} ... {text[-SHOWN // 2 :]}"
