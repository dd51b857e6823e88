"""Plays the test intents with baselines, and writes their table into docs/intents.md.

    python -m tools.intent_baselines play OUT           plays all rows; called again, it continues
    python -m tools.intent_baselines play OUT goals-4   or some
    python -m tools.intent_baselines infer              writes docs/inferred-intents.csv, or what it lacks
    python -m tools.intent_baselines check              replays a tenth of the episodes in results/intents.jsonl.xz
    python -m tools.intent_baselines write OUT...       writes this file, docs/intent-baselines.csv, and the table
    python -m tools.intent_baselines write              writes the table

It needs the packages in methods/goals and methods/intents. Of each test set, the first intents are played. Policies for
many intents are trained before, with python -m magical_intents.train OUT and python -m magical_intents.pictures OUT.
Trainings with other seeds, in other folders, are further runs.
"""

from __future__ import annotations

import csv
import itertools
import lzma
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

import magical_mj
from magical_mj.evaluation.replay import replay
from magical_mj.evaluation.reports.intervals import Estimate, mean_over
from magical_mj.evaluation.scores import EpisodeResult, read
from magical_mj.evaluation.scores import parse as episode_in
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.intents import parse
from magical_mj.intents.ambiguity import ends_of
from magical_mj.intents.given import demonstrations_given, intent_of, with_states
from magical_mj.tasks.languages import members
from magical_mj.tasks.registry import task_name
from magical_mj.utils.errors import EvaluationError
from tools.intents import TESTS, VARIANTS
from tools.tables import ROOT, filled, table

DATA: Final = ROOT / "docs" / "intent-baselines.csv"
INFERRED: Final = ROOT / "docs" / "inferred-intents.csv"
KEPT: Final = ROOT / "results" / "intents.jsonl.xz"
"""The file of the episodes: lines as of an evaluation, with the name of the baseline as policy."""
PAGE: Final = ROOT / "docs" / "intents.md"
INTENTS: Final = 6
"""The number of intents of each set that a baseline plays."""
FEW: Final = 3
"""The same for some baselines."""
EPISODES: Final = 1
"""The number of episodes of each intent in each variant."""
SECONDS: Final = 3600.0
"""The time limit of an episode. It includes a training, on a machine that may do other work."""
SHOWN: Final = 4
"""The number of demonstrations that a policy is given, in any number of scenes."""


class Baseline(NamedTuple):
    """A row of the table: a policy, what it is given, and the settings of its evaluation."""

    method: str
    given: str
    policy: str
    settings: Mapping[str, Any] = {}
    intents: int = INTENTS


def shown(scenes: int, *, contrasting: bool = False) -> dict[str, Any]:
    """The settings for demonstrations in some demo scenes."""
    return {"demonstrations": SHOWN, "scenes": scenes, "contrasting": contrasting}


TRAINED: Final = ("sentence", "demonstrations", "pictures")
"""The trained policies: folders in `OUT`."""
GOALS: Final = "magical_goals.policy:InferredGoal"
SCENES: Final = (1, 4)
"""The numbers of demo scenes. tools.intent_scenes has more."""


def in_scenes(number: int, contrasting: bool) -> str:
    """What is given: demonstrations in a number of scenes."""
    kind = "contrasting " if contrasting else "random " if number > 1 else ""
    return f"demonstrations in {number} {kind}scene{'s' if number > 1 else ''}"


def rows_of(name: str, method: str, policy: str, intents: int = INTENTS) -> dict[str, Baseline]:
    """Rows for numbers of demo scenes, random and contrasting."""
    every = [(number, contrasting) for contrasting in (False, True) for number in SCENES if number > contrasting]
    return {
        f"{name}-{number}{'-contrasting' if contrasting else ''}": Baseline(
            method, in_scenes(number, contrasting), policy, shown(number, contrasting=contrasting), intents
        )
        for number, contrasting in every
    }


BASELINES: Final = {
    "noop": Baseline("Doing nothing", "nothing", "noop"),
    "random": Baseline("Random actions", "nothing", "random"),
    "cloned-1": Baseline("BC for each intent", in_scenes(1, False), "magical_intents.cloning:Cloned", shown(1), FEW),
    "pictures-policy": Baseline("BC for many intents, pictures", "the sentence", "pictures", intents=FEW),
    "sentence-policy": Baseline("Policy for many intents", "the sentence", "sentence"),
    **rows_of("demonstrations-policy", "Policy for many intents", "demonstrations", FEW),
    **rows_of("goals", "Intent inference", GOALS),
    "expert": Baseline("Expert", "the intent", "expert"),
}
"""Name -> row."""


