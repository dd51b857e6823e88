"""Draws the losses in logs of `lerobot-train`: python tools/lerobot_curves.py docs/lerobot.png NAME=LOG ..."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

LOSS = re.compile(r"step:\S+ .*? loss:([\d.]+) ")
EVERY = re.compile(r"'log_freq': (\d+)")


def losses(log: str) -> tuple[list[int], list[float]]:
    """Steps and losses. LeRobot prints rounded steps, so they are computed: it prints a line every `log_freq` steps."""
    every = EVERY.search(log)
    if every is None:
        raise SystemExit("not a log of lerobot-train: it does not contain the settings")
    values = [float(loss) for loss in LOSS.findall(log)]
    return [int(every[1]) * number for number in range(1, len(values) + 1)], values


def main(picture: str, *logs: str) -> None:
    """Draws one curve for each log."""
    figure = Figure((8.0, 3.0), layout="constrained", dpi=100)
    axes: Any = figure.subplots()
    for name, path in (text.split("=", 1) for text in logs):
        axes.plot(*losses(Path(path).read_text(encoding="utf-8")), label=name)
    axes.set(xlabel="step", ylabel="loss", ylim=(0, None))
    axes.grid(alpha=0.3)
    figure.legend(loc="outside right upper")
    figure.savefig(picture)


if __name__ == "__main__":
    main(*sys.argv[1:])
