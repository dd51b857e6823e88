"""Checks of results, evaluations' folders and entries: their episodes are replayed from their seeds and actions."""

from __future__ import annotations

import math
import random
import secrets
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from magical_mj.evaluation.entry import SEEDS, Entry
from magical_mj.evaluation.replay import Recorded, inconsistency, replay
from magical_mj.evaluation.scores import SETTINGS, EpisodeResult, read, recorded_policies, recorded_settings
from magical_mj.evaluation.settings import UNOFFICIAL
from magical_mj.tasks.protocol import DEMONSTRATIONS, PROTOCOL
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, task_spec
from magical_mj.utils.errors import counted, short_repr
from magical_mj.utils.files import to_path
from magical_mj.variants import check_seed

SHARE: Final = 0.1
"""The share of an entry's episodes that are replayed by default."""
MOST_REPLAYED: Final = 500
"""The largest number of an entry's episodes that are replayed by default, so that a folder of many takes minutes. Where
one episode in a hundred is false, such a sample misses all of them once in 150 times, and the next draws others."""


@dataclass
class Findings:
    """The result of a check.

    Attributes:
        episodes: the number of replayed episodes.
        differing: a sentence for each episode that differs from its record.
        missing: a sentence for each run and environment that lacks episodes.
        unfit: sentences about everything else that does not match this version's protocol.
    """

    episodes: int = 0
    differing: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    unfit: list[str] = field(default_factory=list)

    @property
    def good(self) -> bool:
        """Whether no problems were found."""
        return not (self.differing or self.missing or self.unfit)

    def add(self, problem: str | None) -> None:
        """Counts a replayed episode: how it differs from its record; None if it does not."""
        self.episodes += 1
        if problem is not None:
            self.differing.append(problem)


def verify(folder: Path | str, *, jobs: int | None = None, watch: Callable[[], object] = lambda: None) -> Findings:
    """Replays the episodes of an evaluation, and checks its settings and completeness against the protocol.

    Failed episodes, and those of tasks outside the benchmark, are not replayed. What was to be played is
    taken from the settings, so that an environment or a run without any episodes is missed.

    Args:
        folder: the folder of the evaluation.
        jobs: the number of processes; None: one per core.
        watch: called after each episode.

    Raises:
        EvaluationError: if the folder is not an evaluation.
    """
    folder = to_path(folder)
    settings, episodes = recorded_settings(folder), read(folder)
    if any(episode.worlds != "single" for episode in episodes):
        return Findings(unfit=[f"it was played in batched worlds: {UNOFFICIAL}"])
    if wrappers := {episode.wrap for episode in episodes if episode.wrap}:
        return Findings(unfit=[f"it was played in {', '.join(sorted(wrappers))}, and is replayed in plain worlds only"])
    findings = Findings()
    if others := {episode.split for episode in episodes} - {"test"}:
        findings.unfit.append(f"split: results are those on test, and it was played on {', '.join(sorted(others))}")
    required = {"protocol": {PROTOCOL}, "demonstrations": {DEMONSTRATIONS}, "rules": {row.rules for row in episodes}}
    for name, values in required.items():
        recorded = f"{settings[name]!r} is recorded" if name in settings else "nothing is recorded"
        others = sorted(value for value in values if value != settings.get(name))
        findings.unfit += [f"{name}: {recorded}, and it must be {value!r}" for value in others]
    environments = {pair for pair in ENVIRONMENTS if "-".join(pair) in settings.get("environments", ())}
    runs: dict[str, set[int]] = defaultdict(set)
    for policy, run, _ in recorded_policies(settings):
        runs[policy].add(run)
    findings.unfit += _contradictions(settings, environments, runs, episodes)
    tasks = {task for task, _ in environments} | {episode.task for episode in episodes}
    for policy in dict.fromkeys([*runs, *(episode.policy for episode in episodes)]):
        played = [episode for episode in episodes if episode.policy == policy]
        findings.missing += [f"{policy}, {gap}" for gap in missing(played, tasks, runs.get(policy, ()))]
        if others := sum(episode.task not in TASKS for episode in played):
            findings.unfit.append(f"{policy}: tasks outside the benchmark in {counted(others, 'episode')}")
    for _, _, problem in replay([("", episode) for episode in episodes if episode.task in TASKS], jobs=jobs):
        findings.add(problem)
        watch()
    return findings


