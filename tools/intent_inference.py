"""Measures intent inference and policies for many intents on all test intents, by the scenes of their demonstrations.

    python -m tools.intent_inference goals          writes a table in docs/intents-evaluation.md
    python -m tools.intent_inference learnt OUT...  measures trainings, each into a new file in results, and writes
                                                    another table, of all these files

It needs the packages in methods/goals and methods/intents. Plans replace demonstrations and episodes: inference depends
on initial and final scenes only, and the final scenes that policies search for are reached. The first takes ten
minutes of a core, the second four for each training.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from magical_goals.inference import best_intent, infer
from magical_intents.ends import Judged, after, judged_in, resting, simple_rivals
from magical_intents.lessons import MOST_SHOWN
from magical_intents.policy import POLICY
from magical_intents.scorer import Scorer
from magical_intents.search import searched
from magical_intents.symmetries import words_of
from magical_intents.train import SCORER
from torch import Tensor

from magical_mj.evaluation.reports.intervals import Cell, Estimate, estimate
from magical_mj.intents import Intent
from magical_mj.intents.given import OFFICIAL_EPISODES, OFFICIAL_VARIANTS
from magical_mj.intents.names import TESTS, tasks_in
from magical_mj.intents.plans import planned, solved
from magical_mj.intents.selectors import REST
from magical_mj.intents.tasks import Task, spec_of
from magical_mj.learners import checkpoint
from magical_mj.scene import Scene
from magical_mj.tasks.planning import Noise
from magical_mj.utils import files
from magical_mj.variants import vary
from tools.pages import ROOT, filled, table

PAGE: Final = ROOT / "docs" / "intents-evaluation.md"
LEARNT: Final = ROOT / "results" / "intents-learnt-*.jsonl"
"""The files of `measure`."""
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
    goals = infer(shown(task))
    inferred, scenes = goals[0].intent.conjuncts, test_scenes(task)
    asked = [one for one in task.intent.conjuncts if one.selector != REST]
    return Found(
        float(np.mean([one in inferred for one in asked])),
        float(np.mean([_solves(best_intent(goals, scene), task.intent, scene) for scene in scenes])),
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


@cache
def four_shown(task: Task) -> list[tuple[Scene, Scene]]:
    """The ends of four demonstrations, in one demo scene after the other. Those in the same scene differ."""
    noise = Noise(np.random.default_rng(0), 1.0)
    pairs = shown(task)
    for scene, end in pairs[: MOST_SHOWN - len(pairs)] * MOST_SHOWN:
        pairs.append((scene, solved(task.intent, scene, noise) or end))
    return pairs[:MOST_SHOWN]


@cache
def asked_scenes(task: Task) -> list[Scene]:
    """The first of the official scenes of each variant."""
    return test_scenes(task)[::OFFICIAL_EPISODES]


@cache
def asked_ends(task: Task) -> list[Judged]:
    """Final scenes in the scenes where the intent has a plan."""
    others, rng = simple_rivals(task.intent, spec_of(task).demo), np.random.default_rng(0)
    return [one for scene in asked_scenes(task) for one in judged_in(task.intent, scene, others, rng)]


class Reached(NamedTuple):
    """What a policy for many intents reaches in one intent: means over test scenes.

    Attributes:
        given: what it receives.
        task: the intent, with the seed of its demo scenes.
        chosen: how often it prefers an end that reaches the intent to the ends of rivals, and to random ones.
        solved: how often the end that it searches reaches the intent.
        score: the score of that end.
        predicted: the score that the network predicts for it.
    """

    given: str
    task: str
    chosen: float
    solved: float
    score: float
    predicted: float


@torch.inference_mode()
def reached(scorer: Scorer, task: Task) -> Iterator[Reached]:
    """What a scorer reaches, given the sentence, and given a demonstration in each demo scene of a task."""
    intent, scenes = task.intent, asked_scenes(task)
    initial = torch.from_numpy(resting(scenes))
    contexts = {"the sentence": scorer.read(torch.from_numpy(words_of(intent.sentence))[None])}
    for kind, settings in KINDS.items():
        pairs = four_shown(replace(task, **settings))
        ends = (torch.from_numpy(resting(each))[None] for each in zip(*pairs, strict=True))
        contexts[f"demonstrations in {kind}"] = scorer.shown(*ends)
    for given, each in contexts.items():
        context = each.expand(len(scenes), -1, -1)
        ends = searched(scorer, context, initial)
        pairs = [(scene, after(scene, end)) for scene, end in zip(scenes, ends.numpy(), strict=True)]
        found = (
            [choice(scorer, each, one) for one in asked_ends(task)],
            *([measure(*pair) for pair in pairs] for measure in (intent.holds, intent.score)),
            scorer.scored(scorer.encoded(initial, context), ends).scores.sigmoid().numpy(),
        )
        yield Reached(given, str(task), *(float(np.mean(values)) for values in found))


def choice(scorer: Scorer, context: Tensor, asked: Judged) -> bool:
    """Whether a scorer prefers the end of the intent's cheapest plan to all ends that do not reach it."""
    ends = torch.from_numpy(np.concatenate([asked.ends[:1], asked.ends[asked.scores < 1.0]]))
    encoded = scorer.encoded(torch.from_numpy(asked.start)[None], context)
    return int(scorer.scored(encoded.repeated(len(ends)), ends).scores.argmax()) == 0