MISREADINGS: Final = ("the intent", "its relations, other blocks or places", "fewer relations", "other relations")


class Mean(NamedTuple):
    """The mean score of a run of a baseline with an intent in a variant."""

    baseline: str
    run: int
    set: str
    number: int
    variant: str
    score: float


def played(intents: int) -> dict[tuple[str, int], str]:
    """Set and number -> the name of the task, of the first intents of each set."""
    return {
        (name, number): task_name(task)
        for name in TESTS
        for number, task in enumerate(members(f"intent:{name}")[:intents])
    }


def play(out: Path, names: Iterable[str]) -> None:
    """Plays some baselines; each has a folder in `out`."""
    for name in names:
        baseline, folder = BASELINES[name], out / name
        magical_mj.evaluate(
            str(out / baseline.policy) if baseline.policy in TRAINED else baseline.policy,
            name=baseline.method,
            tasks=list(played(baseline.intents).values()),
            variants=list(VARIANTS),
            episodes=EPISODES,
            jobs=1,
            time_limit=SECONDS,
            out=folder,
            resume=folder.exists(),
            **baseline.settings,
        )


def gather(episodes: Iterable[EpisodeResult]) -> list[Mean]:
    """The means of baselines from their episodes."""
    places = {task: place for place, task in played(INTENTS).items()}
    scores: dict[tuple[str, int, str, int, str], list[float]] = {}
    for row in episodes:
        scores.setdefault((row.policy, row.run, *places[row.task], row.variant), []).append(row.score)
    return [Mean(*key, float(np.mean(each))) for key, each in scores.items()]


def whole(*runs: Path) -> list[EpisodeResult]:
    """The episodes of the baselines that were played to the end, by their names. Each folder is a run."""
    found = []
    for name, (run, out) in itertools.product(BASELINES, enumerate(runs)):
        every = {(row.task, row.variant, row.seed): row for row in episodes_of(out / name)}
        wanted = list(itertools.product(played(BASELINES[name].intents).values(), VARIANTS, range(EPISODES)))
        if every.keys() >= set(wanted):
            found += [replace(every[key], policy=name, run=run, seconds=0.0) for key in wanted]
    return found


def episodes_of(folder: Path) -> list[EpisodeResult]:
    """The episodes that were played. None may have failed."""
    with suppress(EvaluationError):  # nothing was played yet
        episodes = read(folder)
        if failures := [episode for episode in episodes if episode.failure]:
            sys.exit(f"{folder}: {len(failures)} episodes failed, such as {failures[0]}")
        return episodes
    return []


def kept() -> list[EpisodeResult]:
    """The episodes in the file of the repository."""
    return [episode_in(line) for line in lzma.decompress(KEPT.read_bytes()).splitlines()]


def keep(episodes: Iterable[EpisodeResult]) -> None:
    """Writes the file of episodes."""
    lines = "".join(episode.line() for episode in episodes)
    KEPT.write_bytes(lzma.compress(lines.encode(), preset=9 | lzma.PRESET_EXTREME))


def differences(episodes: Iterable[EpisodeResult], jobs: int | None = None) -> list[str]:
    """Replays episodes. A sentence for each that does not lead to its scene and score."""
    return [difference for *_, difference in replay((("", one) for one in episodes), jobs=jobs) if difference]


