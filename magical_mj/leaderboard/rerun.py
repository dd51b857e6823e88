"""Re-runs: the policies in an entry's folder play fresh scenes, and must score what the entry says.

The folder `policies` holds them: ``0-FindDupe.onnx``, or a training's folder ``0-FindDupe``, is run 0 in FindDupe;
``0.onnx``, or ``0``, is run 0 in all tasks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from magical_mj.evaluation.reports.intervals import Cell, Estimate, estimate
from magical_mj.evaluation.reports.statistics import by_run_and_scene
from magical_mj.evaluation.run import Evaluation
from magical_mj.evaluation.scores import frame
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.leaderboard.entry import Entry
from magical_mj.policies.models import LOADERS
from magical_mj.tasks.registry import TASKS, Pair
from magical_mj.utils.errors import EvaluationError

POLICIES: Final = "policies"
SCENES: Final = 5
"""The number of fresh scenes in each environment by default."""
LARGEST_SEED: Final = 5_000_000
"""The first fresh scene is drawn below this number."""
_NAME: Final = re.compile(rf"(\d+)(?:-({'|'.join(TASKS)}))?")


class StoredPolicy(NamedTuple):
    """A policy in an entry's folder: the number of its run, its task (None: all) and its path."""

    run: int
    task: str | None
    path: Path


def stored_policies(folder: Path) -> list[StoredPolicy]:
    """The policies in an entry's folder, by name. Empty if it is a file, or has none.

    Raises:
        EvaluationError: if a file or folder among them has another name.
    """
    found = []
    for path in sorted((folder / POLICIES).iterdir()) if (folder / POLICIES).is_dir() else ():
        name = path.stem if path.suffix in LOADERS else path.name
        match = _NAME.fullmatch(name)
        if match is None:
            raise EvaluationError(f"{path} must be named RUN or RUN-TASK, such as 0-FindDupe.onnx")
        found.append(StoredPolicy(int(match[1]), match[2], path))
    return found


def rerun(
    entry: Entry,
    policies: Sequence[StoredPolicy],
    *,
    first_seed: int,
    scenes: int = SCENES,
    jobs: int | None = None,
    watch: Callable[[int, int], object] = lambda *_: None,
) -> Estimate:
    """Plays stored policies in fresh scenes of the entry's environments, without intents.

    Args:
        entry: the entry.
        policies: its policies, at least one for each task.
        first_seed: the number of the first scene in the split "fresh".
        scenes: the number of scenes in each environment.
        jobs: the number of processes; None: one per core.
        watch: called with the number of finished episodes, and the total.

    Returns:
        How much higher the mean score is in these scenes than in those of the entry, of the same runs. The interval
        covers scenes. If it excludes 0, the policies are not those of the entry.

    Raises:
        EvaluationError: if a task has no policy, or the entry has no episodes of a policy.
        SettingsError: if a policy cannot be loaded.
    """
    played = {(row.task, row.variant) for row in entry.counted if row.task in TASKS}
    if not played:
        raise EvaluationError(f"{entry.method} has only intents, which are not played again")
    if absent := sorted({task for task, _ in played} - {task for policy in policies for task in _tasks(policy)}):
        raise EvaluationError(f"{entry.method} has no policy for {', '.join(absent)} in {POLICIES}")
    evaluations = []
    for policy, task in ((stored, task) for stored in policies for task in _tasks(stored)):
        variants = sorted(variant for name, variant in played if name == task)
        settings = {"tasks": task, "variants": variants, "preset": entry.observations, "rules": entry.rules}
        settings |= {"split": "fresh", "first_seed": first_seed, "episodes": scenes, "run": policy.run, "jobs": jobs}
        if variants:
            evaluations.append(Evaluation({entry.method: str(policy.path)}, EvaluationSettings(**settings)))
    total = sum(len(unit.seeds) for evaluation in evaluations for unit in evaluation.units)
    cells: list[tuple[int, Pair, Any, Any]] = []
    done = 0
    for evaluation in evaluations:
        for _ in evaluation.play():
            done += 1
            watch(done, total)
        run = evaluation.settings.run
        for (task, variant), group in frame(evaluation.in_order()).groupby(["task", "variant"]):
            pair = str(task), str(variant)
            own = [row for row in entry.counted if (row.task, row.variant) == pair and row.run == run]
            if not own:
                raise EvaluationError(f"{entry.method} has no episodes of run {run} in {task} {variant}")
            cells.append((run, pair, by_run_and_scene(group), by_run_and_scene(frame(own))))
    return estimate(
        [
            Cell(scores, sign / len(cells), (run, pair[0]), (sign, pair))
            for run, pair, new, old in cells
            for sign, scores in ((1, new), (-1, old))
        ]
    )


def _tasks(policy: StoredPolicy) -> Sequence[str]:
    return TASKS if policy.task is None else (policy.task,)
