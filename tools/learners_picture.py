"""Draws the learning curves of trainings from the metrics.csv in their folders.

python tools/learners_picture.py "BC=runs/bc-MoveToRegion-0" "GAIL=runs/gail-MoveToRegion-0" --out curves.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

from matplotlib.figure import Figure

from magical_mj.learners.run_folder import read_metrics

PALE = "#a9cbe8"
COLOURS = ("#1f6fb4", "#d62728", "#2a9d5c", "#e08a1e")


def draw(runs: dict[str, Path]) -> Figure:
    """A panel for each run: the mean score in the demo variant and the loss over time in minutes."""
    figure = Figure(figsize=(3.4 * len(runs), 2.8), layout="constrained")
    for axes, (label, folder) in zip(figure.subplots(1, len(runs), squeeze=False)[0], runs.items(), strict=True):
        rows = read_metrics(folder)
        scores = [name for name in rows[-1] if name.startswith("score ")]
        for name, colour in zip(scores, COLOURS, strict=False):
            points = [(float(row["seconds"]) / 60, float(row[name])) for row in rows if row.get(name)]
            axes.plot(*zip(*points, strict=True), marker="o", markersize=4, color=colour, label=name)
        axes.set(title=label, xlabel="minutes", ylim=(-0.03, 1.03), ylabel="mean score on Demo")
        if "score" in rows[-1]:  # the score of training episodes
            points = [(float(row["seconds"]) / 60, float(row["score"])) for row in rows]
            axes.plot(*zip(*points, strict=True), color=PALE, linewidth=0.8)
        losses = next((name for name in ("loss", "reconstruction") if name in rows[-1]), None)
        if losses is None:  # some methods, such as goals, have no loss
            continue
        other = axes.twinx()
        times = [float(row["seconds"]) / 60 for row in rows if row[losses]]
        other.plot(times, [float(row[losses]) for row in rows if row[losses]], color="#999999", linewidth=0.8)
        other.set_ylabel(losses, color="#777777")
    return figure


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", metavar="LABEL=FOLDER")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    runs = {label: Path(folder) for label, _, folder in (text.partition("=") for text in arguments.runs)}
    draw(runs).savefig(arguments.out, dpi=110)


if __name__ == "__main__":
    main()
