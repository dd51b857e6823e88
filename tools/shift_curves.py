"""Scores of behavioural cloning from states under shifts: the second table of docs/shift-curves.md.

tools/shifts.sh trains and evaluates it. `python -m tools.shift_curves runs/shifts/BC-states-*-0-scores` then packs the
episodes into results/shifts.jsonl.xz, and `python -m tools.tables` makes the table of them.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

import pandas as pd

from magical_mj.evaluation.scores import read
from magical_mj.shifts.registry import axis_and_strength
from tools.pages import number, table
from tools.stored_episodes import RESULTS, store, stored

EPISODES: Final = RESULTS / "shifts.jsonl.xz"
STRENGTHS: Final = range(6)


def tables() -> dict[str, str]:
    """The mean scores by axis and strength. All tasks count equally. The lowest score at strength 5 comes first."""
    rows = [(*(axis_and_strength(one.shift) or ("", 0)), one.task, one.score) for one in stored(EPISODES)]
    found = pd.DataFrame(rows, columns=["axis", "strength", "task", "score"])
    of_task = found.groupby(["axis", "strength", "task"])["score"].mean()
    plain, lines = of_task[""][0], list[list[str]]()
    axes = of_task.drop("").groupby(["axis", "strength"]).mean().unstack("strength").sort_values(STRENGTHS[-1])
    for axis, shifted in axes.iterrows():
        tasks = of_task[axis][STRENGTHS[-1]].index
        missing = plain.index.difference(tasks)
        name = f"{axis} (without {' and '.join(missing)})" if len(missing) else str(axis)
        lines.append([name, number(plain[tasks].mean()), *map(number, shifted)])
    return {"states": table(("From states, BC", *map(str, STRENGTHS)), lines)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="evaluations")
    store(EPISODES, [episode for folder in parser.parse_args().folders for episode in read(folder)])
