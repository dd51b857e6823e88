"""Checks of evaluations' folders and entries: their episodes are replayed from their seeds and actions."""

from __future__ import annotations

import math
import random
import secrets
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path
from typing import Any, Final

from magical_mj.evaluation.folder import SETTINGS, recorded_policies, recorded_settings
from magical_mj.evaluation.replay import Recorded, inconsistency, obstacle, replay
from magical_mj.evaluation.scores import EpisodeResult, Key, read
from magical_mj.leaderboard.entry import Entry, is_entry, read_entry
from magical_mj.leaderboard.places import intents, places
from magical_mj.protocol import DEMONSTRATIONS, PROTOCOL, SEEDS, SOLVED
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, Pair, task_spec
from magical_mj.utils.errors import EvaluationError, SettingsError, counted, short_repr
from magical_mj.utils.files import to_path
from magical_mj.variants import check_seed

SHARE: Final = 0.1
"""The share of an entry's episodes that are replayed by default."""
MOST_REPLAYED: Final = 500
"""The largest number of an entry's episodes that are replayed by default, so that a large folder takes minutes. If
one episode in a hundred is false, such a sample misses all of them once in 150 times. The next check draws others."""
MOST_SENTENCES: Final = 1_000
"""The largest number of sentences about missing episodes: a small file may list very many runs."""

COMPARED: Final = ("score", "actions", "failure", "rules")
"""The fields that must be the same in all records of an episode."""


@dataclass
class Findings:
    """The result of a check.

    Attributes:
        episodes: the number of replayed episodes.
        differing: a sentence for each episode that differs from its record.
        missing: a sentence for each run and environment with missing episodes; the last one counts those beyond
            `MOST_SENTENCES`.
        unfit: sentences about all other deviations from this version's protocol.
        solved: the environment and the seed of scenes that start with score 1. This is not an error.
    """

    episodes: int = 0
    differing: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    unfit: list[str] = field(default_factory=list)
    solved: list[str] = field(default_factory=list)

    @property
    def good(self) -> bool:
        """Whether no problems were found."""
        return not (self.differing or self.missing or self.unfit)

    def add(self, problem: str | None) -> None:
        """Counts a replayed episode. `problem` is its deviation from the record, None if there is none."""
        self.episodes += 1
        if problem is not None:
            self.differing.append(problem)


def verify(
    *folders: Path | str,
    jobs: int | None = None,
    watch: Callable[[int, int], object] = lambda *_: None,
    trusted: Collection[str] = (),
) -> Findings:
    """Replays the episodes of an evaluation, and checks its settings and completeness against the protocol.

    Failed episodes, and those outside the benchmark and the test sets of intents, are not replayed. The settings
    determine which episodes are required, so that environments or runs without any episodes are reported. An evaluation
    may be split over several folders, for example one for each task. Together they must be complete, and episodes in
    several folders must agree.

    Args:
        folders: the folders of the evaluation, or entries of the leaderboard.
        jobs: the number of processes; None: one per core.
        watch: called with the number of replayed episodes, and the total.
        trusted: references such as "mine:BODY" that episodes may contain; see docs/trust.md.

    Raises:
        UntrustedNameError: if an episode names another body or shift by reference.
        SettingsError: if no folder is given.
        EvaluationError: if a folder is neither an evaluation nor an entry.
    """
    if not folders:
        raise SettingsError("give at least one folder of an evaluation, or an entry")
    findings, stored = Findings(), [_stored(to_path(folder)) for folder in folders]
    chosen: list[Recorded] = []
    seen: dict[Key, tuple[EpisodeResult, Path]] = {}
    for part in stored:
        where = f"{part.path}: " if len(stored) > 1 else ""
        findings.unfit += [f"{where}{problem}" for problem in _unfit(part, trusted)]
        for episode in part.episodes:
            other, holder = seen.setdefault(episode.key, (episode, part.path))
            if holder == part.path:
                if _known(episode) and obstacle(episode, part.settings, trusted) is None:
                    chosen.append((where, episode))
            elif any(getattr(other, name) != getattr(episode, name) for name in COMPARED):
                problem = f"{holder} and {part.path} contain it with different results"
                findings.differing.append(f"{episode.policy}, {episode.title}: {problem}")
    findings.missing += _missing(stored)
    scenes = sorted({(episode.task, episode.variant, episode.seed) for episode, _ in seen.values()} & SOLVED)
    findings.solved += [f"{task} {variant}, seed {number}" for task, variant, number in scenes]
    watch(0, len(chosen))
    for done, (where, _, problem) in enumerate(replay(chosen, jobs=jobs, trusted=trusted), start=1):
        findings.add(None if problem is None else f"{where}{problem}")
        watch(done, len(chosen))
    return findings


