"""The figures of a leaderboard: each method's scores, decreases by variant, probabilities of improvement, and costs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from magical_mj.evaluation.entry import SEEDS, SHIFT_SEEDS, SUFFIX, Card, Entry, Versions, entry_files, read_entry
from magical_mj.evaluation.reports.results import PUBLISHED_RULES, published_results
from magical_mj.evaluation.reports.statistics import (
    Floats,
    bootstrap,
    interquartile_mean,
    mean_interval,
    robust_mean,
)
from magical_mj.evaluation.scores import SCORE_TOLERANCE
from magical_mj.shifts import SHIFTS
from magical_mj.shifts.shift import STRENGTHS
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, VARIANTS, Pair
from magical_mj.utils.errors import counted

Kind = Literal["official", "partial", "published"]
Block = Literal["pictures", "states", "simulator", "nothing", "undeclared"]
BLOCKS: Final[Mapping[Block, str]] = {
    "pictures": "From pictures",
    "states": "From states",
    "simulator": "With a simulator at test",
    "nothing": "Without looking",
    "undeclared": "Privileges not declared",
}
"""Methods are compared within a block: what a policy may use at test time matters more than how it was trained."""

LEAST_RUNS: Final = 5
"""The least number of runs of an official entry: the paper's number."""
OVERALL: Final = "all environments"


@dataclass(frozen=True)
class Estimate:
    """A figure with its 95 % interval; NaN for missing values."""

    value: float
    low: float = np.nan
    high: float = np.nan


@dataclass(frozen=True)
class Standing:
    """One method on the leaderboard.

    Attributes:
        kind: official entries are complete, partial ones are not, and published ones are the paper's.
        entry: the entry; those of published methods have no episodes.
        gaps: the reasons why a partial entry is not official.
        means: mean score of each run in each environment; for published methods only the mean of five runs.
        episodes: score of each episode of each run in each environment; empty for published methods.
    """

    kind: Kind
    entry: Entry
    gaps: tuple[str, ...]
    means: Mapping[Pair, Floats]
    episodes: Mapping[Pair, Mapping[int, Floats]]

    @property
    def name(self) -> str:
        """The method's name."""
        return self.entry.method

    @property
    def privileges(self) -> tuple[str, ...]:
        """The privileges that its card declares."""
        return tuple(self.entry.card.privileges or ())

    @property
    def block(self) -> Block:
        """Its block in the tables."""
        if self.entry.card.privileges is None:
            return "undeclared"
        if "simulator at test" in self.privileges:
            return "simulator"
        looks_at = self.entry.observations
        return "nothing" if looks_at is None else "states" if looks_at == "State" else "pictures"

    @cached_property
    def scores(self) -> Mapping[str, Estimate]:
        """The interquartile mean over environments and runs, by variant and `OVERALL`."""
        scores = {}
        for variant in (OVERALL, *VARIANTS):
            pairs = [pair for pair in self.means if variant in (OVERALL, pair[1])]
            if pairs and self.episodes:
                scores[variant] = Estimate(*robust_mean([list(self.episodes[pair].values()) for pair in pairs]))
            elif pairs:
                values = np.concatenate([self.means[pair] for pair in pairs])
                scores[variant] = Estimate(float(interquartile_mean(values)))
        return scores

    @cached_property
    def drops(self) -> Mapping[str, Estimate]:
        """The decrease of the mean score from Demo to each test variant, on the tasks that have both.

        There is an interval only if the same runs were played in both, since they are resampled together.
        """
        drops = {}
        for variant in VARIANTS[1:]:
            both = [((task, "Demo"), (task, variant)) for task in TASKS]
            both = [pair for pair in both if self.means.keys() >= set(pair)]
            if both:
                value = float(np.mean([self.means[demo].mean() - self.means[other].mean() for demo, other in both]))
                runs = [[list(self.episodes.get(pair, ())) for pair in pairs] for pairs in both]
                if all(ours == others != [] for ours, others in runs):
                    interval = mean_interval([self.means[demo] - self.means[other] for demo, other in both])
                    drops[variant] = Estimate(value, *interval)
                else:
                    drops[variant] = Estimate(value)
        return drops

    @property
    def everywhere(self) -> bool:
        """Whether it has results in all environments."""
        return len(self.means) == len(ENVIRONMENTS)

    @property
    def weakest(self) -> str | None:
        """The variant (except All) with the largest decrease, over the tasks that were played in all variants."""
        axes = [variant for variant in VARIANTS if variant != "All"]
        tasks = [task for task in TASKS if all((task, axis) in self.means for axis in axes)]
        totals = {axis: sum(self.means[task, axis].mean() for task in tasks) for axis in axes}
        lowest = min(axes, key=lambda axis: totals[axis])
        return lowest if totals[lowest] < totals["Demo"] - SCORE_TOLERANCE else None

    @cached_property
    def curves(self) -> Mapping[str, tuple[int, dict[int, float]]]:
        """Shift -> the number of tasks that were played in all strengths, and the mean score by strength over them.

        Strength 0 is Demo, in the same scenes.
        """
        if not self.entry.shifted:
            return {}
        scores: dict[tuple[str, str], list[float]] = defaultdict(list)
        demo = [row for row in self.entry.counted if row.variant == "Demo" and row.seed < SHIFT_SEEDS]
        for row in (*demo, *self.entry.shifted):
            scores[row.task, row.shift].append(row.score)
        curves = {}
        for axis in SHIFTS:
            labels = ["", *(f"{axis}:{strength}" for strength in range(1, STRENGTHS + 1))]
            tasks = [task for task in TASKS if all((task, label) in scores for label in labels)]
            if tasks:
                means = {label: float(np.mean([np.mean(scores[task, label]) for task in tasks])) for label in labels}
                curves[axis] = len(tasks), dict(enumerate(means.values()))
        return curves


