"""Writes the tables about intents: rivals of the intents, what test scenes distinguish, and what our policies did.

python -m tools.attribution                     # all of them, in an hour on one core
python -m tools.attribution identifiability     # or some

Those of episodes replay the entries in results/. docs/rivals.md, failures.md and benchmark-card.md have the tables.
`endings` is made of docs/endings.csv, which gets a row for each entry and task that it lacks.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from magical_mj import ENVIRONMENTS, TASKS, sample_scene
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.intents import EIGHT
from magical_mj.intents.attribution import Attribution, attribute, demonstrated_blocks, task_ends, task_rivals
from magical_mj.intents.explained import shares
from magical_mj.intents.readings import ENDINGS, READINGS, readings, refutes, same_places, selects_some
from magical_mj.leaderboard.entry import Entry, read_entry
from magical_mj.scene import Scene
from magical_mj.tasks.registry import SPLITS
from magical_mj.variants import VARIANTS
from tools.pages import ROOT, filled, table

RESULTS: Final = ROOT / "results"
SCENES: Final = 100
CHOICES: Final = ("MatchRegions", "FindDupe", "FixColour")
"""The tasks that require moving only some of the blocks."""
TESTED: Final = [variant for variant in VARIANTS if variant != "Demo"]
FEW: Final = 5
"""The number of scenes of each environment that the file of endings covers."""
FEW_LONG: Final = 2
"""The same in the tasks `LONG`, whose episodes take longest."""
LONG: Final = ("ClusterColour", "ClusterShape")
ENDED: Final = ROOT / "docs" / "endings.csv"
"""The file of what the entries' episodes did."""
COLUMNS: Final = ("entry", "task", "episodes", *ENDINGS, "failed")
"""Of `ENDED`: numbers of episodes."""
COMPARED: Final = (
    "pixels-bc-quick",
    "pixels-redraw-quick",
    "state-bc",
    "state-gail",
    "state-relational",
    "state-goals",
    "replay",
    "random",
)
"""The entries that the table of endings compares."""


def left_open() -> str:
    """The rivals of each task's intent: all, those that are not longer, and the simplest."""
    rows = []
    for task in TASKS:
        intent, rivals = EIGHT[task], task_rivals(task)
        simpler = sum(rival.bits <= intent.bits for rival in rivals)
        first = f"`{rivals[0]}`" if rivals else ""
        rows.append((task, str(len(rivals)), str(simpler), first))
    return table(("Task", "Rivals", "As simple", "The simplest"), rows)


def identifiability() -> str:
    """The shares of test scenes that refute each reading.

    Two tables: the environments where some blocks have to be moved, and the demonstrations' final places in the
    others.
    """
    rows, others = [], []
    for task in TASKS:
        shares = {
            variant: ["" if value is None else f"{value:.2f}" for value in refuted(task, variant, range(SCENES))]
            for known, variant in ENVIRONMENTS
            if known == task and variant != "Demo"
        }
        if selects_some(EIGHT[task]):
            alike: dict[tuple[str, ...], list[str]] = {}
            for variant, values in shares.items():
                alike.setdefault(tuple(values), []).append(variant)
            rows += [(task, ", ".join(variants), *values) for values, variants in alike.items()]
        else:
            others.append((task, *(shares[variant][-1] if variant in shares else "" for variant in TESTED)))
    places = "the demo's final places"
    first = table(("Task", "Variants", "the demo's blocks", *READINGS, places), rows)
    return f"{first}\n\n{table((f'T{places[1:]}', *TESTED), others)}"


def refuted(task: str, variant: str, seeds: Iterable[int]) -> list[float | None]:
    """The shares of the scenes of these seeds that refute each reading. None if it does not apply to the task."""
    scenes = [sample_scene(task, variant, seed) for seed in seeds]
    intent, demonstrated = EIGHT[task], demonstrated_blocks(task)

    def share(blocks: Callable[[Scene], frozenset[int]]) -> float | None:
        wrong = [refutes(intent, blocks(scene), scene) for scene in scenes]
        return float(np.mean(wrong)) if selects_some(intent) else None

    finals = [final for _, final in task_ends(task)]
    solved = [np.mean([intent.holds(scene, same_places(final, scene)) for final in finals]) for scene in scenes]
    return [
        share(lambda _: frozenset(demonstrated.moved)),
        *(share(lambda scene, name=name: readings(demonstrated, scene)[name]) for name in READINGS),
        float(np.mean([part < 0.5 for part in solved])),
    ]


