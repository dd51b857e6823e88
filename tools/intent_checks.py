"""Checks which information policies for many intents use.

    python -m tools.intent_checks play OUT     plays policies that were trained in OUT; called again, it continues
    python -m tools.intent_checks write OUT    writes docs/intent-checks.csv

In the check "wrong", a policy receives the sentence or the demonstrations of another intent of the set. In "Diagnose",
its scenes refute rivals of the intent.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import magical_mj
from magical_mj.evaluation.replay import engine_for, replay_problem
from magical_mj.evaluation.reports.intervals import Estimate
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.intents.given import intent_of
from magical_mj.tasks.registry import task_spec
from tools.intent_baselines import BASELINES, SECONDS, Mean, by_set_and_run, episodes_of, interval, played
from tools.intent_scenes import reached
from tools.tables import ROOT

DATA: Final = ROOT / "docs" / "intent-checks.csv"
NAMES: Final = ("sentence-policy", "demonstrations-policy-1", "demonstrations-policy-4")
"""The rows of tools.intent_baselines that are checked."""
CHECKS: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "wrong": {"variants": ["All"], "episodes": 1},
        "Diagnose": {"variants": ["Diagnose"], "episodes": 2},
    }
)
"""Check -> its settings. The intents are those of tools.intent_baselines."""


class Check(NamedTuple):
    """What an episode reached.

    Attributes:
        score: the score of the intent; in Diagnose, whether it holds at the end.
        other: with the sentence of another intent, its score; in Diagnose, whether the intent does not hold, but the
            rival for which the scene was drawn. None with demonstrations of another intent, which may have no meaning
            in the scene.
    """

    baseline: str
    check: str
    set: str
    number: int
    variant: str
    seed: int
    score: float
    other: float | None


def play(out: Path) -> None:
    """Plays the checks; each has a folder in `out`."""
    for check, how in CHECKS.items():
        for name in NAMES:
            folder, baseline = out / f"{name}-{check}", BASELINES[name]
            given = "demonstrations" if "demonstrations" in baseline.settings else "instruction"
            control = {"control": f"wrong-{given}"} if check == "wrong" else {}
            magical_mj.evaluate(
                str(out / baseline.policy),
                name=baseline.method,
                tasks=list(played(BASELINES[name].intents).values()),
                jobs=1,
                time_limit=SECONDS,
                out=folder,
                resume=folder.exists(),
                **how,
                **control,
                **baseline.settings,
            )


def gather(out: Path) -> list[Check]:
    """The checks that were played to the end."""
    found = []
    for name in NAMES:
        places = {task: place for place, task in played(BASELINES[name].intents).items()}
        for check, how in CHECKS.items():
            episodes = episodes_of(out / f"{name}-{check}")
            if len(episodes) == len(places) * len(how["variants"]) * how["episodes"]:
                for e in episodes:
                    outcome = _diagnosed(e) if check == "Diagnose" else (e.score, _other_score(e))
                    found.append(Check(name, check, *places[e.task], e.variant, e.seed, *outcome))
    return found


def _other_score(episode: EpisodeResult) -> float | None:
    return episode.other_score if episode.given.endswith("instruction") else None


def _diagnosed(episode: EpisodeResult) -> tuple[float, float]:
    """Whether an episode of Diagnose ends as intended, and if not, as the scene's rival wants."""
    with closing(engine_for(episode)) as engine:
        initial = engine.initial_scene
        if problem := replay_problem(episode, engine):
            sys.exit(f"{episode.task}: {problem}")
        right, misled = reached(intent_of(episode.task), task_spec(episode.task), initial, episode.seed, engine.scene)
    return float(right), float(misled)


def stored() -> list[Check]:
    """The checks in the file; none if it is missing."""
    if not DATA.exists():
        return []
    with DATA.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    return [
        Check(name, check, group, int(number), variant, int(seed), float(score), float(other) if other else None)
        for name, check, group, number, variant, seed, score, other in rows
    ]


def store(checks: Sequence[Check]) -> None:
    """Writes the file."""
    with DATA.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(Check._fields)
        for check in checks:
            writer.writerow((*check[:-2], *("" if value is None else f"{value:.4g}" for value in check[-2:])))


def means(checks: Sequence[Check], name: str, check: str, field: str) -> tuple[float, ...]:
    """The mean of a field over intents, and its 95 % interval; empty if the episodes do not have the field."""
    rows = [row for row in checks if (row.baseline, row.check) == (name, check)]
    known = [(row, value) for row in rows if (value := getattr(row, field)) is not None]
    every = [Mean(name, 0, row.set, row.number, row.variant, value) for row, value in known]
    return interval(by_set_and_run(every)) if known else ()


def right(baselines: Sequence[Mean], name: str) -> Estimate:
    """The mean score of the first run with the right information in the scenes of "wrong", and its interval."""
    chosen = [m for m in baselines if (m.baseline, m.run) == (name, 0) and m.variant in CHECKS["wrong"]["variants"]]
    return interval(by_set_and_run(chosen))


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["play", out]:
            play(Path(out))
        case ["write", out]:
            store(gather(Path(out)))
        case _:
            sys.exit(__doc__)
