"""What scores in the test scenes of an environment mean: the floor, and the scenes that refute a shortcut.

The floor is the largest mean score of three agents that do not look: one that does nothing, one that acts randomly, and
one that replays a demonstration. The shortcut is *same place*: to move the blocks that stand where the demonstrations
moved some, or in tasks without a choice of blocks, to bring the robot and the blocks to where they ended in
demonstrations. `python -m tools.test_scenes` makes both files.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Final

from magical_mj.tasks.registry import Pair
from magical_mj.tasks.spec import Rules

BLIND: Final = ("noop", "random", "replay")
"""The agents of the floor, which are entries in results/."""
FLOORS: Final = "floors.csv"
REFUTING: Final = "refuting_scenes.csv"


@cache
def floors(rules: Rules = "paper") -> Mapping[Pair, float]:
    """The floor of each environment, in the 100 test scenes."""
    rows = [row for row in _rows(FLOORS) if row["rules"] == rules]
    return {(row["task"], row["variant"]): max(float(row[agent]) for agent in BLIND) for row in rows}


@cache
def refuting_seeds() -> Mapping[Pair, frozenset[int]]:
    """The seeds of the test scenes that refute the shortcut: a policy that follows it is wrong there.

    Environments without such scenes are left out.
    """
    rows = _rows(REFUTING)
    return {(row["task"], row["variant"]): frozenset(map(int, row["seeds"].split())) for row in rows}


@cache
def new_place_floors() -> Mapping[Pair, float]:
    """The floor in the scenes of `refuting_seeds`, by the paper's rules."""
    return {(row["task"], row["variant"]): float(row["floor"]) for row in _rows(REFUTING)}


def _rows(name: str) -> list[dict[str, str]]:
    text = (files("magical_mj.evaluation") / name).read_text("utf-8")
    return list(csv.DictReader(text.splitlines()))
