"""The draws of intents' tasks: the demo scenes and the horizon.

Each demo scene is one of many random scenes, the first that fits or the best of some. The search takes plans in tens of
scenes. So its results are stored: those of the sets in sets.jsonl, others in the user's cache folder. The first demo
scene is stored as the number of its draw, and further ones, which the file has for test sets, as JSON.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Final

import msgspec

from magical_mj._version import __version__
from magical_mj.protocol import INTENTS, PROTOCOL
from magical_mj.utils import files

FILE: Final = Path(__file__).with_name("sets.jsonl")


class Draws(msgspec.Struct, frozen=True, omit_defaults=True):
    """The draws of a task.

    Attributes:
        task: the text of the intent, with the seed of its demo scenes if it is not 0.
        steps: the horizon.
        first: the number of the draw of the first demo scene.
        random_demos: the random demo scenes after the first, as far as known.
        contrasting_demos: the contrasting ones.
        set: the set that it is in.
        cost: the mean cost of plans in Layout and All, in actions; 0 if it is not known.
        moves: the mean number of blocks that these plans move.
        left_out: the digests of scenes that are not used as further demo scenes, since the expert cannot solve them.
    """

    task: str
    steps: int
    first: int
    random_demos: tuple[msgspec.Raw, ...] = ()
    contrasting_demos: tuple[msgspec.Raw, ...] = ()
    set: str = ""
    cost: float = 0.0
    moves: float = 0.0
    left_out: tuple[str, ...] = ()


@cache
def in_sets() -> tuple[Draws, ...]:
    """The tasks of all sets, in the order of the file."""
    return tuple(msgspec.json.decode(line, type=Draws) for line in FILE.read_bytes().splitlines())


@cache
def _shipped() -> Mapping[str, Draws]:
    return {draws.task: draws for draws in in_sets()}


_cached: dict[str, Draws] = {}
"""The content of the cache file, with what this process has found."""


def known(task: str, enough: Callable[[Draws], bool]) -> Draws | None:
    """The stored draws of a task, if any. The cache file is read unless others are `enough`."""
    found = _cached.get(task) or _shipped().get(task)
    if found is None or not enough(found):
        _cached.update((draws.task, draws) for draws in _readable(_path()))
        found = _cached.get(task, found)
    return found


def remember(draws: Draws) -> None:
    """Adds draws to the cache file, if the user's cache folder can be written."""
    _cached[draws.task] = draws
    try:
        _path().parent.mkdir(parents=True, exist_ok=True)
        with _path().open("ab") as file:
            file.write(msgspec.json.encode(draws) + b"\n")  # one write, so lines of several processes do not mix
    except OSError:
        pass


def _path() -> Path:
    """The cache file of this version and these protocols."""
    return files.cache_folder() / f"intents-p{PROTOCOL}-i{INTENTS}-{__version__}.jsonl"


def _readable(path: Path) -> Iterable[Draws]:
    """The draws in a file. A line that a killed process left incomplete is skipped."""
    try:
        lines = path.read_bytes().splitlines()
    except OSError:
        return
    for line in lines:
        try:
            yield msgspec.json.decode(line, type=Draws)
        except msgspec.MsgspecError:
            continue
