"""Re-runs: the policies in an entry's folder play fresh scenes, and must score what the entry says.

The folder `policies` holds them: ``0-FindDupe.onnx``, or a training's folder ``0-FindDupe``, is run 0 in FindDupe;
``0-intents`` is run 0 in all intents, and ``0.onnx``, or ``0``, in all tasks and all intents.

Tasks are played in some fresh scenes of each environment. There are many intents, so a random sample of each set is
played, once in each variant. Policies receive the same demonstrations and sentences as in the entry.
"""

from __future__ import annotations

import random
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from magical_mj.evaluation.reports.intervals import Cell, Estimate, Floats, estimate
from magical_mj.evaluation.reports.statistics import by_run_and_scene
from magical_mj.evaluation.run import Evaluation
from magical_mj.evaluation.scores import EpisodeResult, frame
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.intents.names import TESTS, tasks_in
from magical_mj.intents.tasks import PREFIX
from magical_mj.leaderboard.entry import Entry
from magical_mj.leaderboard.places import intents
from magical_mj.policies.models import LOADERS
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, Pair
from magical_mj.utils.errors import EvaluationError, counted

POLICIES: Final = "policies"
SCENES: Final = 5
"""The number of fresh scenes in each environment of tasks by default."""
PER_SET: Final = 20
"""The number of intents of each set by default."""
LARGEST_SEED: Final = 5_000_000
"""The first fresh scene is drawn below this number."""
INTENTS: Final = "intents"
PARTS: Final = (*TASKS, INTENTS)
"""The parts of an entry that may have policies of their own."""
_NAME: Final = re.compile(rf"([0-9]+)(?:-({'|'.join(PARTS)}))?")

Rows = list[EpisodeResult]
Results = Mapping[tuple[str, int], Rows]
"""Part and run -> the episodes."""


class StoredPolicy(NamedTuple):
    """A policy in an entry's folder: the number of its run, its part (None: all) and its path."""

    run: int
    part: str | None
    path: Path

    @property
    def parts(self) -> Sequence[str]:
        """The parts that it plays."""
        return PARTS if self.part is None else (self.part,)


def stored_policies(folder: Path) -> list[StoredPolicy]:
    """The policies in an entry's folder, by name. Empty if it is a file, or has none.

    Raises:
        EvaluationError: if a file or folder among them has another name, or two are the same run in a part.
    """
    found, holders = list[StoredPolicy](), dict[tuple[int, str], Path]()
    for path in sorted((folder / POLICIES).iterdir()) if (folder / POLICIES).is_dir() else ():
        is_model = path.suffix in LOADERS
        match = _NAME.fullmatch(path.stem if is_model else path.name)
        if match is None or not (is_model or path.is_dir()):
            raise EvaluationError(
                f"{path} must be a model ({', '.join(LOADERS)}) or a folder, and named RUN, RUN-TASK or RUN-{INTENTS}, "
                "such as 0-FindDupe.onnx"
            )
        found.append(StoredPolicy(int(match[1]), match[2], path))
        for part in found[-1].parts:
            if (other := holders.setdefault((found[-1].run, part), path)) is not path:
                raise EvaluationError(f"{other} and {path} are both run {found[-1].run} in {part}: keep one of them")
    return found


def rerun(
    entry: Entry,
    policies: Sequence[StoredPolicy],
    *,
    first_seed: int,
    scenes: int = SCENES,
    per_set: int = PER_SET,
    jobs: int | None = None,
    watch: Callable[[int, int], object] = lambda *_: None,
) -> dict[str, Estimate]:
    """Plays stored policies in fresh scenes of the entry's environments, except those of intents in Demo.

    Args:
        entry: the entry.
        policies: its policies, at least one for each task, and one for intents if it has some. Those of all parts play
            where their run has episodes.
        first_seed: the number of the first scene in the split "fresh". It also determines the sample of intents.
        scenes: the number of scenes in each environment of tasks.
        per_set: the largest number of intents of each set.
        jobs: the number of processes; None: one per core.
        watch: called with the number of finished episodes, and the total; before, with that of new demonstrations.

    Returns:
        How much higher the mean score is in these scenes than in those of the entry, of the same runs: for tasks, for
        intents, or for both. The key says what was played. The interval of tasks covers scenes, that of intents covers
        intents and their scenes. If one excludes 0, the policies are not those of the entry.

    Raises:
        EvaluationError: if a part has no policy, the entry has too few episodes of a policy, or a policy uses or
            receives more than the entry says.
        MagicalError: if a policy cannot be loaded, or demonstrations cannot be made.
    """
    recorded = _by_part(entry.counted)
    if not recorded:
        raise EvaluationError(f"{entry.method} has only intents in Demo, which has no fresh scenes")
    played = {part for part, _ in recorded}
    stored = {
        (part, each.run): each
        for each in policies
        for part in each.parts
        if part in played and (each.part is not None or (part, each.run) in recorded)
    }
    runs = {part: [run for name, run in stored if name == part] for part in PARTS if part in played}
    if absent := [part for part, known in runs.items() if not known]:
        raise EvaluationError(f"{entry.method} has no policy of its runs for {', '.join(absent)} in {POLICIES}")
    environments = {
        part: _environments(entry.method, part, recorded, known, first_seed, per_set) for part, known in runs.items()
    }
    evaluations: dict[tuple[str, int], Evaluation] = {}
    for (part, run), policy in stored.items():
        tasks, variants = environments[part]
        number = {"episodes": 1 if part == INTENTS else scenes, "first_seed": first_seed, "run": run, "jobs": jobs}
        evaluations[part, run] = _evaluation(entry, policy, part, watch, tasks=tasks, variants=variants, **number)
    total, done = sum(len(unit.seeds) for each in evaluations.values() for unit in each.units), 0
    fresh: dict[tuple[str, int], Rows] = {}
    for key, evaluation in evaluations.items():
        for _ in evaluation.play():
            done += 1
            watch(done, total)
        fresh[key] = evaluation.in_order()
    found: dict[str, Estimate] = {}
    if tasks := played - {INTENTS}:
        found[f"{counted(len(tasks), 'task')}, {counted(scenes, 'scene')} in each environment"] = _in_tasks(
            {key: rows for key, rows in fresh.items() if key[0] != INTENTS}, recorded
        )
    if INTENTS in played:
        tasks, variants = environments[INTENTS]
        found[f"{counted(len(tasks), 'intent')}, a scene of each in {' and '.join(variants)}"] = _in_intents(
            fresh, recorded, tasks, variants
        )
    return found


