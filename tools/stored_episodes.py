"""Files of episodes in results/ from which pages are made: compressed lines as of an evaluation."""

from __future__ import annotations

import lzma
from collections.abc import Sequence
from pathlib import Path

from magical_mj.evaluation.scores import EpisodeResult, parse
from tools.pages import ROOT

RESULTS = ROOT / "results"


def stored(path: Path) -> list[EpisodeResult]:
    """The episodes in a file; none before it is written."""
    return [parse(line) for line in lzma.decompress(path.read_bytes()).splitlines()] if path.exists() else []


def store(path: Path, episodes: Sequence[EpisodeResult]) -> None:
    """Adds episodes to a file. They replace all earlier ones of the same policies."""
    new = {one.policy for one in episodes}
    lines = "".join(one.line() for one in [*(one for one in stored(path) if one.policy not in new), *episodes])
    path.write_bytes(lzma.compress(lines.encode(), preset=9 | lzma.PRESET_EXTREME))