@dataclass(frozen=True)
class _Stored:
    """The settings and episodes of an evaluation's folder, or of an entry, whose settings are partly unknown."""

    path: Path
    settings: Mapping[str, Any]
    episodes: Sequence[EpisodeResult]
    entry: Entry | None = None

    @property
    def environments(self) -> set[Pair]:
        """The environments of entries that the evaluation includes."""
        names = set(map(str, self.settings.get("environments", ())))
        return {pair for pair in places() if "-".join(pair) in names}

    @property
    def runs(self) -> dict[str, set[int]]:
        """The runs of each policy that the evaluation includes."""
        runs: dict[str, set[int]] = defaultdict(set)
        for policy in recorded_policies(self.settings):
            runs[policy.name].add(policy.run)
        return runs


def _stored(path: Path) -> _Stored:
    if is_entry(path):
        entry = read_entry(path)
        return _Stored(path, {"protocol": entry.protocol}, entry.episodes, entry)
    episodes, settings = read(path), dict[str, Any]()
    with suppress(EvaluationError):  # invalid settings count as none
        settings = recorded_settings(path)
    return _Stored(path, settings, episodes)


def _unfit(part: _Stored, trusted: Collection[str]) -> list[str]:
    """The deviations of one folder from the protocol that are visible without replaying."""
    settings, episodes, problems = part.settings, part.episodes, []
    obstacles = Counter(filter(None, (obstacle(row, settings, trusted) for row in episodes if _known(row))))
    problems += [f"{counted(count, 'episode')} cannot be replayed: {why}" for why, count in obstacles.items()]
    if others := {episode.split for episode in episodes} - {"test"}:
        problems.append(f"split: results must be from test, but it was played on {', '.join(sorted(others))}")
    if part.entry is not None:
        return problems + _unfit_entry(part.entry)
    required = {"demonstrations": {DEMONSTRATIONS}, "rules": {row.rules for row in episodes}}
    if settings.get("protocol") is None:  # another number is an obstacle
        required["protocol"] = {PROTOCOL}
    for name, values in required.items():
        recorded = f"{settings[name]!r} is recorded" if name in settings else "nothing is recorded"
        others = sorted(value for value in values if value != settings.get(name))
        problems += [f"{name}: {recorded}, but it must be {value!r}" for value in others]
    sets = dict.fromkeys((policy.name, policy.demonstration_set) for policy in recorded_policies(settings))
    problems += [
        f"{name} learnt from demonstrations of set {number}, but the protocol uses set 1"
        for name, number in sets
        if number != 1
    ]
    problems += _contradictions(part)
    outside = Counter(episode.policy for episode in episodes if not _known(episode))
    return problems + [
        f"{policy}: environments outside the benchmark and the test sets of intents in {counted(count, 'episode')}"
        for policy, count in outside.items()
    ]


def _known(episode: EpisodeResult) -> bool:
    """Whether an episode is of the benchmark's tasks, or of the test sets of intents."""
    return episode.task in TASKS or (episode.task, episode.variant) in places()


def _unfit_entry(entry: Entry) -> list[str]:
    """What an entry lacks to be checked against the protocol."""
    problems = [] if entry.protocol == PROTOCOL else ["the protocol's number is not recorded"]
    return problems + ([f"it {entry.undeclared}"] if entry.undeclared else [])


