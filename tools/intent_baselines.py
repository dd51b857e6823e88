"""Plays the test sets of intents with baselines, and writes their table into docs/intents-evaluation.md.

    python -m tools.intent_baselines play OUT            plays all rows; called again, it continues
    python -m tools.intent_baselines play OUT expert     or some
    python -m tools.intent_baselines check               replays a tenth of the episodes in results/intents.jsonl.xz
    python -m tools.intent_baselines write OUT...        adds their rows to this file, or replaces them, and writes the
                                                         table; each folder is a run
    python -m tools.intent_baselines write               writes the table

It needs the packages in methods/goals and methods/intents. Policies with networks are trained before, with
python -m magical_intents.train OUT. Trainings with other seeds, in other folders, are further runs. All rows have the
same episodes: one in each of Layout and All, in the first intents of each set.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

import magical_mj
from magical_mj.evaluation.replay import replay
from magical_mj.evaluation.reports.intervals import Cell, Estimate, estimate
from magical_mj.evaluation.scores import EpisodeResult, read
from magical_mj.intents import shortcuts
from magical_mj.intents.by_set import by_intent, set_of
from magical_mj.intents.given import OFFICIAL_VARIANTS
from magical_mj.intents.names import TESTS, tasks_in
from magical_mj.intents.tasks import PREFIX
from magical_mj.utils.errors import EvaluationError
from tools.stored_episodes import RESULTS, store, stored
from tools.tables import ROOT, filled, table

EPISODES: Final = RESULTS / "intents.jsonl.xz"
"""The episodes, with the name of the baseline as policy."""
PAGE: Final = ROOT / "docs" / "intents-evaluation.md"
SECONDS: Final = 3600.0
"""The time limit of an episode. It includes a training, on a machine that may do other work."""
INTENTS: Final = 4
"""The number of intents of each set that are played."""
SHOWN: Final = 4
"""The number of demonstrations that a policy is given, in any number of scenes."""
MEASURE: Final = "clean success"
"""What the table shows by set."""


class Baseline(NamedTuple):
    """A row of the table: a policy, what it is given, and the settings of its evaluation."""

    method: str
    given: str
    policy: Any
    settings: Mapping[str, Any] = {}


def shown(scenes: int, *, contrasting: bool = False) -> dict[str, Any]:
    """The settings for demonstrations in some demo scenes."""
    return {"demonstrations": SHOWN, "scenes": scenes, "contrasting": contrasting}


def in_scenes(number: int, contrasting: bool) -> str:
    """What is given: demonstrations in a number of scenes."""
    kind = "contrasting " if contrasting else "random " if number > 1 else ""
    return f"demonstrations in {number} {kind}scene{'s' if number > 1 else ''}"


def rows_of(name: str, method: str, policy: str) -> dict[str, Baseline]:
    """Rows for demonstrations in one scene, in four random and in four contrasting ones."""
    return {
        f"{name}-{number}{'-contrasting' if contrasting else ''}": Baseline(
            method, in_scenes(number, contrasting), policy, shown(number, contrasting=contrasting)
        )
        for number, contrasting in ((1, False), (4, False), (4, True))
    }


TRAINED: Final = ("sentence", "demonstrations", "inference", "pictures")
"""The trained policies: folders in `OUT`."""
BASELINES: Final = {
    "noop": Baseline("Doing nothing", "nothing", "noop"),
    "random": Baseline("Random actions", "nothing", "random"),
    **{
        name.replace(" ", "-"): Baseline(f"Shortcut: {name}", "the intent's relations", shortcut)
        for name, shortcut in shortcuts.items()
    },
    "circling": Baseline("Shortcut: circling", "nothing", shortcuts["circling"]),
    "cloned-1": Baseline("BC for each intent", in_scenes(1, False), "magical_intents.cloning:Cloned", shown(1)),
    "sentence-policy": Baseline("Policy for many intents", "the sentence", "sentence"),
    **rows_of("demonstrations-policy", "Policy for many intents", "demonstrations"),
    **rows_of("pictures", "Intent inference and a learnt skill, from pictures", "pictures"),
    "pictures-wrong": Baseline(
        "Intent inference and a learnt skill, from pictures",
        f"another intent's {in_scenes(4, True)}",
        "pictures",
        {**shown(4, contrasting=True), "control": "wrong-demonstrations"},
    ),
    **rows_of("inference", "Intent inference and a learnt skill", "inference"),
    **rows_of("goals", "Intent inference and a simulator", "magical_goals.policy:InferredGoal"),
    "expert": Baseline("Expert", "the intent", "expert"),
}
"""Name -> row."""


def played() -> list[str]:
    """The first tasks of each test set."""
    return [f"{PREFIX}{task}" for name in TESTS for task in tasks_in(name)[:INTENTS]]


def play(out: Path, names: Iterable[str]) -> None:
    """Plays some baselines; each has a folder in `out`."""
    for name in names:
        baseline, folder = BASELINES[name], out / name
        policy = str(out / baseline.policy) if baseline.policy in TRAINED else baseline.policy
        magical_mj.evaluate(
            policy,
            name=baseline.method,
            tasks=played(),
            variants=list(OFFICIAL_VARIANTS),
            episodes=1,
            jobs=1,
            time_limit=SECONDS,
            out=folder,
            resume=folder.exists(),
            **baseline.settings,
        )


def whole(*runs: Path) -> list[EpisodeResult]:
    """The episodes of the baselines that were played to the end, by their names. Each folder is a run."""
    found = []
    for run, out in enumerate(runs):
        for name in BASELINES:
            every = episodes_of(out / name)
            if len(in_table(every)) == len(OFFICIAL_VARIANTS) * len(played()):
                found += [replace(one, policy=name, run=run, seconds=0.0) for one in every]
    return found


def in_table(episodes: Iterable[EpisodeResult]) -> list[EpisodeResult]:
    """Those of the tasks that all baselines play."""
    tasks = set(played())
    return [one for one in episodes if one.task in tasks]


def episodes_of(folder: Path) -> list[EpisodeResult]:
    """The episodes that were played. None may have failed."""
    with suppress(EvaluationError):  # nothing was played yet
        episodes = read(folder)
        if failures := [episode for episode in episodes if episode.failure]:
            sys.exit(f"{folder}: {len(failures)} episodes failed, such as {failures[0]}")
        return episodes
    return []


def differences(episodes: Iterable[EpisodeResult], jobs: int | None = None) -> list[str]:
    """Replays episodes. A sentence for each that does not lead to its scene and score."""
    return [difference for *_, difference in replay((("", one) for one in episodes), jobs=jobs) if difference]


def check() -> None:
    """Replays a random tenth of the episodes, as the leaderboard does with its entries."""
    every = stored(EPISODES)
    if not every:
        return
    chosen = [every[number] for number in np.random.default_rng().choice(len(every), len(every) // 10, replace=False)]
    if different := differences(chosen):
        sys.exit("\n".join(different))
    print(f"{EPISODES.name}: {len(chosen)} of {len(every)} episodes were replayed, with the same scores")


def means(episodes: Sequence[EpisodeResult], measure: str = MEASURE) -> dict[str, Estimate]:
    """The mean of each set, and of all sets, with an interval over intents, scenes and runs."""
    runs, cells = sorted({one.run for one in episodes}), dict[str, Cell]()
    for name in TESTS:
        own = [one for one in episodes if set_of(one.task) == name]
        tasks = sorted({one.task for one in own})
        cells[name] = Cell(by_intent(own, measure, tasks, runs), 1.0, "policies", name)
    every = estimate([cell._replace(weight=1 / len(TESTS)) for cell in cells.values()])
    return {name: estimate([cell]) for name, cell in cells.items()} | {"mean": every}


def baselines(episodes: Sequence[EpisodeResult]) -> str:
    """The table: clean success by set, and its mean and that of scores, with intervals."""
    rows, same = [], in_table(episodes)
    for name, baseline in BASELINES.items():
        own = [one for one in same if one.policy == name]
        if own:
            found = means(own)
            parts = (f"{found[name].value:.2f}" for name in TESTS)
            both = ("{:.2f} ({:.2f} to {:.2f})".format(*one["mean"]) for one in (found, means(own, "score")))
            rows.append((baseline.method, baseline.given, *parts, *both))
    return table(("Method", "Given", *TESTS, "mean", "score"), rows)


def write() -> None:
    """Writes the table."""
    tables = {"baselines": baselines(stored(EPISODES))}
    PAGE.write_text(filled(PAGE.read_text("utf-8"), tables, "python -m tools.intent_baselines"), "utf-8")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["play", out, *names]:
            play(Path(out), names or BASELINES)
        case ["check"]:
            check()
        case ["write", *out]:
            if out:
                store(EPISODES, whole(*map(Path, out)))
            write()
        case _:
            sys.exit(__doc__)