def check() -> None:
    """Replays a random tenth of the episodes, as the leaderboard does with its entries."""
    every = kept()
    chosen = [every[number] for number in np.random.default_rng().choice(len(every), len(every) // 10, replace=False)]
    if different := differences(chosen):
        sys.exit("\n".join(different))
    print(f"{KEPT.name}: {len(chosen)} of {len(every)} episodes were replayed, with the same scores")


def stored() -> list[Mean]:
    """The means in the file."""
    with DATA.open(encoding="utf-8", newline="") as file:
        return [
            Mean(r["baseline"], int(r["run"]), r["set"], int(r["number"]), r["variant"], float(r["score"]))
            for r in csv.DictReader(file)
        ]


def store(means: Sequence[Mean]) -> None:
    """Writes the file."""
    with DATA.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(Mean._fields)
        writer.writerows((*mean[:-1], f"{mean.score:.4g}") for mean in means)


def over_intents(means: Iterable[Mean]) -> NDArray[Any]:
    """The mean over runs and variants of each intent, shape (intents,)."""
    found: dict[tuple[str, int], list[float]] = {}
    for mean in means:
        found.setdefault((mean.set, mean.number), []).append(mean.score)
    return np.array([np.mean(scores) for scores in found.values()])


def by_set_and_run(means: Iterable[Mean]) -> list[list[NDArray[Any]]]:
    """For each set and each run, the means over variants of each intent, shape (intents,)."""
    every = list(means)
    runs = sorted({mean.run for mean in every})
    return [[over_intents(m for m in every if (m.set, m.run) == (group, run)) for run in runs] for group in TESTS]


def interval(groups: Sequence[Sequence[NDArray[Any]]]) -> Estimate:
    """The mean of values by set and run, with its 95 % interval over runs and intents."""
    return mean_over([("", "", np.concatenate([np.stack(runs) for runs in groups], axis=1))])  # sets of equal size


def baselines(means: Sequence[Mean], columns: Sequence[str] = TESTS) -> str:
    """The table: means of sets or variants, the columns, and of all, with intervals."""
    rows = []
    for name, baseline in BASELINES.items():
        own = [mean for mean in means if mean.baseline == name]
        if own:
            parts = [f"{over_intents(m for m in own if name in (m.set, m.variant)).mean():.2f}" for name in columns]
            every = "{:.2f} ({:.2f} to {:.2f})".format(*interval(by_set_and_run(own)))
            rows.append((baseline.method, baseline.given, str(len({mean.run for mean in own})), *parts, every))
    return table(("Method", "Given", "Runs", *columns, "mean"), rows)


class Reading(NamedTuple):
    """What intent inference makes of an intent's demonstrations."""

    baseline: str
    set: str
    number: int
    intent: str
    inferred: str


def infer_all() -> None:
    """Writes the file of readings, or those that it lacks."""
    from magical_goals.inference import infer  # in a package that may not be installed

    tasks, known = played(INTENTS), {reading[:3] for reading in readings()}
    for name in (name for name, baseline in BASELINES.items() if baseline.policy == GOALS):
        left = {place: task for place, task in tasks.items() if (name, *place) not in known}
        how: dict[str, Any] = {"tasks": list(left.values()), "variants": "Demo", **BASELINES[name].settings}
        given = demonstrations_given(EvaluationSettings(**how)) if left else {}
        for place, task in left.items():
            inferred = infer([ends_of(demonstration) for demonstration in with_states(given[task])])[0].intent
            add(Reading(name, *place, str(intent_of(task)), str(inferred)))


def add(reading: Reading) -> None:
    """Adds a line to the file of readings, which is created if it is missing."""
    new = not INFERRED.exists()
    with INFERRED.open("a", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([*([Reading._fields] if new else []), reading])


def readings() -> list[Reading]:
    """The readings in the file; none if it is missing."""
    if not INFERRED.exists():
        return []
    with INFERRED.open(encoding="utf-8", newline="") as file:
        return [
            Reading(r["baseline"], r["set"], int(r["number"]), r["intent"], r["inferred"]) for r in csv.DictReader(file)
        ]


def misreading(reading: Reading) -> str:
    """One of `MISREADINGS`."""
    if reading.intent == reading.inferred:
        return "the intent"
    true, read = (Counter(one.relation for one in parse(text).conjuncts) for text in reading[-2:])
    if true == read:
        return "its relations, other blocks or places"
    return "fewer relations" if read < true else "other relations"


def write() -> None:
    """Writes the table."""
    tables = {"baselines": baselines(stored())}
    PAGE.write_text(filled(PAGE.read_text("utf-8"), tables, "python -m tools.intent_baselines"), "utf-8")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["play", out, *names]:
            play(Path(out), names or BASELINES)
        case ["infer"]:
            infer_all()
        case ["check"]:
            check()
        case ["write", *out]:
            if out:
                keep(whole(*map(Path, out)))
                store(gather(kept()))
            write()
        case _:
            sys.exit(__doc__)
