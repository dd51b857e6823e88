"""Measures how many demo scenes settle what demonstrations mean, for intent inference in planned scenes.

    python -m tools.intent_scenes        adds intents to docs/intent-scenes.csv

An intent is inferred from the first and the planned final scene of each demo scene. The plan of the inferred intent is
then judged by the true intent, in scenes of Layout, All and Diagnose. Nothing is simulated, so all intents share the
same scenes, and no episode fails for another reason. It needs the package in methods/goals.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from magical_mj.intents.contrast import refutes, simplest_rivals
from magical_mj.intents.intent import Intent
from magical_mj.intents.names import tasks_in
from magical_mj.intents.plans import planned, solved
from magical_mj.intents.tasks import Task, spec_of
from magical_mj.scene import Scene
from magical_mj.tasks.spec import TaskSpec
from magical_mj.variants import vary
from tools.intents import TESTS
from tools.pages import ROOT

DATA: Final = ROOT / "docs" / "intent-scenes.csv"
SCENES: Final = (1, 2, 4, 8)
KINDS: Final = ("random", "contrasting")
INTENTS: Final = 10
"""The number of intents of each set."""
SEEDS: Final = 5
"""The number of scenes of Layout and of All."""
DIAGNOSES: Final = 10
"""The number of scenes of Diagnose."""


class Outcome(NamedTuple):
    """What an inferred intent leads to.

    Attributes:
        scenes: the number of demo scenes.
        score: the mean score of its plans, in Layout and All.
        intended: the share of scenes of Diagnose in which its plan satisfies the true intent.
        misled: the share of those in which it satisfies the scene's rival instead.
    """

    set: str
    number: int
    scenes: int
    kind: str
    inferred: str
    score: float
    intended: float
    misled: float


def outcomes(name: str, number: int, task: Task) -> list[Outcome]:
    """The outcomes of an intent."""
    from magical_goals.inference import Goal, infer  # in a package that may not be installed
    from magical_goals.policy import chosen

    intent, spec = task.intent, spec_of(task)
    tests = [vary(spec, variant, seed) for variant in ("Layout", "All") for seed in range(SEEDS)]
    hard = [(vary(spec, "Diagnose", seed), seed) for seed in range(DIAGNOSES)]
    known: dict[tuple[int, str], list[Goal]] = {}
    for kind in KINDS:
        several = spec_of(replace(task, demos=SCENES[-1], contrasting=kind == "contrasting"))
        ends = [planned(intent, scene) for scene in several.demos]
        known |= {(k, kind): infer(ends[:k])[:20] for k in SCENES if (1, KINDS[0]) not in known or k > 1}

    found = []
    for (scenes, kind), goals in known.items():

        def end(scene: Scene, goals: Sequence[Goal] = goals) -> Scene:
            read = chosen(goals, scene)
            return scene if read is None else solved(read, scene) or scene

        score = float(np.mean([intent.score(scene, end(scene)) for scene in tests]))
        ways = [reached(intent, spec, scene, seed, end(scene)) for scene, seed in hard]
        intended, misled = np.mean(ways, axis=0).tolist()
        found.append(Outcome(name, number, scenes, kind, str(goals[0].intent), score, intended, misled))
    return found


def reached(intent: Intent, spec: TaskSpec, scene: Scene, seed: int, end: Scene) -> tuple[bool, bool]:
    """Whether a scene of Diagnose ends as intended, and if not, as the rival wants for which it was drawn."""
    every = simplest_rivals(intent, spec.demo)
    first = seed % max(1, len(every))
    rival = next((one for one in every[first:] + every[:first] if refutes(intent, one, scene)), None)
    right = intent.holds(scene, end)
    return right, not right and rival is not None and rival.holds(scene, end)


def play() -> None:
    """Adds intents to the file. The first of each set are first."""
    known = {(row.set, row.number) for row in stored()}
    for number in range(INTENTS):
        for name in TESTS:
            if (name, number) not in known:
                rows = outcomes(name, number, tasks_in(name)[number])
                new = not DATA.exists()
                with DATA.open("a", encoding="utf-8", newline="") as file:
                    writer = csv.writer(file, lineterminator="\n")
                    writer.writerows([Outcome._fields] if new else [])
                    writer.writerows((*row[:5], *(f"{value:.4g}" for value in row[5:])) for row in rows)


def stored() -> list[Outcome]:
    """The outcomes in the file; none if it is missing."""
    if not DATA.exists():
        return []
    with DATA.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    return [Outcome(s, int(n), int(k), kind, text, *map(float, rest)) for s, n, k, kind, text, *rest in rows]


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    play()
