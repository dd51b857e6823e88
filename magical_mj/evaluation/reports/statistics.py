"""Means, spreads and interquartile means of scores, by environment, variant and shift, and their differences.

The unit of the paper's statistics is the run mean: the mean score of one run (one trained policy) in one environment.
A method's score is the mean over environments of the mean over runs; environments have equal weight. Its interval
covers scenes and training (`intervals`). A spread is the standard deviation of run means (ddof = 0): within an
environment over runs, and within a variant over tasks and runs.

The interquartile mean leaves out the lowest and the highest quarter of the run means of all tasks (Agarwal et al.,
NeurIPS 2021). It needs at least `LEAST_RUNS` runs of each task.

Shifts are compared with strength 0, the control: the same policies in the same scenes without the shift.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from magical_mj.evaluation.reports.intervals import Cell, Floats, estimate, mean_over
from magical_mj.evaluation.scores import SCORE_TOLERANCE
from magical_mj.shifts import SHIFTS
from magical_mj.shifts.registry import axis_and_strength
from magical_mj.shifts.shift import STRENGTHS
from magical_mj.utils.errors import EvaluationError

if TYPE_CHECKING:
    import pandas as pd

LEAST_RUNS: Final = 5
"""The least number of runs of an interquartile mean."""

MOST_CELLS: Final = 2_000_000
"""The largest number of pairs of a run and a scene in an environment: few episodes may have as many as its square."""


class Summary(NamedTuple):
    """The mean with its interval, the spread and the interquartile mean. NaN where there are too few runs."""

    mean: float
    std: float
    low: float
    high: float
    iqm: float


def interquartile_mean(values: Floats) -> float:
    """The mean without the lowest and the highest quarter of the values (each rounded down to whole values)."""
    from scipy.stats import trim_mean

    return float(trim_mean(values, 0.25))


def summarise(environments: Sequence[Floats]) -> Summary:
    """The statistics over environments of different tasks. `environments[i]` are scores of shape (runs, scenes)."""
    means = [np.nanmean(scores, axis=1) for scores in environments]
    mean, low, high = mean_over((task, task, scores) for task, scores in enumerate(environments))
    variance = np.mean([np.square(values - mean).mean() for values in means])
    std = float(np.sqrt(variance)) if sum(map(len, means)) > 1 else np.nan
    counts = {*map(len, means)}
    iqm = interquartile_mean(np.concatenate(means)) if len(counts) == 1 and min(counts) >= LEAST_RUNS else np.nan
    return Summary(mean, std, low, high, iqm)


def by_run_and_scene(scores: pd.DataFrame) -> Floats:
    """The scores of an environment, shape (runs, scenes), from a row for each episode. NaN for missing episodes.

    Raises an `EvaluationError` if there are more than `MOST_CELLS`.
    """
    runs, scenes = scores["run"].nunique(), scores["seed"].nunique()
    if runs * scenes > MOST_CELLS:
        raise EvaluationError(
            f"{runs:,} runs in {scenes:,} scenes of an environment are too many to compare: at most "
            f"{MOST_CELLS:,} pairs of a run and a scene"
        )
    return scores.pivot(index="run", columns="seed", values="score").to_numpy(float)


def difference(first: pd.DataFrame, second: pd.DataFrame, same_runs: bool) -> dict[str, Any]:
    """Compares the mean scores of two policies, or of one with and without a shift, in the scenes that both played.

    Args:
        first: a row for each episode.
        second: the same for the other policy. Both have an episode of each scene.
        same_runs: whether a run is the same trained policy in both.

    Returns:
        The mean of each, the `difference` of the first from the second and its 95 % interval (`low`, `high`), the
        smaller number of `runs`, and the numbers of `scenes` and `environments`, which have equal weight.
    """
    where = ["task", "variant"]
    sides = [dict(list(side.groupby(where, observed=True))) for side in (first, second)]
    cells = [
        Cell(by_run_and_scene(group), sign / len(sides[0]), (pair[0], same_runs or sign), pair)
        for sign, groups in zip((1, -1), sides, strict=True)
        for pair, group in groups.items()
    ]
    value, low, high = estimate(cells)
    means = [
        float(np.mean([np.nanmean(np.nanmean(cell.scores, axis=1)) for cell in cells if cell.weight * sign > 0]))
        for sign in (1, -1)
    ]
    counts = {
        "runs": min(len(cell.scores) for cell in cells),
        "scenes": sum(cell.scores.shape[1] for cell in cells) // 2,
    }
    return {
        "first": means[0],
        "second": means[1],
        "difference": value,
        "low": low,
        "high": high,
        **counts,
        "environments": len(sides[0]),
    }


def rank_correlation(first: Mapping[Any, Any], second: Mapping[Any, Any]) -> float:
    """Spearman's rank correlation of two methods' mean scores, over the environments that both have.

    Args:
        first: environment -> a mean score, or the mean scores of several runs.
        second: the scores of the other method, in the same form.

    Returns:
        A number in [-1, 1]. NaN if one of the methods has the same score everywhere, or if there are fewer than two
        common environments.
    """
    from scipy.stats import spearmanr

    pairs = [(np.mean(first[key]), np.mean(second[key])) for key in first if key in second]
    means = np.round(pairs, 9)  # means of the same scores in another order must be equal
    if len(means) < 2 or (np.ptp(means, axis=0) == 0).any():
        return float("nan")
    return float(spearmanr(means[:, 0], means[:, 1]).statistic)


def by_environment(scores: pd.DataFrame) -> pd.DataFrame:
    """The statistics over runs, a row for each policy and environment. `scores` has a row per episode."""
    return _by(["policy", "task", "variant"], scores).drop(columns="tasks")


def by_variant(scores: pd.DataFrame) -> pd.DataFrame:
    """The statistics over the played tasks, a row for each policy and variant."""
    return _by(["policy", "variant"], scores).drop(columns="failures")


def _by(keys: list[str], scores: pd.DataFrame) -> pd.DataFrame:
    """A row for each value of the keys, in their order."""
    import pandas as pd

    rows = []
    for values, group in scores.groupby(keys, sort=False, observed=True):
        tasks = [by_run_and_scene(task) for _, task in group.groupby("task", observed=True)]
        counts = {"tasks": len(tasks), "runs": max(map(len, tasks)), "episodes": len(group)}
        failures = int(group["failure"].notna().sum())
        rows.append(
            {**dict(zip(keys, values, strict=True)), **summarise(tasks)._asdict(), **counts, "failures": failures}
        )
    return pd.DataFrame(rows)


def by_shift(scores: pd.DataFrame) -> pd.DataFrame:
    """The scores of each policy under each shift and without it in the same scenes.

    Args:
        scores: a row for each episode; see `magical_mj.evaluation.reports.results.gather`.

    Returns:
        A row for each policy and shift: the `axis` and its `strength` (NaN for combined shifts and for bodies), the
        mean score with the shift (`mean`) and without it (`without`), the other columns of `difference`, and whether
        all strengths of the axis were played in the same scenes (`same_scenes`).
    """
    import pandas as pd

    played = scores.astype(dict.fromkeys(["policy", "task", "variant", "shift"], str))
    episode = ["policy", "run", "task", "variant", "seed"]
    without = played[played["shift"] == ""]
    rows: list[dict[str, Any]] = []
    scenes = defaultdict[tuple[str, str], set[int]](set)
    for (policy, shift), group in played[played["shift"] != ""].groupby(["policy", "shift"]):
        both = group[episode].merge(without[episode])
        if both.empty:
            continue
        axis, strength = axis_and_strength(str(shift)) or (str(shift), math.nan)
        scenes[str(policy), axis].add(hash(frozenset(both.itertuples(index=False, name=None))))
        compared = difference(group.merge(both), without.merge(both), same_runs=True)
        rows.append(
            {
                "policy": policy,
                "shift": shift,
                "axis": axis,
                "strength": strength,
                "without": compared.pop("second"),
                "mean": compared.pop("first"),
                **compared,
            }
        )
    for row in rows:
        row["same_scenes"] = len(scenes[row["policy"], row["axis"]]) == 1
    order = list(SHIFTS)
    rows.sort(key=lambda row: order.index(row["axis"]) if row["axis"] in order else len(order))
    return pd.DataFrame(rows)


def curve(rows: pd.DataFrame) -> dict[int, float]:
    """The mean score at each played strength, from the rows of one policy and axis.

    Strength 0, without the shift, is left out if strengths were played in different scenes.
    """
    points = {int(row.strength): float(row.mean) for row in rows.itertuples()}
    start = {0: float(rows["without"].iloc[0])} if rows["same_scenes"].all() else {}
    return {**start, **dict(sorted(points.items()))}


def area(points: dict[int, float]) -> float:
    """The area under a curve over strengths 0 to 5, divided by 5: a mean score. NaN if a strength is missing."""
    if set(points) != set(range(STRENGTHS + 1)):
        return math.nan
    return (sum(points.values()) - (points[0] + points[STRENGTHS]) / 2) / STRENGTHS


def half_lost(points: dict[int, float]) -> int | None:
    """The first strength with at most half of the score at strength 0. None if there is none, or no strength 0."""
    if 0 not in points:
        return None
    lost = [strength for strength, score in points.items() if strength and score <= points[0] / 2 + SCORE_TOLERANCE]
    return min(lost) if lost and points[0] > SCORE_TOLERANCE else None
