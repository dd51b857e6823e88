"""Means, spreads, interquartile means and confidence intervals of scores.

The unit of the paper's statistics is the run mean: the mean score of one run (one trained policy) in one environment.
A method's score is the mean over environments of the mean over runs; environments have equal weight. Its 95 % interval
resamples runs and scenes (`resample`). With one run, it resamples scenes only, and does not cover the randomness of
training. A spread is the standard deviation of run means (ddof = 0): within an environment over runs, and within a
variant over tasks and runs.

The interquartile mean leaves out the lowest and the highest quarter of the run means, or of the task means if some
tasks have more runs than others. Its interval resamples the runs of each task (Agarwal et al., NeurIPS 2021), or the
episodes of a task that has only one run.

Shifts are compared with strength 0, the control: the same policies in the same scenes without the shift.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical_mj.evaluation.scores import SCORE_TOLERANCE
from magical_mj.shifts import SHIFTS
from magical_mj.shifts.shift import STRENGTHS

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]

RESAMPLES: Final = 2000
CONFIDENCE: Final = 0.95
AT_ONCE: Final = 50_000_000
"""The largest number of resampled values in memory at a time. Each takes 16 bytes."""


class Summary(NamedTuple):
    """The mean and the interquartile mean of run means with their intervals. NaN where there are too few runs."""

    mean: float
    std: float
    low: float
    high: float
    iqm: float
    iqm_low: float
    iqm_high: float


def interquartile_mean(values: Floats, axis: int = -1) -> Any:
    """The mean without the lowest and the highest quarter of the values (each rounded down to whole values)."""
    from scipy.stats import trim_mean

    return trim_mean(values, 0.25, axis=axis)


def summarise(tasks: Sequence[Sequence[Floats]]) -> Summary:
    """The statistics over tasks, which have equal weight. `tasks[i][j]` are the episode scores of run j in task i."""
    means = [np.array([scores.mean() for scores in runs]) for runs in tasks]
    mean = float(_mean_of_means(*means))
    variance = np.mean([np.square(values - mean).mean() for values in means])
    std = float(np.sqrt(variance)) if sum(map(len, means)) > 1 else np.nan
    counts = {len(runs) for runs in tasks}
    statistic = _iqm_of_means if 1 in counts or len(counts) > 1 else _iqm_of_values
    strata = [values if len(values) > 1 else runs[0] for values, runs in zip(means, tasks, strict=True)]
    iqm = float(statistic(*means)), *bootstrap(strata, statistic)
    return Summary(mean, std, *percentile_interval(resample(tasks).mean(axis=0)), *iqm)


def resample(environments: Sequence[Sequence[Floats]]) -> Floats:
    """Bootstrap draws of each environment's mean score. Shape (environments, RESAMPLES).

    Runs are drawn with replacement, the same in all environments with the same number of runs, because a run's policy
    is the same in several environments. The scenes of each environment are drawn as well, the same for all its runs.

    Args:
        environments: `environments[i][j]` are the episode scores of run j in environment i, in the order of scenes.

    Returns:
        The draws, which are the same for the same scores. NaN for an environment with a single episode.
    """
    rng = np.random.default_rng(0)
    shares: dict[int, Floats] = {}
    draws = np.empty((len(environments), RESAMPLES))
    for row, runs in zip(draws, environments, strict=True):
        count = len(runs)
        if count not in shares:
            shares[count] = rng.multinomial(count, np.full(count, 1 / count), RESAMPLES) / count
        scenes = {size: rng.integers(size, size=(RESAMPLES, size)) for size in sorted({*map(len, runs)})}
        means = np.stack([scores[scenes[len(scores)]].mean(axis=1) for scores in runs], axis=1)
        row[:] = (means * shares[count]).sum(axis=1) if sum(map(len, runs)) > 1 else np.nan
    return draws


def percentile_interval(draws: Floats) -> tuple[float, float]:
    """The 95 % interval of a statistic from its bootstrap draws."""
    low, high = np.percentile(draws, [50 * (1 - CONFIDENCE), 50 * (1 + CONFIDENCE)])
    return float(low), float(high)


def bootstrap(strata: Sequence[Floats], statistic: Any, resamples: int = RESAMPLES) -> tuple[float, float]:
    """The percentile interval of a statistic. Each stratum is resampled separately. NaN if one has a single value.

    The statistic is called as ``statistic(*strata, axis=-1)``.
    """
    from scipy.stats import bootstrap as scipy_bootstrap

    if min(map(len, strata)) < 2:
        return np.nan, np.nan
    size = sum(map(len, strata))
    interval = scipy_bootstrap(
        tuple(strata),
        statistic,
        vectorized=True,
        n_resamples=resamples,
        batch=None if size * resamples <= AT_ONCE else max(1, AT_ONCE // size),
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(0),  # the same scores always have the same interval
    ).confidence_interval
    return float(interval.low), float(interval.high)


def mean_interval(strata: Sequence[Floats]) -> tuple[float, float]:
    """The interval of the mean of the strata's means."""
    return bootstrap(strata, _mean_of_means)


