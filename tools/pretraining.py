"""What policies of one task learn from others: the table of docs/learners.md.

    python -m tools.research.pretraining --out runs/pretraining
    python -m tools.pretraining runs/pretraining
    python -m tools.tables

The first command takes about an hour on one core that is half busy with other work. The second writes
docs/pretraining.csv from its scores.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from magical_mj.evaluation.reports.statistics import percentile_interval, resample
from magical_mj.variants import VARIANTS
from tools.pages import ROOT, table

FILE: Final = ROOT / "docs" / "pretraining.csv"
BUDGET: Final = ("scenes", "pretraining", "batches", "variants", "episodes")
Floats = NDArray[np.float64]
Scores = Mapping[tuple[int, str, str], Sequence[Floats]]
"""Number of tasks in the pretraining, held-out task, variant -> for each run the scores of its episodes."""


def collect(folder: Path, file: Path = FILE) -> None:
    """Writes the file from a folder of tools.research.pretraining."""
    runs = [json.loads(line) for line in (folder / "scores.jsonl").read_text("utf-8").splitlines()]
    if len({tuple(run[name] for name in BUDGET) for run in runs}) > 1:
        raise ValueError(f"{folder} has runs with several budgets, which one table cannot show")
    if len({(run["held_out"], run["tasks"], run["seed"]) for run in runs}) < len(runs):
        raise ValueError(f"{folder} has a run twice")
    rows = [
        {
            **{name: run[name] for name in ("held_out", "tasks", "seed")},
            "variant": variant,
            "scores": " ".join(f"{score:g}" for score in scores),
        }
        for run in runs
        for variant, scores in run["scores"].items()
    ]
    pd.DataFrame(rows).sort_values(["held_out", "tasks", "seed"], kind="stable").to_csv(file, index=False)


def stored(file: Path = FILE) -> Scores:
    """The scores in the file."""
    found: dict[tuple[int, str, str], list[Floats]] = {}
    for row in pd.read_csv(file).itertuples():
        key = int(str(row.tasks)), str(row.held_out), str(row.variant)
        found.setdefault(key, []).append(np.array(str(row.scores).split(), float))
    return found


def mean_and_draws(scores: Scores, count: int, variant: str) -> tuple[float, Floats]:
    """The mean over the held-out tasks that have the variant, and its bootstrap draws."""
    runs = [found for (tasks, _, name), found in scores.items() if (tasks, name) == (count, variant)]
    return float(np.mean([np.mean([one.mean() for one in task]) for task in runs])), resample(runs).mean(axis=0)


def gain(count: int, variant: str) -> tuple[float, float, float]:
    """How much better policies are with this number of tasks than from scratch, with its 95 % interval."""
    scores = stored()
    (mean, draws), (before, draws_before) = (mean_and_draws(scores, tasks, variant) for tasks in (count, 0))
    return mean - before, *percentile_interval(draws - draws_before)


def tables() -> dict[str, str]:
    """The table by name."""
    scores = stored()
    variants = [variant for variant in VARIANTS if any(name == variant for _, _, name in scores)]
    rows = []
    for count in sorted({tasks for tasks, _, _ in scores}):
        cells = []
        for variant in variants:
            mean, draws = mean_and_draws(scores, count, variant)
            low, high = percentile_interval(draws)
            cells.append(f"{mean:.2f} [{low:.2f}, {high:.2f}]")
        rows.append((str(count), *cells))
    return {"pretraining": table(("Other tasks", *variants), rows)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    collect(parser.parse_args().folder)
