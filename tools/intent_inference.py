"""Measures what intent inference finds in test intents, by the scenes of its demonstrations.

    python -m tools.intent_inference        writes a table in docs/intents-evaluation.md

It needs the package in methods/goals. Plans replace demonstrations and episodes, since inference depends on initial and
final scenes only. It takes about a minute of a core.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from magical_goals.inference import infer
from magical_goals.policy import SHOWN, chosen

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
INTENTS: Final = 10
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


def found(task: Task) -> Found:
    """What inference finds from a demonstration in each demo scene of a task."""
    goals = infer([planned(task.intent, demo) for demo in spec_of(task).demos])[:SHOWN]
    spec, inferred = spec_of(replace(task, demos=1, contrasting=False)), goals[0].intent.conjuncts
    scenes = [vary(spec, variant, seed) for variant in OFFICIAL_VARIANTS for seed in range(OFFICIAL_EPISODES)]
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
    tasks = {name: tasks_in(name)[:INTENTS] for name in TESTS}
    every = {
        kind: {name: [found(replace(task, **settings)) for task in members] for name, members in tasks.items()}
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


def _cell(by_set: Mapping[str, list[Found]], measure: str, weight: float = 1.0) -> Cell:
    """The values of all intents, as one run."""
    values = [[getattr(one, measure) for name in TESTS for one in by_set[name]]]
    return Cell(np.array(values), weight, "policies", "intents")


def _text(value: Estimate) -> str:
    return "{:.2f} ({:.2f} to {:.2f})".format(*value)


if __name__ == "__main__":
    tables = {"inference": inference()}
    PAGE.write_text(filled(PAGE.read_text("utf-8"), tables, "python -m tools.intent_inference"), "utf-8")
