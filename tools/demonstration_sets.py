"""What policies learn from each set of the package's demonstrations: the table of docs/demonstrations.md.

    magical-mj experiment tools/research/set-2.toml --out runs/set-2
    python -m tools.demonstration_sets runs/set-2/evaluations/*
    python -m tools.tables

The second command writes docs/demonstration-sets.csv from the evaluations of policies that learnt from set 2. Those of
set 1 are the entry results/state-bc, in the same scenes.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from magical_mj import TASKS
from magical_mj.evaluation.entry import read_entry
from magical_mj.evaluation.reports.statistics import percentile_interval, resample
from magical_mj.evaluation.scores import EpisodeResult, read
from magical_mj.tasks.registry import ENVIRONMENTS, Pair
from tools.pages import ROOT, table

FILE: Final = ROOT / "docs" / "demonstration-sets.csv"
ENTRY: Final = ROOT / "results" / "state-bc"
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


def stored() -> Scores:
    """The scores in the file."""
    found: dict[Pair, dict[int, NDArray[np.float64]]] = {}
    for row in pd.read_csv(FILE).itertuples():
        runs = found.setdefault((str(row.task), str(row.variant)), {})
        runs[int(str(row.run))] = np.array(str(row.scores).split(), float)
    return found


def collect(folders: Sequence[Path]) -> None:
    """Writes the file from folders of evaluations."""
    scores = scores_of(row for folder in folders for row in read(folder))
    rows = [
        {"task": task, "variant": variant, "run": run, "scores": " ".join(f"{value:g}" for value in values)}
        for (task, variant), runs in scores.items()
        for run, values in runs.items()
    ]
    pd.DataFrame(rows).to_csv(FILE, index=False)


def mean_and_interval(scores: Scores, variant: str) -> str:
    """The mean over the tasks that have the variant, with its 95 % interval."""
    pairs = [(task, variant) for task in TASKS if (task, variant) in ENVIRONMENTS]
    value = np.mean([np.mean([runs.mean() for runs in scores[pair].values()]) for pair in pairs])
    low, high = percentile_interval(resample([[*scores[pair].values()] for pair in pairs]).mean(axis=0))
    return f"{value:.2f} [{low:.2f}, {high:.2f}]"


def tables() -> dict[str, str]:
    """The table by name."""
    sets = {"1": scores_of(read_entry(ENTRY).episodes), "2": stored()}
    rows = []
    for number, scores in sets.items():
        counts = sorted({len(runs) for runs in scores.values()})
        cells = (mean_and_interval(scores, variant) for variant in VARIANTS)
        rows.append((number, " to ".join(map(str, {counts[0]: 0, counts[-1]: 0})), *cells))
    return {"sets": table(("Set", "Runs of a task", *VARIANTS), rows)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path)
    collect(parser.parse_args().folders)
