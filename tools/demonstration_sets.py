"""What policies learn from each set of the package's demonstrations: the table of docs/demonstration-sets.md.

    for entry in state-bc pixels-bc-quick state-gail; do
        magical-mj experiment tools/research/set-2-$entry.toml --out runs/$entry
        python -m tools.demonstration_sets $entry runs/$entry/evaluations/*
    done
    python -m tools.tables

The second command writes the scores of policies that learnt from set 2 into docs/demonstration-sets.csv. Those of set 1
are in the entries, in the same tasks and scenes.
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from magical_mj import TASKS
from magical_mj.evaluation.reports.intervals import Cell, Estimate, estimate, mean_over
from magical_mj.evaluation.scores import EpisodeResult, read
from magical_mj.leaderboard.entry import read_entry
from magical_mj.tasks.registry import ENVIRONMENTS, Pair
from tools.pages import ROOT, table

FILE: Final = ROOT / "docs" / "demonstration-sets.csv"
ENTRIES: Final = ("state-bc", "pixels-bc-quick", "state-gail")
"""The entries whose methods learnt from set 2 as well."""
VARIANTS: Final = ("Demo", "Jitter", "Layout", "All")
SCENES: Final = 50

Scores = Mapping[Pair, Mapping[int, NDArray[np.float64]]]
"""Environment -> run -> the scores of the scenes of seeds 0 to 49."""


def scores_of(episodes: Iterable[EpisodeResult]) -> Scores:
    """The scores of episodes in the table's environments, which must be complete."""
    found: dict[Pair, dict[int, dict[int, float]]] = {}
    for row in episodes:
        if row.variant in VARIANTS and row.seed < SCENES and not row.shift:
            found.setdefault((row.task, row.variant), {}).setdefault(row.run, {})[row.seed] = row.score
    return {
        pair: {run: np.array([seeds[seed] for seed in range(SCENES)]) for run, seeds in sorted(runs.items())}
        for pair, runs in sorted(found.items())
    }


@cache
def from_set_1(entry: str) -> Scores:
    """The scores of an entry, whose policies learnt from set 1."""
    return scores_of(read_entry(ROOT / "results" / entry).counted)


def stored(entry: str) -> Scores:
    """The scores in the file for a method."""
    found: dict[Pair, dict[int, NDArray[np.float64]]] = {}
    frame = pd.read_csv(FILE)
    for row in frame[frame["entry"] == entry].itertuples():
        runs = found.setdefault((str(row.task), str(row.variant)), {})
        runs[int(str(row.run))] = np.array(str(row.scores).split(), float)
    return found


def collect(entry: str, folders: Sequence[Path]) -> None:
    """Replaces a method's scores in the file by those in folders of evaluations."""
    scores = scores_of(row for folder in folders for row in read(folder))
    rows = [
        {"entry": entry, "task": task, "variant": variant, "run": run, "scores": " ".join(f"{x:g}" for x in values)}
        for (task, variant), runs in scores.items()
        for run, values in runs.items()
    ]
    before = pd.read_csv(FILE)
    pd.concat([before[before["entry"] != entry], pd.DataFrame(rows)]).sort_values("entry", kind="stable").to_csv(
        FILE, index=False
    )


def mean(scores: Scores, variant: str, tasks: Collection[str]) -> float:
    """The mean over these tasks that have the variant."""
    pairs = [(task, variant) for task in tasks if (task, variant) in ENVIRONMENTS]
    return float(np.mean([np.mean([runs.mean() for runs in scores[pair].values()]) for pair in pairs]))


def gained(entry: str, variant: str) -> Estimate:
    """How much more a method scores in a variant after learning from set 2, over all tasks."""
    sides = {1: stored(entry), -1: from_set_1(entry)}
    pairs = [pair for pair in sides[1] if pair[1] == variant]
    return estimate(
        [
            Cell(np.stack([*scores[pair].values()]), sign / len(pairs), (sign, pair[0]), pair)
            for sign, scores in sides.items()
            for pair in pairs
        ]
    )


def lost(entry: str, tasks: Collection[str], variant: str = "Demo") -> tuple[float, float]:
    """How much lower a method's mean is with set 2 than with set 1, in score and as a share."""
    before = mean(from_set_1(entry), variant, tasks)
    loss = before - mean(stored(entry), variant, tasks)
    return loss, loss / before


def mean_and_interval(scores: Scores, variant: str, tasks: Collection[str]) -> str:
    """The mean over these tasks that have the variant, with its 95 % interval."""
    pairs = [(task, variant) for task in tasks if (task, variant) in ENVIRONMENTS]
    value, low, high = mean_over((pair, pair, np.stack([*scores[pair].values()])) for pair in pairs)
    return f"{value:.2f} [{low:.2f}, {high:.2f}]"


def tables() -> dict[str, str]:
    """The table by name."""
    rows = []
    for name in ENTRIES:
        entry, varied = read_entry(ROOT / "results" / name), stored(name)
        for number, scores in (("1", scores_of(entry.episodes)), ("2", varied)):
            (runs,) = {len(scores[pair]) for pair in varied}
            cells = (mean_and_interval(scores, variant, TASKS) for variant in VARIANTS)
            rows.append((entry.method, number, str(runs), *cells))
    return {"sets": table(("Method", "Set", "Runs", *VARIANTS), rows)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("entry", choices=ENTRIES)
    parser.add_argument("folders", nargs="+", type=Path)
    options = parser.parse_args()
    collect(options.entry, options.folders)
