"""The figures of a leaderboard: each method's scores, decreases by variant, probabilities of improvement, and costs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np

from magical_mj.envs.presets import PRESETS
from magical_mj.evaluation.reports.floors import floors, new_place_floors, refuting_seeds
from magical_mj.evaluation.reports.intervals import Cell, Estimate, Floats, estimate
from magical_mj.evaluation.reports.results import PUBLISHED_RULES, published_results, published_table_1
from magical_mj.evaluation.scores import SCORE_TOLERANCE, EpisodeResult
from magical_mj.leaderboard.entry import GIVEN, SIMULATOR, SUFFIX, Card, Entry, Versions, entry_files, read_entry
from magical_mj.leaderboard.places import intents, places
from magical_mj.protocol import PROTOCOL
from magical_mj.shifts import SHIFTS
from magical_mj.shifts.shift import STRENGTHS
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, VARIANTS, Pair
from magical_mj.utils.errors import counted

Kind = Literal["official", "partial", "published"]
BLOCKS: Final[Mapping[str, str]] = {
    "pictures": "From images",
    "pictures and more": "From images, with more than the paper's setting in training",
    "states": "From states",
    "states and more": "From states, with more than the paper's setting in training",
    "simulator": "With a simulator at test",
    "given": "With demonstrations at test",
    "nothing": "Without looking",
    "undeclared": "Privileges not declared",
    "released": "By the rules of the paper's released code",
}
"""Methods are compared within a block: by the rules, what the policy observes, and what else the method may use."""
LEAST_RUNS: Final = 5
"""The least number of runs of an official entry: the paper's number."""
USUAL: Final = {"states", "simulator in training"}
"""The privileges of the paper's setting, apart from what the policy observes."""

GROUPS: Final[Mapping[str, tuple[str, ...]]] = {
    "Memory": ("Demo", "Jitter", "Dynamics"),
    "Distraction": ("Colour", "Shape"),
    "Generalisation": ("Layout", "CountPlus", "All"),
}
"""Variants whose scores rise and fall together, by what they test."""
COMMON: Final = tuple(task for task in TASKS if all((task, variant) in ENVIRONMENTS for variant in VARIANTS))
"""The tasks that have all variants. The means over a group are over these tasks, so that groups can be compared."""
ABOVE: Final = "Above the floor"
"""The generalisation group's mean of (score - f) / (1 - f), where f is the environment's floor: the best mean score of
doing nothing, random actions and replaying a demonstration. It orders methods."""
NEW_PLACES: Final = "New places"
"""The mean score in the scenes that refute the shortcut *same place*, over the environments that have some."""
COLUMNS: Final[Mapping[str, tuple[Pair, ...]]] = {
    NEW_PLACES: tuple(refuting_seeds()),
    **{
        name: tuple(pair for pair in ENVIRONMENTS if pair[0] in COMMON and pair[1] in GROUPS[group])
        for name, group in [(ABOVE, "Generalisation"), *zip(GROUPS, GROUPS, strict=True)]
    },
    **{variant: tuple(pair for pair in ENVIRONMENTS if pair[1] == variant) for variant in VARIANTS},
}
"""A score's name -> the environments that it averages."""


