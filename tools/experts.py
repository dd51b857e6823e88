"""Writes docs/experts.md, and the episodes that the site shows, from an evaluation of the expert.

    magical-mj evaluate --policy expert --episodes 20 --out out/experts
    python tools/experts.py out/experts

`make demonstrations` does both.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import Final

from magical_mj import ENVIRONMENTS, TASKS
from magical_mj.evaluation.scores import EpisodeResult, read
from magical_mj.web.page_data import EXPERT, SCENES

INTRODUCTION: Final = """\
The scripted expert knows the true state and plans with the task's own subgoals and score: it tries manoeuvres on a
copy of the simulation and keeps the best. Use it as `--policy expert`, or as `magical_mj.experts.Expert(engine, task,
seed)`; with other seeds it acts differently.

![The expert in seven demonstrations, from left to right](experts.png)

It drives as people do at a keyboard, so that its actions follow from what learners see: the same target in the
robot's frame leads to the same action. It waits up to three steps before a manoeuvre, and one time in four changes its
action a step late. Steering corrects these errors, so its [demonstrations](demonstrations.md) show how to recover. Its
plans vary little, because ten demonstrators with ten plans are hard to imitate. At the end it keeps its fingers closed
for about ten steps, and then does nothing, at most 80 steps.

`magical-mj evaluate --policy expert --episodes 20 --out out/experts` played"""
PAGE: Final = Path(__file__).parent.parent / "docs" / "experts.md"


def page(scores: Sequence[EpisodeResult]) -> str:
    """The number of perfect episodes, a list of the others, and the mean times of each task's environments."""
    missed = sorted(f"{s.task} {s.variant} {s.seed}: {s.score:.2f}" for s in scores if s.score < 1.0)
    return "\n".join(
        [
            f"# The experts\n\n{INTRODUCTION}",
            f"{len(scores) // len(ENVIRONMENTS)} episodes in each environment, by the paper's rules.",
            f"{len(scores) - len(missed)} of {len(scores)} episodes have the full score.",
            *(f"- {line}" for line in missed),
            "\nMean seconds for an episode on one core, in the fastest and in the slowest variant of each task: "
            + ", ".join(f"{task} {_seconds(scores, task)}" for task in TASKS)
            + ".\n",
        ]
    )


def _seconds(scores: Sequence[EpisodeResult], task: str) -> str:
    means = [
        fmean(score.seconds for score in scores if (score.task, score.variant) == pair)
        for pair in ENVIRONMENTS
        if pair[0] == task
    ]
    return " to ".join(dict.fromkeys(f"{mean:.1f}" for mean in (min(means), max(means))))


def episodes(scores: Sequence[EpisodeResult]) -> str:
    """The actions of the first seeds of all environments as JSON, without Demo, which has demonstrations."""
    actions = {(score.task, score.variant, score.seed): score.actions for score in scores}
    table = {
        f"{task}-{variant}": [actions[task, variant, seed] for seed in range(SCENES)]
        for task, variant in ENVIRONMENTS
        if variant != "Demo"
    }
    return json.dumps(table, indent=0) + "\n"


def check(scores: Sequence[EpisodeResult]) -> None:
    """Exits with a message unless only the expert played, and it played all scenes that the site shows."""
    others = {score.policy for score in scores} - {"expert"}
    there = {(score.task, score.variant, score.seed) for score in scores}
    missing = [pair for pair in ENVIRONMENTS if not all((*pair, seed) in there for seed in range(SCENES))]
    if others or missing:
        names = ", ".join("-".join(pair) for pair in missing)
        sys.exit(f"not an evaluation of the expert alone: {others}" if others else f"episodes are missing in {names}")


if __name__ == "__main__":
    scores = read(Path(sys.argv[1]))
    check(scores)
    texts = {PAGE: page(scores), EXPERT: episodes(scores)}  # both, before either is written
    for path, text in texts.items():
        path.write_text(text, encoding="utf-8")
