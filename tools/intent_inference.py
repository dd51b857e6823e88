"""Measures intent inference and policies for many intents on all test intents, by the scenes of their demonstrations.

    python -m tools.intent_inference goals       writes a table in docs/intents-evaluation.md
    python -m tools.intent_inference learnt OUT  writes another one, of the trainings in OUT

It needs the packages in methods/goals and methods/intents. Plans replace demonstrations and episodes: inference depends
on initial and final scenes only, and the objects that a policy chooses are brought to their targets. The first takes
five minutes of a core, the second one.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from magical_goals.inference import infer
from magical_goals.policy import SHOWN, chosen
from magical_intents.network import Planner
from magical_intents.plans import ends_of, followed
from magical_intents.policy import KINDS as NETWORKS
from magical_intents.policy import load_policy
from magical_intents.symmetries import words_of
from magical_intents.train import MOST_SHOWN

from magical_mj.evaluation.reports.intervals import Cell, Estimate, estimate
from magical_mj.intents import Intent
from magical_mj.intents.given import OFFICIAL_EPISODES, OFFICIAL_VARIANTS
from magical_mj.intents.names import TESTS, tasks_in
from magical_mj.intents.plans import planned, solved
from magical_mj.intents.selectors import REST
from magical_mj.intents.tasks import Task, spec_of
from magical_mj.scene import Scene
from magical_mj.variants import vary
from tools.pages import ROOT, filled, table

PAGE: Final = ROOT / "docs" / "intents-evaluation.md"
INTENTS: Final = 50
"""The number of intents of each set."""
KINDS: Final[Mapping[str, Mapping[str, Any]]] = {
    "one scene": {},
    "four random scenes": {"demos": 4},
    "four contrasting scenes": {"demos": 4, "contrasting": True},
}
"""The demonstrations' scenes -> the settings of the task that has them."""


class Found(NamedTuple):
    """What inference finds in one intent: shares of its relations, and of test scenes that the inferred one solves."""

    relations: float
    solved: float


def shown(task: Task) -> list[tuple[Scene, Scene]]:
    """The ends of a demonstration in each demo scene of a task."""
    return [planned(task.intent, demo) for demo in spec_of(task).demos]


def test_scenes(task: Task) -> list[Scene]:
    """The scenes of the official evaluation."""
    spec = spec_of(replace(task, demos=1, contrasting=False))
    return [vary(spec, variant, seed) for variant in OFFICIAL_VARIANTS for seed in range(OFFICIAL_EPISODES)]


def found(task: Task) -> Found:
    """What inference finds from a demonstration in each demo scene of a task."""
    goals = infer(shown(task))[:SHOWN]
    inferred, scenes = goals[0].intent.conjuncts, test_scenes(task)
    asked = [one for one in task.intent.conjuncts if one.selector != REST]
    return Found(
        float(np.mean([one in inferred for one in asked])),
        float(np.mean([_solves(chosen(goals, scene), task.intent, scene) for scene in scenes])),
    )


def _solves(inferred: Intent | None, intent: Intent, scene: Scene) -> bool:
    end = None if inferred is None else solved(inferred, scene)
    return end is not None and intent.holds(scene, end)


def inference() -> str:
    """The table: means over intents, with intervals, and differences to one scene."""
    every = {
        kind: {name: [found(replace(task, **settings)) for task in tasks_in(name)] for name in TESTS}
        for kind, settings in KINDS.items()
    }
    rows = []
    first = _cell(every["one scene"], "solved", -1.0)
    for kind, by_set in every.items():
        relations, whole = _cell(by_set, "relations"), _cell(by_set, "solved")
        sets = (f"{np.mean([one.solved for one in by_set[name]]):.2f}" for name in TESTS)
        more = "" if kind == "one scene" else _text(estimate([whole, first]))
        rows.append((kind, _text(estimate([relations])), *sets, _text(estimate([whole])), more))
    return table(("Demonstrations in", "Relations found", *TESTS, "Solved", "Gain over one scene"), rows)


class Reached(NamedTuple):
    """What a policy for many intents reaches in one intent: means over test scenes."""

    solved: float
    score: float


def reached(planner: Planner, task: Task) -> Reached:
    """What a planner reaches, given the sentence, or a demonstration in each demo scene of a task."""
    intent, scenes = task.intent, test_scenes(task)
    ends = (shown(task) * MOST_SHOWN)[:MOST_SHOWN]
    given = words_of(intent.sentence) if planner.reads else ends_of(ends)
    pairs = list(zip(scenes, followed(planner, given, scenes), strict=True))
    solved, scores = ([measure(*pair) for pair in pairs] for measure in (intent.holds, intent.score))
    return Reached(float(np.mean(solved)), float(np.mean(scores)))


def learnt(out: Path) -> str:
    """The table of the policies for many intents: means over intents, with intervals, and differences to one scene."""
    reads, shows = (load_policy(out / kind).planner for kind in NETWORKS[1:])
    rows, first = [], None
    for given, planner, settings in (
        ("the sentence", reads, {}),
        *((f"demonstrations in {kind}", shows, settings) for kind, settings in KINDS.items()),
    ):
        by_set = {name: [reached(planner, replace(task, **settings)) for task in tasks_in(name)] for name in TESTS}
        score = _cell(by_set, "score")
        more = "" if first is None else _text(estimate([score, first]))
        if planner is shows and first is None:
            first = _cell(by_set, "score", -1.0)
        sets = (f"{np.mean([one.score for one in by_set[name]]):.2f}" for name in TESTS)
        rows.append((given, _text(estimate([_cell(by_set, "solved")])), *sets, _text(estimate([score])), more))
    return table(("Given", "Solved", *TESTS, "Score", "Gain over one scene"), rows)


def _cell(by_set: Mapping[str, list[Found]] | Mapping[str, list[Reached]], measure: str, weight: float = 1.0) -> Cell:
    """The values of all intents, as one run."""
    values = [[getattr(one, measure) for name in TESTS for one in by_set[name]]]
    return Cell(np.array(values), weight, "policies", "intents")


def _text(value: Estimate) -> str:
    return "{:.2f} ({:.2f} to {:.2f})".format(*value)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["goals"]:
            tables = {"inference": inference()}
        case ["learnt", out]:
            tables = {"learnt": learnt(Path(out))}
        case _:
            sys.exit(__doc__)
    PAGE.write_text(filled(PAGE.read_text("utf-8"), tables, "python -m tools.intent_inference"), "utf-8")