def standing(entry: Entry) -> Standing:
    """The standing of an entry."""
    scores: dict[Pair, dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for episode in entry.counted:
        scores[episode.task, episode.variant][episode.run].append(episode.score)
    episodes = {
        pair: {run: np.array(scores[pair][run]) for run in sorted(scores[pair])}
        for pair in ENVIRONMENTS
        if pair in scores
    }
    means = {pair: np.array([values.mean() for values in runs.values()]) for pair, runs in episodes.items()}
    missing = tuple(gaps(entry))
    return Standing("partial" if missing else "official", entry, missing, means, episodes)


def own_standings(folder: Path) -> dict[str, Standing]:
    """File name -> standing, for the entries in a folder. They are not replayed; `check_entries` does that."""
    return {path.name.removesuffix(SUFFIX): standing(read_entry(path)) for path in entry_files(folder)}


def gaps(entry: Entry) -> list[str]:
    """The reasons why an entry is not official. Empty if it is."""
    lacks = []
    if len(entry.runs) < LEAST_RUNS:
        lacks.append(f"{len(entry.runs)} of {counted(LEAST_RUNS, 'run')}")
    pairs = {(episode.task, episode.variant) for episode in entry.episodes}
    if len(pairs) < len(ENVIRONMENTS):
        lacks.append(f"{len(pairs)} of {counted(len(ENVIRONMENTS), 'environment')}")
    wanted = len(pairs) * SEEDS * len(entry.runs)
    elsewhere = " in the environments played" if len(pairs) < len(ENVIRONMENTS) else ""
    if absent := wanted - len(entry.counted):
        lacks.append(f"{absent} of {wanted} episodes missing{elsewhere}")
    if entry.card.privileges is None:
        lacks.append("its privileges are not declared")
    return lacks


def published() -> list[Standing]:
    """The paper's results. Only the mean of each method in each environment is published.

    Its methods observe pictures. All except BC also play while they learn.
    """
    methods = []
    for policy, group in published_results().groupby("policy", sort=False):
        means = {(row.task, row.variant): np.array([row.mean]) for row in group.itertuples()}
        card = Card(str(policy), privileges=[] if str(policy).startswith("BC") else ["simulator in training"])
        entry = Entry(card, "pictures", PUBLISHED_RULES, None, Versions([], [], []), [])
        methods.append(Standing("published", entry, (), means, {}))
    return methods


def improvement(first: Standing, second: Standing) -> Estimate:
    """The probability that a run of the first method beats one of the second in an environment (Agarwal et al., 2021).

    It is averaged over the environments that both have played. Equal scores count one half. It is NaN if there are no
    such environments, or if they were scored by different rules.
    """
    pairs = [pair for pair in first.means if pair in second.means]
    if not pairs or first.entry.rules != second.entry.rules:
        return Estimate(np.nan)
    strata = [values for pair in pairs for values in (first.means[pair], second.means[pair])]

    def chance(*drawn: Floats, axis: int = -1) -> Any:
        del axis  # always the last
        return np.mean([_better(x, y) for x, y in zip(drawn[::2], drawn[1::2], strict=True)], axis=0)

    return Estimate(float(chance(*strata)), *bootstrap(strata, chance, resamples=500))


def _better(first: Floats, second: Floats) -> Any:
    """The share of pairs in which the first is larger than the second. Shapes (..., n) and (..., m) -> (...)."""
    difference = first[..., :, None] - second[..., None, :]
    return ((difference > SCORE_TOLERANCE) + 0.5 * (np.abs(difference) <= SCORE_TOLERANCE)).mean(axis=(-1, -2))


def standings(entries: Sequence[Entry]) -> list[Standing]:
    """All methods, by block, by kind (official, partial, published), and by overall score.

    Partial ones that played all environments come before the others, whose scores are not comparable.
    """
    kinds, blocks = ("official", "partial", "published"), tuple(BLOCKS)
    return sorted(
        [*map(standing, entries), *published()],
        key=lambda method: (
            blocks.index(method.block),
            kinds.index(method.kind),
            not method.everywhere,
            -method.scores[OVERALL].value,
            method.name,
        ),
    )