def _by_part(episodes: Sequence[EpisodeResult]) -> dict[tuple[str, int], Rows]:
    found = defaultdict[tuple[str, int], Rows](list)
    required = {*ENVIRONMENTS, *intents()}  # not Demo of intents
    for row in episodes:
        if (row.task, row.variant) in required:
            found[row.task if row.task in TASKS else INTENTS, row.run].append(row)
    return found


def _environments(
    method: str, part: str, recorded: Results, runs: Sequence[int], first_seed: int, per_set: int
) -> tuple[list[str], list[str]]:
    """The tasks and variants of a part that are played: of intents, a sample of those that all stored runs have played.

    Raises:
        EvaluationError: if too few episodes of a stored run were recorded for an interval.
    """
    of_part = [row for (name, _), rows in recorded.items() if name == part for row in rows]
    variants = sorted({row.variant for row in of_part}, reverse=part == INTENTS)
    tasks, least = {row.task for row in of_part}, 1 if part == INTENTS else 2
    for run in runs:
        numbers = Counter((row.task, row.variant) for row in recorded.get((part, run), ()))
        tasks = {task for task in tasks if all(numbers[task, variant] >= least for variant in variants)}
    if len(tasks) < (2 if part == INTENTS else 1):
        least_played = "two intents" if part == INTENTS else "two episodes"
        raise EvaluationError(
            f"{method} has too few episodes of run {' or '.join(map(str, runs))} in {part} to compare: at least "
            f"{least_played} in each of {', '.join(variants)} are needed"
        )
    return (_sample(tasks, first_seed, per_set) if part == INTENTS else sorted(tasks)), variants


def _sample(tasks: Collection[str], seed: int, per_set: int) -> list[str]:
    """The same number of intents of each set, if there are enough."""
    draw, found = random.Random(seed), list[str]()  # noqa: S311
    for name in TESTS:
        members = [task for task in (f"{PREFIX}{task}" for task in tasks_in(name)) if task in tasks]
        found += draw.sample(members, min(per_set, len(members)))
    return found


def _evaluation(
    entry: Entry, policy: StoredPolicy, part: str, watch: Callable[[int, int], object], **settings: Any
) -> Evaluation:
    """The evaluation of a stored policy in a part, with what it received in the entry.

    Raises:
        EvaluationError: if the policy uses or receives something else.
    """
    from magical_mj.intents.given import settings_of  # imported late: it loads the simulator

    given = entry.recorded.given if part == INTENTS else entry.recorded.given_in_tasks
    settings |= {"preset": entry.observations, "rules": entry.rules, "split": "fresh", **settings_of(given)}
    evaluation = Evaluation({entry.method: str(policy.path)}, EvaluationSettings(**settings), watch)
    (source,) = evaluation.sources
    receives = evaluation.settings.given(source)
    if receives != given:
        raise EvaluationError(
            f"{policy.path} receives {receives or 'no description'} in {part}, but the entry says {given or 'none'}"
        )
    if entry.recorded.uses and (more := source.uses - {*entry.recorded.uses}):
        raise EvaluationError(f"{policy.path} uses {' and '.join(sorted(more))}, which the entry does not say")
    if "observations" in source.uses and evaluation.settings.observed != entry.observations:
        observed = entry.observations or "no observations"
        raise EvaluationError(f"{policy.path} observes {evaluation.settings.observed}, but the entry {observed}")
    return evaluation


def _in_tasks(fresh: Results, recorded: Results) -> Estimate:
    cells: list[tuple[int, Pair, Any, Any]] = []
    for (task, run), rows in fresh.items():
        for variant, group in frame(rows).groupby("variant"):
            own = [row for row in recorded[task, run] if row.variant == variant]
            cells.append((run, (task, str(variant)), by_run_and_scene(group), by_run_and_scene(frame(own))))
    return estimate(
        [
            Cell(scores, sign / len(cells), (run, pair[0]), (sign, pair))
            for run, pair, new, old in cells
            for sign, scores in ((1, new), (-1, old))
        ]
    )


def _in_intents(fresh: Results, recorded: Results, tasks: Sequence[str], variants: Sequence[str]) -> Estimate:
    """The difference, paired by intent. Its variants have equal weight on both sides."""
    from magical_mj.intents.by_set import by_intent  # imported late: it loads the simulator

    def means(rows: Rows, run: int) -> Floats:
        parts = [[row for row in rows if row.variant == variant] for variant in variants]
        return np.mean([by_intent(part, "score", tasks, [run]) for part in parts], axis=0)

    runs = sorted(run for part, run in fresh if part == INTENTS)
    return estimate(
        [
            Cell(means(results[INTENTS, run], run), sign / len(runs), run, INTENTS)
            for run in runs
            for sign, results in ((1, fresh), (-1, recorded))
        ]
    )