def measure(out: Path) -> None:
    """Writes what the policies of a training reach into a new file, which is never altered."""
    scorer, number = Scorer().eval(), len(measured())
    scorer.load_state_dict(checkpoint.read(out / SCORER / POLICY)["weights"])
    found = [one for name in TESTS for task in tasks_in(name)[:INTENTS] for one in reached(scorer, task)]
    files.write(LEARNT.with_name(f"intents-learnt-{number}.jsonl"), "".join(f"{json.dumps(one)}\n" for one in found))


def measured() -> list[list[Reached]]:
    """What each training reaches."""
    paths = sorted(LEARNT.parent.glob(LEARNT.name))
    return [[Reached(*json.loads(line)) for line in path.read_text("utf-8").splitlines()] for path in paths]


def learnt() -> str:
    """The table of the policies for many intents: means over intents and trainings, with intervals, and differences."""
    runs, rows = measured(), []

    def cell(given: str, measure: str, weight: float = 1.0) -> Cell:
        values = [[getattr(one, measure) for one in run if one.given == given] for run in runs]
        return Cell(np.array(values), weight, "policies", "intents")

    one_scene, *more = (f"demonstrations in {kind}" for kind in KINDS)
    for given in ("the sentence", one_scene, *more):
        parts = [given]
        for measure in ("chosen", "solved", "score"):
            gain = estimate([cell(given, measure), cell(one_scene, measure, -1.0)])
            parts += [_text(estimate([cell(given, measure)])), _text(gain) if given in more else ""]
        rows.append((*parts, _text(estimate([cell(given, "predicted")]))))
    gain = "Gain over one scene"
    return table(("Given", "Right end chosen", gain, "Solved", gain, "Score", gain, "Predicted score"), rows)


def _cell(by_set: Mapping[str, list[Found]], measure: str, weight: float = 1.0) -> Cell:
    """The values of all intents, as one run."""
    values = [[getattr(one, measure) for name in TESTS for one in by_set[name]]]
    return Cell(np.array(values), weight, "policies", "intents")


def _text(value: Estimate) -> str:
    return "{:.2f} ({:.2f} to {:.2f})".format(*value)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["goals"]:
            tables = {"inference": inference()}
        case ["learnt", *out]:
            for folder in map(Path, out):
                measure(folder)
            tables = {"learnt": learnt()}
        case _:
            sys.exit(__doc__)
    PAGE.write_text(filled(PAGE.read_text("utf-8"), tables, "python -m tools.intent_inference"), "utf-8")