@dataclass(frozen=True)
class Standing:
    """One method on the leaderboard.

    Attributes:
        kind: official entries are complete, partial ones are not, and published ones are the paper's.
        entry: the entry; those of published methods have no episodes.
        gaps: the reasons why a partial entry is not official.
        means: mean score of each run in each environment; for published methods only the mean of five runs.
        episodes: environment -> run -> the scores of its episodes by seed, NaN for missing ones; empty for published
            methods.
        new_places: the same, of the scenes that refute the shortcut.
        rerun: how much higher the entry's policies scored in fresh scenes, by what was played; see
            `magical_mj.leaderboard.rerun`. Empty if they were not played.
        repeated: whether another entry repeats it, see `repetition`.
        printed: the means over tasks in the paper's text, by variant, which differ from those of `means` by rounding.
    """

    kind: Kind
    entry: Entry
    gaps: tuple[str, ...]
    means: Mapping[Pair, Floats]
    episodes: Mapping[Pair, Mapping[int, Floats]]
    new_places: Mapping[Pair, Mapping[int, Floats]] = field(default_factory=dict)
    rerun: Mapping[str, Estimate] = field(default_factory=dict)
    repeated: bool = False
    printed: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The method's name."""
        return self.entry.method

    @property
    def level(self) -> str:
        """How it was checked: "replayed", also "re-run", or "repeated"; empty for published methods."""
        if self.kind == "published":
            return ""
        return "repeated" if self.repeated else "re-run" if self.rerun else "replayed"

    @property
    def privileges(self) -> tuple[str, ...]:
        """The privileges that its card declares."""
        return tuple(self.entry.card.privileges or ())

    @property
    def sees_states(self) -> bool:
        """Whether its observations are state vectors."""
        preset = PRESETS.get(self.entry.observations or "")
        return preset is not None and preset.layout == "state"

    @property
    def block(self) -> str:
        """The block that lists it, a key of `BLOCKS`."""
        if self.entry.rules == PUBLISHED_RULES:
            return "released"
        if self.entry.card.privileges is None:
            return "undeclared"
        if SIMULATOR in self.privileges:
            return "simulator"
        if GIVEN in self.privileges:
            return "given"
        if self.entry.observations is None:
            return "nothing"
        more = bool({*self.privileges} - USUAL)
        if self.sees_states:
            return "states and more" if more else "states"
        return "pictures and more" if more or "states" in self.privileges else "pictures"

    @cached_property
    def scores(self) -> Mapping[str, Estimate]:
        """The mean over the environments of each of `COLUMNS` that were played, without columns that have none."""
        played = {name: pairs for name, pairs in COLUMNS.items() if any(pair in self.means for pair in pairs)}
        scores = {name: self.mean(pairs, above=name == ABOVE) for name, pairs in played.items()}
        scores |= {name: Estimate(value) for name, value in self.printed.items()}
        weights = dict.fromkeys(self.new_places, 1 / max(len(self.new_places), 1))
        return scores | {NEW_PLACES: estimate(_cells(self.new_places, weights))}

    def mean(self, pairs: Iterable[Pair], above: bool = False) -> Estimate:
        """The mean score over those of the environments that were played, with its interval.

        Args:
            pairs: the environments.
            above: whether to take the mean of (score - f) / (1 - f), where f is the floor.
        """
        played = [pair for pair in pairs if pair in self.means]
        lowest = [floors(self.entry.rules)[pair] if above else 0.0 for pair in played]
        scores = [self.means[pair].mean() for pair in played]
        value = round(float(np.mean([(x - f) / (1 - f) for x, f in zip(scores, lowest, strict=True)])), 9)
        if not played or not all(pair in self.episodes for pair in played):
            return Estimate(value)
        weights = [1 / (len(played) * (1 - f)) for f in lowest]
        found = estimate(self.cells(dict(zip(played, weights, strict=True))))
        shift = value - found.value
        return Estimate(value, found.low + shift, found.high + shift)

    def cells(self, weights: Mapping[Pair, float], side: str = "") -> list[Cell]:
        """The scores in some environments, each with the weight of its mean. `side` tells two methods apart."""
        return _cells(self.episodes, weights, side)

    def lacks(self, column: str) -> str:
        """How many of a column's environments were played, such as "(2/8)". Empty for all and for none."""
        count = sum(pair in self.means for pair in COLUMNS[column])
        return f"({count}/{len(COLUMNS[column])})" if 0 < count < len(COLUMNS[column]) else ""

    @property
    def rank(self) -> tuple[Any, ...]:
        """The order in a block: complete entries first, by generalisation above doing nothing."""
        score = self.scores.get(ABOVE)
        return not self.everywhere, -score.value if score else 0.0, self.name

    @cached_property
    def drops(self) -> Mapping[str, float]:
        """The decrease of the mean score from Demo to each test variant, on the tasks that have both."""
        means = {pair: scores.mean() for pair, scores in self.means.items()}
        drops = {}
        for variant in VARIANTS[1:]:
            tasks = [task for task in TASKS if (task, "Demo") in means and (task, variant) in means]
            if tasks:
                drops[variant] = float(np.mean([means[task, "Demo"] - means[task, variant] for task in tasks]))
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

        Strength 0 is Demo, in the same runs and scenes.
        """
        if not self.entry.shifted:
            return {}
        scores: dict[tuple[str, str], list[float]] = defaultdict(list)
        both = {(row.task, row.run, row.seed) for row in self.entry.shifted}
        demo = [row for row in self.entry.counted if row.variant == "Demo" and (row.task, row.run, row.seed) in both]
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


def _cells(episodes: Mapping[Pair, Mapping[int, Floats]], weights: Mapping[Pair, float], side: str = "") -> list[Cell]:
    return [
        Cell(np.stack([*episodes[pair].values()]), weight, (side, pair[0]), pair) for pair, weight in weights.items()
    ]


def standing(entry: Entry, rerun: Mapping[str, Estimate] = MappingProxyType({})) -> Standing:
    """The standing of an entry, with the result of its re-run, if its policies were played again."""
    episodes = _by_environment(entry.counted)
    refuting = refuting_seeds()
    new = (row for row in entry.counted if row.seed in refuting.get((row.task, row.variant), ()))
    means: dict[Pair, Floats] = {
        pair: np.array([float(np.nanmean(row)) for row in runs.values()]) for pair, runs in episodes.items()
    }
    missing = tuple(gaps(entry, was_rerun=bool(rerun)))
    kind: Kind = "partial" if missing else "official"
    return Standing(kind, entry, missing, means, episodes, _by_environment(new), rerun)


def _by_environment(rows: Iterable[EpisodeResult]) -> dict[Pair, dict[int, Floats]]:
    scores: dict[Pair, dict[int, dict[int, float]]] = defaultdict(lambda: defaultdict(dict))
    for row in rows:
        scores[row.task, row.variant][row.run][row.seed] = row.score
    return {pair: _by_run(scores[pair]) for pair in ENVIRONMENTS if pair in scores}


def _by_run(scores: Mapping[int, Mapping[int, float]]) -> dict[int, Floats]:
    seeds = sorted({seed for of_run in scores.values() for seed in of_run})
    return {run: np.array([scores[run].get(seed, np.nan) for seed in seeds]) for run in sorted(scores)}


def own_standings(folder: Path) -> dict[str, Standing]:
    """File name -> standing, for the entries in a folder. They are not replayed; `check_entries` does that."""
    return {path.name.removesuffix(SUFFIX): standing(read_entry(path)) for path in entry_files(folder)}


def gaps(entry: Entry, was_rerun: bool = False) -> list[str]:
    """The reasons why an entry is not official. Empty if it is. Official entries were re-run."""
    lacks = []
    if len(entry.runs) < LEAST_RUNS:
        lacks.append(f"{len(entry.runs)} of {counted(LEAST_RUNS, 'run')}")
    pairs = {(episode.task, episode.variant) for episode in entry.episodes}
    for needed, kind in ((ENVIRONMENTS, "environments"), (intents(), "environments of intents")):
        if not (played := pairs.intersection(needed)):
            continue
        if len(played) < len(needed):
            lacks.append(f"{len(played)} of {len(needed)} {kind}")
        wanted = sum(places()[pair] for pair in played) * len(entry.runs)
        elsewhere = " in the environments played" if len(played) < len(needed) else ""
        if absent := wanted - sum((episode.task, episode.variant) in played for episode in entry.counted):
            lacks.append(f"{absent} of {wanted} episodes missing{elsewhere}")
    if (number := entry.card.demonstrations.loaded_set) != 1:
        lacks.append(f"it learnt from demonstrations of set {number}, and protocol {PROTOCOL} uses set 1")
    if entry.card.privileges is None:
        lacks.append("its privileges are not declared")
    lacks += [f"its card lacks {name}" for name in ("authors", "commands") if not getattr(entry.card, name)]
    if not was_rerun:
        lacks.append("its policies were not re-run")
    return lacks


def published() -> list[Standing]:
    """The paper's results. Only the mean of each method in each environment is published.

    Its methods observe pictures. All except BC also play while they learn.
    """
    methods, table = [], published_table_1()
    for policy, group in published_results().groupby("policy", sort=False):
        means = {(row.task, row.variant): np.array([row.mean]) for row in group.itertuples()}
        card = Card(str(policy), privileges=[] if str(policy).startswith("BC") else ["simulator in training"])
        entry = Entry(card, "pictures", PUBLISHED_RULES, None, Versions([], [], []), [])
        printed = table[table["policy"] == policy].set_index("variant")["mean"].to_dict()
        methods.append(Standing("published", entry, (), means, {}, printed=printed))
    return methods


def improvement(first: Standing, second: Standing) -> float:
    """The probability that a run of the first method beats one of the second in an environment (Agarwal et al., 2021).

    It is averaged over the environments that both have played. Equal scores count one half. It is NaN if there are no
    such environments, or if they were scored by different rules.
    """
    pairs = [pair for pair in first.means if pair in second.means]
    if not pairs or first.entry.rules != second.entry.rules:
        return np.nan
    return float(np.mean([_better(first.means[pair], second.means[pair]) for pair in pairs]))


def difference(first: Standing, second: Standing, pairs: Iterable[Pair] = ENVIRONMENTS) -> Estimate:
    """How much higher the first method's mean score is, over those of the environments that both have played."""
    common = [pair for pair in pairs if pair in first.episodes and pair in second.episodes]
    weight = 1 / max(len(common), 1)
    weights = dict.fromkeys(common, weight), dict.fromkeys(common, -weight)
    return estimate([*first.cells(weights[0], "first"), *second.cells(weights[1], "second")])