def _contradictions(
    settings: Mapping[str, Any],
    environments: Collection[tuple[str, str]],
    runs: Mapping[str, Collection[int]],
    episodes: Sequence[EpisodeResult],
) -> list[str]:
    """A sentence for each thing that episodes say otherwise than the settings, or than their own actions."""
    problems: dict[str, list[str]] = defaultdict(list)
    for episode in episodes:
        pair, count = (episode.task, episode.variant), len(episode.actions)
        texts = {
            name: f"it was played with {value!r}, and {SETTINGS} says {short_repr(settings.get(name))}"
            for name in ("preset", "version", "mujoco")  # workers of a cluster choose the OpenGL backend themselves
            if (value := getattr(episode, name)) not in (settings.get(name), None)  # who looks at nothing has no preset
        }
        if episode.run not in runs.get(episode.policy, ()):
            texts["run"] = f"{SETTINGS} does not name it"
        if pair in ENVIRONMENTS and pair not in environments:
            texts["environment"] = f"{SETTINGS} does not name it"
        if episode.steps != count:
            texts["steps"] = f"it says {episode.steps}, and holds {count} actions"
        for name, text in texts.items():
            problems[name].append(f"{episode.policy}, {episode.title}: {text}")
    return [
        f"{name}: {first}" + (f"; and {len(others)} more" if others else "")
        for name, (first, *others) in problems.items()
    ]


def missing(episodes: Iterable[EpisodeResult], tasks: Collection[str], runs: Iterable[int] = ()) -> list[str]:
    """Which episodes that the protocol requires are missing: a sentence for each run and environment.

    Each run must have played in all environments of these tasks; of `runs` there may be no episodes at all.
    """
    seeds: dict[tuple[int, str, str], set[int]] = defaultdict(set)
    for episode in (episode for episode in episodes if not episode.shift):
        seeds[episode.run, episode.task, episode.variant].add(episode.seed)
    problems = []
    for run in sorted({*runs, *(run for run, _, _ in seeds)}):
        for task, variant in ENVIRONMENTS:
            absent = set(range(SEEDS)) - seeds[run, task, variant]
            if task in tasks and absent:
                which = "all" if len(absent) == SEEDS else f"{len(absent)}, such as seed {min(absent)},"
                problems.append(f"run {run}, {task} {variant}: {which} of the {SEEDS} episodes are missing")
    return problems


def check_entries(
    entries: Mapping[str, Entry],
    *,
    most: int | None = MOST_REPLAYED,
    seed: int | None = None,
    jobs: int | None = None,
    watch: Callable[[int, int], object] = lambda *_: None,
) -> dict[str, Findings]:
    """Replays a random part of the episodes of each entry that count.

    All of these are checked for what is seen without playing them: their length, and that failures have the score 0.
    The choice of episodes does not depend on the file, whose author could otherwise alter it until the choice is good.

    Args:
        entries: the entries by name, which problems are told by.
        most: the largest number of episodes of an entry that are replayed, a tenth of them otherwise; None: all are.
        seed: with which a check can be repeated: the same seed chooses the same episodes; None: nobody knows which.
        jobs: the number of processes; None: one per core.
        watch: called with the number of replayed episodes, and of all that will be.

    Returns:
        The findings by the entries' names.

    Raises:
        InvalidSeedError: if `seed` is not an integer, or negative.
    """
    seed = secrets.randbits(64) if seed is None else check_seed(seed)
    findings: dict[str, Findings] = {}
    chosen: list[Recorded] = []
    for name, entry in entries.items():
        findings[name] = Findings(unfit=[] if entry.protocol == PROTOCOL else ["no protocol's number was recorded"])
        if not entry.counted:
            findings[name].unfit.append(f"none of its episodes starts in the scenes of seeds 0 to {SEEDS - 1}")
        episodes = entry.episodes
        if most is not None:
            episodes, findings[name].differing = _playable(entry)
            count = min(most, math.ceil(SHARE * len(episodes)))
            episodes = random.Random(seed).sample(episodes, count)  # noqa: S311
        chosen += [(name, episode) for episode in episodes]
    watch(0, len(chosen))
    for done, (name, _, problem) in enumerate(replay(chosen, jobs=jobs), start=1):
        findings[name].add(problem)
        watch(done, len(chosen))
    return findings


def _playable(entry: Entry) -> tuple[list[EpisodeResult], list[str]]:
    """The episodes that count and whose replay would tell something; and a sentence for each that is wrong as it is."""
    horizons = {task: task_spec(task).horizon(entry.rules) for task in TASKS}
    playable, problems = [], []
    for episode in (*entry.counted, *entry.shifted):
        if problem := inconsistency(episode, horizons[episode.task]):
            problems.append(f"{episode.title}: {problem}")
        elif episode.failure is None:
            playable.append(episode)
    return playable, problems
