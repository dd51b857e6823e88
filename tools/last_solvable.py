"""Finds the last solvable steps of failed episodes in results/, and writes a table into docs/failures.md.

    python -m tools.last_solvable measure   adds to docs/last-solvable.csv; called again, it continues
    python -m tools.last_solvable write     writes the table

It measures the first failed episodes of each learner's first run in All and Layout: one of each task, then a second.
The slowest tasks come last. An episode takes from half a second to a minute of a core.
"""

from __future__ import annotations

import csv
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass
from typing import Final

import numpy as np

from magical_mj import TASKS
from magical_mj.evaluation.reports.floors import BLIND
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.intents.attribution import FAILURES, last_solvable_step
from tools.attribution import LONG, RESULTS, entries, replayed
from tools.pages import ROOT, filled, table

DATA: Final = ROOT / "docs" / "last-solvable.csv"
PAGE: Final = ROOT / "docs" / "failures.md"
COMMAND: Final = "python -m tools.last_solvable"
VARIANTS: Final = ("All", "Layout")
ORDER: Final = ("MoveToRegion", "FixColour", "FindDupe", "MoveToCorner", "MatchRegions", "MakeLine", *LONG)
"""The tasks, beginning with the fastest to measure."""
EACH: Final = 3
"""The most episodes of each entry, task and variant."""


@dataclass(frozen=True)
class Loss:
    """The last solvable step of a failed episode: the fields of `LastSolvable`, with the number of its steps."""

    entry: str
    task: str
    variant: str
    run: int
    seed: int
    failure: str
    last: int | None
    steps: int

    @property
    def place(self) -> tuple[str, str, str, int, int]:
        """The episode."""
        return self.entry, self.task, self.variant, self.run, self.seed


def measure() -> None:
    """Adds the episodes to the file that it lacks."""
    known = {loss.place for loss in stored()}
    names = sorted(entry.name for entry in RESULTS.iterdir() if entry.is_dir() and entry.name not in BLIND)
    every = {name: _failed(name) for name in names}
    for number in range(EACH):
        for task in ORDER:
            for variant in VARIANTS:
                for name, failed in every.items():
                    for episode in failed.get((task, variant), [])[number : number + 1]:
                        if (name, task, variant, episode.run, episode.seed) not in known:
                            _add(loss_of(name, episode))


def _failed(name: str) -> dict[tuple[str, str], list[EpisodeResult]]:
    """The first failed episodes of an entry's first run, by task and variant."""
    (entry,) = entries((name,))
    run, found = entry.runs[0], dict[tuple[str, str], list[EpisodeResult]]()
    for episode in sorted(entry.counted, key=lambda one: one.seed):
        group = found.setdefault((episode.task, episode.variant), [])
        if episode.run == run and episode.score < 1.0 and episode.failure is None and len(group) < EACH:
            group.append(episode)
    return found


def loss_of(name: str, episode: EpisodeResult) -> Loss:
    """The last solvable step of a failed episode of an entry."""
    (attribution,) = replayed([episode])
    found = last_solvable_step(attribution)
    place = (name, episode.task, episode.variant, episode.run, episode.seed)
    return Loss(*place, found.failure, found.last, len(episode.actions))


def _add(loss: Loss) -> None:
    new = not DATA.exists()
    with DATA.open("a", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if new:
            writer.writerow(Loss.__dataclass_fields__)
        writer.writerow("" if value is None else value for value in astuple(loss))


def stored() -> list[Loss]:
    """The rows of the file; none if it is missing."""
    if not DATA.exists():
        return []
    with DATA.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return [
        Loss(
            *(row["entry"], row["task"], row["variant"], int(row["run"]), int(row["seed"]), row["failure"]),
            int(row["last"]) if row["last"] else None,
            int(row["steps"]),
        )
        for row in rows
    ]


def losses(rows: Sequence[Loss]) -> str:
    """The table: shares of failures by task, and the median of the last solvable step."""
    return table(("Task", "Entries", "Unsolved", *FAILURES, "last solvable step"), _rows(rows))


def _rows(rows: Sequence[Loss]) -> Iterator[tuple[str, ...]]:
    for task in TASKS:
        own = [row for row in rows if row.task == task]
        if own:
            kinds = Counter(row.failure for row in own)
            shares = [f"{100 * kinds[kind] / len(own):.0f}" if kinds[kind] else "" for kind in FAILURES]
            last = np.median([row.last / row.steps for row in own if row.last is not None])
            yield task, str(len({row.entry for row in own})), str(len(own)), *shares, f"{last:.2f}"


def write() -> None:
    """Writes the table."""
    PAGE.write_text(filled(PAGE.read_text("utf-8"), {"lost": losses(stored())}, COMMAND), "utf-8")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["measure"]:
            measure()
        case ["write"]:
            write()
        case _:
            sys.exit(__doc__)