def repetition(method: Standing, other: Standing) -> Estimate | None:
    """How much higher a method's mean score is in an entry whose authors trained it again, over its environments.

    None if the other entry does not repeat it: its card must name the method, and other authors. Observations, rules
    and privileges must be the same, and all environments must be played, with as many runs and episodes. The
    repetition succeeded if the interval contains 0. With one scene in an environment, the interval is unknown (NaN).
    """
    card, own = other.entry.card, method.entry.card
    fits = (
        card.repeats == method.name
        and card.authors not in (None, own.authors)
        and (other.entry.observations, other.entry.rules) == (method.entry.observations, method.entry.rules)
        and {*other.privileges} == {*method.privileges}
        and all(_as_many(other.episodes.get(pair, {}), runs) for pair, runs in method.episodes.items())
    )
    return difference(other, method, method.episodes) if fits else None


def _as_many(runs: Mapping[int, Floats], other: Mapping[int, Floats]) -> bool:
    """Whether an environment was played in as many runs as another time, and in as many episodes."""
    played, needed = (sum(int(np.isfinite(scores).sum()) for scores in each.values()) for each in (runs, other))
    return len(runs) >= len(other) and played >= needed


def _better(first: Floats, second: Floats) -> Any:
    """The share of pairs whose first score is larger; ties count half. Shapes (..., n) and (..., m) -> (...)."""
    difference = first[..., :, None] - second[..., None, :]
    return ((difference > SCORE_TOLERANCE) + 0.5 * (np.abs(difference) <= SCORE_TOLERANCE)).mean(axis=(-1, -2))


def floor(column: str) -> float:
    """The mean floor over the environments of a column, by the paper's rules; 0 for `ABOVE`."""
    known = new_place_floors() if column == NEW_PLACES else floors()
    return 0.0 if column == ABOVE else float(np.mean([known[pair] for pair in COLUMNS[column]]))


def standings(
    entries: Mapping[str, Entry], reruns: Mapping[str, Mapping[str, Estimate]] = MappingProxyType({})
) -> list[Standing]:
    """All methods, by block and by `Standing.rank`. Entries and their re-runs are given by name."""
    blocks = tuple(BLOCKS)
    own = [standing(entry, reruns.get(name, {})) for name, entry in entries.items()]
    found = [(method.name, repetition(method, other)) for method in own for other in own]
    repeated = {name for name, one in found if one is not None and one.low <= 0 <= one.high}  # not if they are NaN
    own = [replace(method, repeated=method.name in repeated) for method in own]
    return sorted([*own, *published()], key=lambda method: (blocks.index(method.block), *method.rank))