def paired_means(pairs: pd.DataFrame, first: str, second: str) -> dict[str, Any]:
    """Compares the mean scores of two policies in the same scenes. All environments have equal weight.

    Args:
        pairs: a row for each scene with the two scores. The index holds the environment, and the scene as `seed`.
        first: the column of one policy.
        second: the column of the other policy.

    Returns:
        Both means, the `difference` of the first from the second and its 95 % interval (`low`, `high`), which resamples
        the scenes of each environment, and the numbers of `scenes` and `environments`.
    """
    groups = pairs.groupby([name for name in pairs.index.names if name != "seed"])
    means = groups.mean().mean()
    low, high = mean_interval([(group[first] - group[second]).to_numpy() for _, group in groups])
    difference = float(means[first] - means[second])
    counts = {"scenes": len(pairs), "environments": len(groups)}
    return {**means.to_dict(), "difference": difference, "low": low, "high": high, **counts}


def _means(strata: Sequence[Floats], axis: int) -> Floats:
    return np.stack([values.mean(axis=axis) for values in strata])


def _mean_of_means(*strata: Floats, axis: int = -1) -> Any:
    return _means(strata, axis).mean(axis=0)


def _iqm_of_means(*strata: Floats, axis: int = -1) -> Any:
    return interquartile_mean(_means(strata, axis), axis=0)


def _iqm_of_values(*strata: Floats, axis: int = -1) -> Any:
    return interquartile_mean(np.concatenate(strata, axis=axis), axis=axis)


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
        tasks = [
            [run.to_numpy(float) for _, run in task.groupby("run")["score"]]
            for _, task in group.groupby("task", observed=True)
        ]
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
        mean score with the shift (`mean`) and without it (`without`), the `difference` and its 95 % interval (`low`,
        `high`), and the numbers of `scenes` and `environments`. The interval resamples the scenes of each environment.
        Scores of several runs in one scene are averaged first. All environments have equal weight.
    """
    import pandas as pd

    played = scores.astype(dict.fromkeys(["policy", "task", "variant", "shift"], str)).set_index(
        ["policy", "run", "task", "variant", "seed"]
    )
    without = played[played["shift"] == ""]["score"]
    rows: list[dict[str, Any]] = []
    for (policy, shift), group in played[played["shift"] != ""].groupby(["policy", "shift"]):
        both = pd.concat([without, group["score"]], axis=1, join="inner", keys=["without", "mean"])
        both = both.groupby(["task", "variant", "seed"]).mean()
        if both.empty:
            continue
        axis, _, strength = str(shift).rpartition(":")
        graded = "+" not in str(shift) and strength.isdigit()
        rows.append(
            {
                "policy": policy,
                "shift": shift,
                "axis": axis if graded else shift,
                "strength": int(strength) if graded else math.nan,
                **paired_means(both, "mean", "without"),
            }
        )
    order = list(SHIFTS)
    rows.sort(key=lambda row: order.index(row["axis"]) if row["axis"] in order else len(order))
    return pd.DataFrame(rows)


def curve(rows: pd.DataFrame) -> dict[int, float]:
    """The mean score at each played strength, from the rows of one policy and axis. Strength 0 is without the shift."""
    points = {int(row.strength): float(row.mean) for row in rows.itertuples()}
    return {0: float(rows["without"].iloc[0]), **dict(sorted(points.items()))}


def area(points: dict[int, float]) -> float:
    """The area under a curve over strengths 0 to 5, divided by 5: a mean score. NaN if a strength is missing."""
    if set(points) != set(range(STRENGTHS + 1)):
        return math.nan
    return (sum(points.values()) - (points[0] + points[STRENGTHS]) / 2) / STRENGTHS


def half_lost(points: dict[int, float]) -> int | None:
    """The first strength with at most half of the score at strength 0. None if there is none."""
    lost = [strength for strength, score in points.items() if strength and score <= points[0] / 2 + SCORE_TOLERANCE]
    return min(lost) if lost and points[0] > SCORE_TOLERANCE else None
