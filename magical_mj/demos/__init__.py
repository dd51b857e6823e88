"""Demonstrations: the shipped ones, your own files, and their conversion for learners and other tools.

Example:
    >>> demos = magical_mj.demos.load("FindDupe")  # 25 by the expert, all with score 1
    >>> observations, actions = magical_mj.demos.transitions(demos, "LoRes4E")  # (n, 96, 96, 12) uint8, (n,) uint8
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from magical_mj.demos.archive import to_npz
from magical_mj.demos.demonstration import Demonstration, files_in, keep, read, write
from magical_mj.demos.learning import Transitions, observations, stream, transitions
from magical_mj.demos.original import from_original
from magical_mj.demos.recording import (
    MAX_BYTES,
    Diversity,
    Imported,
    Recorder,
    Verdict,
    demonstrate,
    diversity,
    from_recording,
    recorded,
    render_demo,
    verify,
)
from magical_mj.demos.shipped import load

__all__ = [
    "MAX_BYTES",
    "Demonstration",
    "Diversity",
    "Imported",
    "Recorder",
    "Transitions",
    "Verdict",
    "demonstrate",
    "diversity",
    "files_in",
    "from_original",
    "from_recording",
    "keep",
    "load",
    "observations",
    "read",
    "recorded",
    "render_demo",
    "stream",
    "to_minari",  # pyright: ignore[reportUnsupportedDunderAll] - an addition, which the core does not import
    "to_npz",
    "transitions",
    "verify",
    "write",
]


def __getattr__(name: str) -> Any:
    """Imports the export to Minari at first use."""
    if name == "to_minari":
        return import_module("magical_mj.exports.minari").to_minari
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
