"""Writes what scores in test scenes mean: floors, scenes that refute a shortcut, and which block policies move first.

    python -m tools.test_scenes            # all three, in half an hour on one core
    python -m tools.test_scenes floors     # or some

`floors` and `refuting` are read by reports and the leaderboard, `blocks` (docs/first-blocks.csv) by the tables of
results and by the site. It has a row for each entry and environment with a choice of blocks: of its first
run, in the first scenes that refute the shortcut. See `magical_mj.evaluation.reports.floors`.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np

from magical_mj import ENVIRONMENTS, sample_scene
from magical_mj.evaluation.reports.floors import BLIND, FLOORS, REFUTING, refuting_seeds
from magical_mj.evaluation.reports.intervals import Estimate, mean_over
from magical_mj.intents import EIGHT
from magical_mj.intents.attribution import task_ends
from magical_mj.intents.first_blocks import misplaced
from magical_mj.intents.readings import same_places, selects_some
from magical_mj.leaderboard.entry import Entry, read_entry
from magical_mj.leaderboard.standings import standing
from tools import released
from tools.attribution import CHOICES, RESULTS, replayed
from tools.pages import ROOT

PACKAGE: Final = ROOT / "magical_mj" / "evaluation"
BLOCKS: Final = ROOT / "docs" / "first-blocks.csv"
"""Numbers of episodes: replayed, those that moved an intended block first, and those of these that scored 1."""
COLUMNS: Final = ("entry", "task", "variant", "episodes", "right first", "solved")
SCENES: Final = 100
REPLAYED: Final = 20
"""The number of scenes of each environment whose episodes are replayed."""


def floors() -> None:
    """The mean scores of agents that do not look, by both rules."""
    rows = []
    own = {agent: read_entry(RESULTS / agent) for agent in BLIND}
    for rules in ("paper", "released"):
        entries = own if rules == "paper" else {name: _released(name, entry) for name, entry in own.items()}
        means = {name: standing(entry).means for name, entry in entries.items()}
        rows += [(*pair, rules, *(f"{means[agent][pair].mean():.6g}" for agent in BLIND)) for pair in ENVIRONMENTS]
    _write(PACKAGE / FLOORS, ("task", "variant", "rules", *BLIND), rows)


def _released(name: str, entry: Entry) -> Entry:
    found = released.by_released_rules(entry, RESULTS / name)
    if found is None:
        raise RuntimeError(f"results/{name} has no scores by the released rules: python -m tools.released {name}")
    return found


def refuting() -> None:
    """The seeds of the scenes that refute the shortcut, and the floor in them."""
    rows = []
    episodes = {agent: read_entry(RESULTS / agent).counted for agent in BLIND}
    for pair in ENVIRONMENTS:
        if seeds := [seed for seed in range(SCENES) if is_refuted(*pair, seed)]:
            scores = (
                [row.score for row in played if (row.task, row.variant) == pair and row.seed in seeds]
                for played in episodes.values()
            )
            rows.append((*pair, f"{max(map(np.mean, scores)):.6g}", " ".join(map(str, seeds))))
    _write(PACKAGE / REFUTING, ("task", "variant", "floor", "seeds"), rows)


def is_refuted(task: str, variant: str, seed: int) -> bool:
    """Whether a policy that follows the shortcut is wrong in a test scene."""
    scene, intent = sample_scene(task, variant, seed), EIGHT[task]
    if selects_some(intent):
        return misplaced(task, scene)
    return bool(np.mean([intent.holds(scene, same_places(final, scene)) for _, final in task_ends(task)]) < 0.5)


def blocks() -> None:
    """What each entry's episodes moved first. Rows that exist are kept."""
    rows = [tuple(row.values()) for row in first_blocks()] if BLOCKS.exists() else []
    done = {row[0] for row in rows}
    for folder in sorted(path for path in RESULTS.iterdir() if path.is_dir() and path.name not in done):
        rows += [(folder.name, *row) for row in moved_first(read_entry(folder))]
        _write(BLOCKS, COLUMNS, rows)


def moved_first(entry: Entry) -> Iterator[tuple[str, ...]]:
    """The rows of an entry in `BLOCKS`, without its name."""
    run = entry.runs[0]
    for pair, seeds in refuting_seeds().items():
        episodes = [
            episode
            for episode in entry.counted
            if (episode.task, episode.variant) == pair
            and episode.run == run
            and episode.seed in sorted(seeds)[:REPLAYED]
        ]
        if pair[0] in CHOICES and episodes:
            right = [found for found in replayed(episodes) if found.right_first]
            solved = sum(found.episode.score == 1.0 for found in right)
            yield (*pair, *map(str, (len(episodes), len(right), solved)))


@cache
def first_blocks() -> list[dict[str, str]]:
    """The rows of `BLOCKS`."""
    with BLOCKS.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def right_first(entry: str) -> tuple[Estimate | None, Estimate | None]:
    """How often an entry moves an intended block first, and how often it then scores 1, with intervals.

    The mean is over episodes. None without any.
    """
    rows = [[int(row[name]) for name in COLUMNS[3:]] for row in first_blocks() if row["entry"] == entry]
    return _share([(every, right) for every, right, _ in rows]), _share([(right, solved) for _, right, solved in rows])


def _share(counts: Sequence[tuple[int, int]]) -> Estimate | None:
    total, some = (sum(count[index] for count in counts) for index in (0, 1))
    flags = np.array([[1.0] * some + [0.0] * (total - some)])
    return mean_over([("", "", flags)]) if total > 1 else None


def _write(path: Path, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


PARTS: Final[Mapping[str, Callable[[], None]]] = {"floors": floors, "refuting": refuting, "blocks": blocks}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[[], *PARTS], help="which; all, if none are named")
    for name in parser.parse_args().parts or PARTS:
        PARTS[name]()
