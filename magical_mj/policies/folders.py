"""Folders that hold a policy, such as those of trainings. Other packages may add kinds of them: see pyproject.toml."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Final

FOLDERS: Final = "magical_mj.policy_folders"
"""The group of entry points that load the policy in a folder; the name of each is that of a file in its folders."""


def loader_in(folder: Path) -> EntryPoint | None:
    """The entry point that loads the policy in a folder; None if there is no policy."""
    return next((loader for loader in entry_points(group=FOLDERS) if (folder / loader.name).is_file()), None)