def endings() -> str:
    """What the unsolved episodes of some policies did, in the tasks with a choice, in per cent.

    All wrong blocks are one column.
    """
    rows = []
    every = [row for row in measured() if row["task"] in CHOICES]
    for name in COMPARED:
        group = [row for row in every if row["entry"] == name]
        unsolved = sum(int(row["failed"]) for row in group)
        parts = (_percent(part) for part in of_unsolved(group)) if unsolved else ("",) * 3
        rows.append((read_entry(RESULTS / name).method, str(unsolved), *parts))
    return table(("Method", "unsolved", "wrong blocks", "incompetent", "nothing"), rows)


def of_unsolved(rows: Iterable[Mapping[str, str]]) -> tuple[float, float, float]:
    """Which shares of the unsolved episodes in some rows moved only wrong blocks, an intended one, and none."""
    every = list(rows)
    total = sum(int(row["failed"]) for row in every)
    kinds = ([*READINGS, "another block"], ["incompetent"], ["nothing"])
    wrong, some, none = (sum(float(row[name]) for row in every for name in names) / total for names in kinds)
    return wrong, some, none


def measured() -> list[dict[str, str]]:
    """The rows of `ENDED`, one for each entry and task. Those that are missing are measured and stored first."""
    if not ENDED.exists():
        ENDED.write_text(",".join(COLUMNS) + "\n", encoding="utf-8")
    done = {(row["entry"], row["task"]) for row in _stored()}
    for name in sorted(folder.name for folder in RESULTS.iterdir() if folder.is_dir()):
        missing = [task for task in TASKS if (name, task) not in done]
        entry = read_entry(RESULTS / name) if missing else None
        for task in missing:
            if episodes := [one for one in covered(entry) if one.task == task] if entry else []:
                row = measured_row(task, episodes)
                with ENDED.open("a", encoding="utf-8", newline="") as file:
                    csv.writer(file, lineterminator="\n").writerow([name, *row])
    return sorted(_stored(), key=lambda row: (row["entry"], TASKS.index(row["task"])))


def _stored() -> list[dict[str, str]]:
    with ENDED.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def measured_row(task: str, episodes: Sequence[EpisodeResult]) -> list[str]:
    """A row without the entry's name: the columns after the first of `COLUMNS`."""
    failed = replayed([episode for episode in episodes if episode.score < 1.0])
    counts = {kind: len(failed) * part for kind, part in shares(failed).items()} if failed else {}
    counts["intended"] = len(episodes) - len(failed)
    numbers = [f"{counts.get(kind, 0):.6g}" for kind in ENDINGS]
    return [task, str(len(episodes)), *numbers, str(len(failed))]


def entries(names: Sequence[str] = ()) -> Iterator[Entry]:
    """The entries in results/, or those with these names."""
    for folder in sorted(path for path in RESULTS.iterdir() if path.is_dir() and (not names or path.name in names)):
        yield read_entry(folder)


def covered(entry: Entry) -> list[EpisodeResult]:
    """The episodes of an entry that the file of endings covers: of the first run, in the first scenes."""
    run = entry.runs[0]
    return [
        episode
        for episode in entry.episodes
        if episode.run == run and episode.seed - SPLITS["test"] < (FEW_LONG if episode.task in LONG else FEW)
    ]


def replayed(episodes: Iterable[EpisodeResult]) -> list[Attribution]:
    """The attributions of some episodes of an entry."""
    found: list[Attribution] = []
    for result in attribute(episodes, jobs=1):
        if not isinstance(result, Attribution):
            episode, problem = result
            raise RuntimeError(f"{episode.policy}, {episode.title}: {problem}")
        found.append(result)
    return found


def _percent(share: float) -> str:
    return f"{100 * share:.0f}" if share else ""


WRITTEN: Final[dict[str, tuple[str, Callable[[], str]]]] = {
    "identifiability": ("docs/benchmark-card.md", identifiability),
    "left-open": ("docs/rivals.md", left_open),
    "endings": ("docs/failures.md", endings),
}
"""Table -> its page, and the function that makes it."""

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", choices=[[], *WRITTEN], help="which tables; all, if none are named")
    for name in parser.parse_args().tables or WRITTEN:
        page, make = WRITTEN[name]
        path = ROOT / page
        body = make()
        path.write_text(filled(path.read_text("utf-8"), {name: body}, "python -m tools.attribution"), "utf-8")
