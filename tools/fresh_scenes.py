"""Scores of `relational` in scenes that nobody had played: a table in methods/relational/README.md.

Its author had seen failed test episodes of an earlier version, so its scores in test scenes may be too high. A new
training by results/state-relational/experiment.toml, with ``split = "fresh"`` in a table ``[evaluation]``, plays fresh
scenes. `python -m tools.fresh_scenes FOLDER...` stores the episodes of these evaluations in results/fresh.jsonl.xz, and
`python -m tools.tables` makes the table of them.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from magical_mj.evaluation.reports.intervals import Cell, Estimate, estimate
from magical_mj.evaluation.reports.statistics import by_run_and_scene
from magical_mj.evaluation.scores import frame, read
from magical_mj.leaderboard.entry import read_entry
from magical_mj.leaderboard.standings import GROUPS
from magical_mj.tasks.registry import in_order
from tools.pages import number, table
from tools.stored_episodes import RESULTS, store, stored

FRESH: Final = RESULTS / "fresh.jsonl.xz"
ENTRY: Final = RESULTS / "state-relational"


@cache
def scores() -> tuple[pd.DataFrame, pd.DataFrame]:
    """A row for each episode in fresh scenes of Layout, CountPlus and All, and for the entry's in their test scenes."""
    fresh, own = frame(stored(FRESH)), frame(read_entry(ENTRY).counted)
    fresh = fresh[fresh["variant"].isin(GROUPS["Generalisation"])]
    return fresh, own.merge(fresh[["task", "variant"]].drop_duplicates())


def tasks() -> list[str]:
    """The tasks that were played."""
    return in_order(scores()[0]["task"])


def compared(names: Iterable[str]) -> tuple[float, float, Estimate]:
    """The mean scores in test scenes and in fresh scenes of these tasks, and how much higher the second is.

    Environments count equally.
    """
    chosen, cells = set(names), list[Cell]()
    for sign, played in zip((1, -1), scores(), strict=True):
        for (task, variant), group in played[played["task"].isin(chosen)].groupby(["task", "variant"]):
            cells.append(Cell(by_run_and_scene(group), sign, (sign, task), (sign, task, variant)))
    known, fresh = (float(np.mean([cell.scores.mean() for cell in cells if cell.weight == sign])) for sign in (-1, 1))
    return known, fresh, estimate([cell._replace(weight=2 * cell.weight / len(cells)) for cell in cells])


def tables() -> dict[str, str]:
    """The table of each task, and of all."""
    rows = []
    for name, chosen in {**{task: [task] for task in tasks()}, "All of these": tasks()}.items():
        known, fresh, difference = compared(chosen)
        rows.append((name, number(known), number(fresh), "{:+.2f} [{:+.2f}, {:+.2f}]".format(*difference)))
    return {"fresh": table(("", "Test scenes", "Fresh scenes", "Difference"), rows)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="evaluations")
    store(FRESH, [episode for folder in parser.parse_args().folders for episode in read(folder)])
