"""What policies of one task learn from others: the table of docs/pretraining.md.

    python -m tools.research.pretraining --out runs/states
    python -m tools.research.pretraining --out runs/pictures --preset LoRes4E --seeds 1
    python -m tools.pretraining runs/states runs/pictures
    python -m tools.tables

The first two commands take about an hour of a core each. The rows of encoders need further commands, which are in the
descriptions of tools.research.encoders and tools.research.pretraining. The third writes docs/pretraining.csv.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from magical_mj.evaluation.reports.intervals import Cell, Estimate, Floats, estimate
from magical_mj.learners.settings import STATE
from magical_mj.variants import VARIANTS
from tools.pages import ROOT, table

FILE: Final = ROOT / "docs" / "pretraining.csv"
BUDGET: Final = ("preset", "scenes", "variants", "episodes")
COLUMNS: Final = ("preset", "start", "tasks", "pretraining", "batches", "held_out", "seed", "learnt")
NAMES: Final = {
    "scratch": "new",
    "cloning": "other tasks: {}",
    "untrained": "frozen: random weights",
    "inverse-random": "frozen: inverse dynamics",
    "next-random": "frozen: next frame",
}
"""Start -> its name in the table. Those of encoders end with the policy whose episodes they learnt from."""


class Start(NamedTuple):
    """A row of the table: a kind of pretraining. Its fields are explained in tools.research.pretraining."""

    preset: str
    start: str
    tasks: int
    batches: int
    """On the held-out task. A larger number than in other rows makes up for the batches of their pretraining."""


Scores = Mapping[Start, Mapping[tuple[str, str], Sequence[Floats]]]
"""Start -> held-out task, variant -> for each run the scores of its episodes."""


def collect(folders: Sequence[Path], file: Path = FILE) -> None:
    """Writes the file from folders of tools.research.pretraining."""
    paths = [folder / "scores.jsonl" for folder in folders]
    runs = [json.loads(line) for path in paths for line in path.read_text("utf-8").splitlines()]
    if len({tuple(run[name] for name in BUDGET) for run in runs}) > len({run["preset"] for run in runs}):
        raise ValueError("runs have several numbers of scenes or episodes, which one table cannot show")
    made: dict[Start, list[tuple[str, int]]] = {}
    for run in runs:
        made.setdefault(Start(*(run[name] for name in Start._fields)), []).append((run["held_out"], run["seed"]))
    for start, found in made.items():
        if len(set(found)) < len(found):
            raise ValueError(f"{start} has a run twice")
        others = {task for other, tasks in made.items() if other.preset == start.preset for task in tasks}
        if missing := sorted(others - {*found}):
            raise ValueError(f"{start} lacks the runs {missing}: start its command again, or leave out its other runs")
    rows = [
        {
            **{name: run[name] for name in COLUMNS},
            "variant": variant,
            "scores": " ".join(f"{score:g}" for score in scores),
        }
        for run in runs
        for variant, scores in run["scores"].items()
    ]
    pd.DataFrame(rows).sort_values([*COLUMNS[:-1]], kind="stable").to_csv(file, index=False)


def stored(file: Path = FILE) -> Scores:
    """The scores in the file."""
    found: dict[Start, dict[tuple[str, str], list[Floats]]] = {}
    for row in pd.read_csv(file).to_dict("records"):
        runs = found.setdefault(Start(*(row[name] for name in Start._fields)), {})
        runs.setdefault((row["held_out"], row["variant"]), []).append(np.array(str(row["scores"]).split(), float))
    return found


def cells(scores: Scores, start: Start, variant: str, sign: int = 1) -> list[Cell]:
    """The scores in the held-out tasks that have the variant, with equal weights."""
    runs = {task: np.stack(found) for (task, name), found in scores[start].items() if name == variant}
    return [Cell(found, sign / len(runs), (start, task), task) for task, found in runs.items()]


def gain(start: Start, before: Start, variant: str) -> Estimate:
    """How much better policies are than with another start."""
    scores = stored()
    return estimate([*cells(scores, start, variant), *cells(scores, before, variant, -1)])


def learnt(start: str, file: Path = FILE) -> float:
    """How well a pretraining learnt, as the mean of its runs: the accuracy, or for "next" the explained part."""
    frame = pd.read_csv(file)
    return float(frame[frame["start"] == start]["learnt"].mean())


def tables() -> dict[str, str]:
    """The table by name."""
    scores = stored()
    known = {variant for runs in scores.values() for _, variant in runs}
    variants = [variant for variant in VARIANTS if variant in known]
    names, rows = list(NAMES), []
    for start in sorted(scores, key=lambda one: (one.preset != STATE, names.index(one.start), one.tasks, one.batches)):
        figures = []
        for variant in variants:
            mean, low, high = estimate(cells(scores, start, variant))
            figures.append(f"{mean:.2f} [{low:.2f}, {high:.2f}]")
        observations = "states" if start.preset == STATE else "images"
        rows.append((observations, NAMES[start.start].format(start.tasks), f"{start.batches:,}", *figures))
    return {"pretraining": table(("From", "Start", "Batches", *variants), rows)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folders", type=Path, nargs="+")
    collect(parser.parse_args().folders)