def _missing(stored: Sequence[_Stored]) -> list[str]:
    """A sentence for each run and environment that lacks episodes which the protocol requires, in all parts together.

    After `MOST_SENTENCES`, another one counts the others.

    Each run must have played all environments of the tasks. The settings may include runs without any episodes.
    """
    seeds: dict[tuple[str, int, str, str], set[int]] = defaultdict(set)
    runs: dict[str, set[int]] = defaultdict(set)
    tasks = {task for part in stored for task, _ in part.environments}
    for policy, numbers in chain.from_iterable(part.runs.items() for part in stored):
        runs[policy] |= numbers
    for episode in chain.from_iterable(part.episodes for part in stored):
        tasks.add(episode.task)
        if not episode.shift:
            runs[episode.policy].add(episode.run)
            seeds[episode.policy, episode.run, episode.task, episode.variant].add(episode.seed)
    required = {pair: set(range(places()[pair])) for pair in (*ENVIRONMENTS, *intents()) if pair[0] in tasks}
    complete = {key for key, played in seeds.items() if key[2:] in required and required[key[2:]] <= played}
    wanted = ((policy, run, *pair) for policy in runs for run in sorted(runs[policy]) for pair in required)
    gaps = (place for place in wanted if place not in complete)
    problems: list[str] = []
    for policy, run, task, variant in islice(gaps, MOST_SENTENCES):
        needed = required[task, variant]
        absent = needed - seeds[policy, run, task, variant]
        which = "all" if absent == needed else f"{len(absent)}, such as seed {min(absent)},"
        problems.append(f"{policy}, run {run}, {task} {variant}: {which} of the {len(needed)} episodes are missing")
    others = sum(map(len, runs.values())) * len(required) - len(complete) - len(problems)
    return problems + ([f"{others} other environments of its runs"] if others else [])


def _contradictions(part: _Stored) -> list[str]:
    """A sentence for each contradiction between episodes and the settings, or their own actions."""
    settings, environments, runs = part.settings, part.environments, part.runs
    problems: dict[str, list[str]] = defaultdict(list)
    for episode in part.episodes:
        pair, count = (episode.task, episode.variant), len(episode.actions)
        texts = {}
        for name in ("preset", "version", "mujoco"):  # not the OpenGL backend, which each worker of a cluster chooses
            value, expected = getattr(episode, name), settings.get(name)
            if value not in (expected, None):  # None: a policy without observations has no preset
                texts[name] = f"it was played with {value!r}, but {SETTINGS} contains {short_repr(expected)}"
        if episode.run not in runs.get(episode.policy, ()):
            texts["run"] = f"{SETTINGS} does not include it"
        if pair in places() and pair not in environments:
            texts["environment"] = f"{SETTINGS} does not include it"
        if episode.steps != count:
            texts["steps"] = f"{episode.steps} are recorded, but it has {count} actions"
        for name, text in texts.items():
            problems[name].append(f"{episode.policy}, {episode.title}: {text}")
    return [
        f"{name}: {first}" + (f"; and {len(others)} more" if others else "")
        for name, (first, *others) in problems.items()
    ]


def check_entries(
    entries: Mapping[str, Entry],
    *,
    most: int | None = MOST_REPLAYED,
    seed: int | None = None,
    jobs: int | None = None,
    watch: Callable[[int, int], object] = lambda *_: None,
) -> dict[str, Findings]:
    """Replays a random sample of the episodes of each entry that count.

    All of these episodes are checked without replaying: their length, and that failures have the score 0. The sample
    does not depend on the file. Otherwise its author could alter it until the sample is favourable.

    Args:
        entries: name -> entry; the names appear in the problems.
        most: the largest number of episodes of an entry that are replayed, otherwise a tenth of them. None: all.
        seed: determines the sample, so that a check can be repeated. None: an unpredictable sample.
        jobs: the number of processes; None: one per core.
        watch: called with the number of replayed episodes, and the total.

    Returns:
        The findings by the entries' names.

    Raises:
        InvalidSeedError: if `seed` is not an integer, or negative.
    """
    seed = secrets.randbits(64) if seed is None else check_seed(seed)
    findings: dict[str, Findings] = {}
    chosen: list[Recorded] = []
    for name, entry in entries.items():
        findings[name] = Findings(unfit=_unfit_entry(entry))
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
    """The counting episodes that are worth replaying, and a sentence for each one that is wrong without replaying."""
    horizons = {task: task_spec(task).horizon(entry.rules) for task in {row.task for row in entry.episodes}}
    playable, problems = [], []
    for episode in (*entry.counted, *entry.shifted):
        if problem := inconsistency(episode, horizons[episode.task]):
            problems.append(f"{episode.title}: {problem}")
        elif episode.failure is None:
            playable.append(episode)
    return playable, problems
