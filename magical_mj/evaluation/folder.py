"""The folder of an evaluation: its settings in ``run.json``, and starting or resuming it.

An evaluation can be resumed only with the settings with which it was started.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from os import PathLike
from pathlib import Path
from typing import Any, Final

from magical_mj.evaluation.scores import SCORES, Score, ScoreFile, read
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError, SettingsError, shown
from magical_mj.utils.settings import check_unchanged

SETTINGS: Final = "run.json"


def folders_of(folders: Iterable[Path | str]) -> list[Path]:
    """The folders as a list; raises a `SettingsError` for a single one, since a text is a sequence of letters."""
    if isinstance(folders, str | bytes | PathLike):
        raise SettingsError(f"give a list of folders, such as [{str(folders)!r}], not {shown(folders)}")
    return [Path(folder) for folder in folders]


def prepare(folder: Path, settings: dict[str, Any], resume: bool) -> list[Score]:
    """Makes the folder, or reads what is in it. An evaluation without finished episodes is started anew.

    Raises:
        EvaluationError: if it cannot be written to, holds something else, or holds an evaluation and `resume` is false.
        SettingsError: if it was started with other settings.
    """
    path = folder / SCORES
    if path.exists() and path.stat().st_size and not resume:
        raise EvaluationError(f"{folder} holds an evaluation already; --resume continues it (resume=True)")
    if (folder / SETTINGS).exists() and "policies" not in read_settings(folder):
        raise EvaluationError(f"{folder / SETTINGS} is not of an evaluation; choose another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ScoreFile(folder):
            return load_or_start(folder, settings)
    except OSError as error:
        raise EvaluationError(f"cannot write into {folder}: {error.strerror}") from error


def load_or_start(folder: Path, settings: dict[str, Any]) -> list[Score]:
    """The finished episodes in a folder whose `ScoreFile` is open; if there are none, its settings become these.

    Raises:
        EvaluationError, SettingsError: as `prepare`.
    """
    if (folder / SCORES).stat().st_size:
        check_unchanged(folder, _wherever(read_settings(folder)), _wherever(settings))
        return read(folder)
    files.write(folder / SETTINGS, json.dumps(settings, indent=2) + "\n", overwrite=True)
    return []


def _wherever(settings: dict[str, Any]) -> dict[str, Any]:
    """The settings without the paths of policies that a hash identifies: folders may be moved, or written otherwise."""
    policies = settings.get("policies")
    if not isinstance(policies, list):
        return settings
    known = [dict(one) for one in policies if isinstance(one, dict)]
    return {**settings, "policies": [{**one, "origin": None} if "sha256" in one else one for one in known]}


def read_settings(folder: Path) -> dict[str, Any]:
    """The settings with which the evaluation in a folder was started.

    Raises:
        EvaluationError: if they cannot be read.
    """
    try:
        known = dict(json.loads((folder / SETTINGS).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise EvaluationError(f"{folder / SETTINGS} cannot be read ({error}); start again in another folder") from error
    return {"worlds": "single", **known}  # older versions knew no others
