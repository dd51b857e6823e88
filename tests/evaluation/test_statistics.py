"""Interquartile means, intervals and aggregates, compared with manual calculations, scipy, and the paper's Table 1."""

from __future__ import annotations

import itertools
import math
import re

import numpy as np
import pandas as pd
import pytest
import scipy.stats

from magical_mj import ENVIRONMENTS
from magical_mj.evaluation.reports.results import published_by_environment, published_by_variant, published_results
from magical_mj.evaluation.reports.statistics import (
    bootstrap,
    by_environment,
    by_variant,
    interquartile_mean,
    mean_interval,
    rank_correlation,
    summarise,
)


def test_interquartile_mean() -> None:
    cases = [
        ([0.5], 0.5),
        ([0.0, 1.0], 0.5),
        ([0.0, 0.1, 0.9], (0.0 + 0.1 + 0.9) / 3),  # a quarter of three values rounds down to none
        ([1.0, 0.0, 0.2, 0.4], (0.2 + 0.4) / 2),
        ([0.0, 0.1, 0.2, 0.6, 1.0], (0.1 + 0.2 + 0.6) / 3),  # one of five at each end
        ([0.0, 0.0, 0.1, 0.3, 0.5, 0.7, 1.0, 1.0], (0.1 + 0.3 + 0.5 + 0.7) / 4),
    ]
    for values, expected in cases:
        assert interquartile_mean(np.array(values)) == pytest.approx(expected)


def enumerated(strata: list[list[float]]) -> np.ndarray:
    """The means of the strata's means for all resamples, which are equally likely."""
    each = [[np.mean(drawn) for drawn in itertools.product(values, repeat=len(values))] for values in strata]
    return np.array([np.mean(means) for means in itertools.product(*each)])


def test_interval_is_that_of_all_ways_to_draw() -> None:
    strata = [[0.0, 0.5, 1.0], [0.2, 0.3, 0.9]]
    exact = np.quantile(enumerated(strata), [0.025, 0.975])
    interval = bootstrap([np.array(values) for values in strata], _mean_of_means, resamples=100_000)
    np.testing.assert_allclose(interval, exact, atol=0.02)


def _mean_of_means(*strata: np.ndarray, axis: int = -1) -> np.ndarray:
    return np.mean([values.mean(axis=axis) for values in strata], axis=0)


def test_interval_of_one_stratum_is_scipys() -> None:
    values = np.random.default_rng(1).random(50)
    expected = scipy.stats.bootstrap(
        (values,), np.mean, n_resamples=2000, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval
    assert mean_interval([values]) == pytest.approx((expected.low, expected.high))


def test_strata_are_drawn_by_themselves() -> None:
    """Differences between tasks do not widen an interval. Only the spread within each task counts."""
    assert mean_interval([np.array([0.0, 0.0, 0.0]), np.array([1.0, 1.0, 1.0])]) == (0.5, 0.5)


def test_one_value_has_no_interval() -> None:
    assert all(math.isnan(bound) for bound in mean_interval([np.array([0.5, 0.7]), np.array([0.4])]))


def test_summary_of_runs() -> None:
    """Two tasks with two runs each. The run means are 0.5 and 1, and 0 and 0.25."""
    summary = summarise(
        [
            [np.array([0.0, 1.0]), np.array([1.0, 1.0])],
            [np.array([0.0, 0.0]), np.array([0.5, 0.0])],
        ]
    )
    assert summary.mean == pytest.approx((0.75 + 0.125) / 2)
    assert summary.std == pytest.approx(np.std([0.5, 1.0, 0.0, 0.25]))
    assert summary.iqm == pytest.approx((0.25 + 0.5) / 2)
    assert summary.low == pytest.approx((0.5 + 0.0) / 2)  # the worst run of each task twice: 1 resample in 16
    assert summary.high == pytest.approx((1.0 + 0.25) / 2)


def test_tasks_have_equal_weight_in_all_statistics_whatever_their_runs() -> None:
    """Two tasks. If one has a second run that equals its first, the result must not change."""
    once = summarise([[np.array([1.0, 0.5])], [np.array([0.0, 0.5])]])
    more = summarise([[np.array([1.0, 0.5])] * 2, [np.array([0.0, 0.5])]])
    assert (more.mean, more.iqm, more.std) == (once.mean, once.iqm, once.std) == (0.5, 0.5, 0.25)
    many = summarise([[np.array([1.0])] * 9, *[[np.array([0.0])]] * 3])
    assert many.iqm == 0.0  # one task of four is better than 0, but is left out


def test_a_task_with_one_run_keeps_its_interval_beside_others() -> None:
    """By hand: run means are 0 and 1, as are the episodes of the only run. All four resamples are equally likely."""
    summary = summarise([[np.array([0.0]), np.array([1.0])], [np.array([0.0, 1.0])]])
    assert (summary.low, summary.high, summary.iqm_low, summary.iqm_high) == (0.0, 1.0, 0.0, 1.0)


def test_ranks_do_not_depend_on_the_last_digit() -> None:
    forth, back = [0.1, 0.2, 0.3, 0.7, 0.6, 0.9], [0.9, 0.6, 0.7, 0.3, 0.2, 0.1]
    assert np.mean(forth) != np.mean(back)
    assert rank_correlation({"a": forth, "b": back, "c": 1.0}, {"a": 0.0, "b": 0.0, "c": 1.0}) == 1


def test_one_run_has_no_spread_but_an_interval_over_its_episodes() -> None:
    summary = summarise([[np.array([0.0, 0.0, 1.0, 1.0])]])
    assert summary.mean == 0.5
    assert math.isnan(summary.std)
    assert (summary.low, summary.high) == (0.0, 1.0)


def scores(rows: list[tuple[str, int, str, str, list[float]]]) -> pd.DataFrame:
    episodes = [(*key, seed, score, None) for *key, values in rows for seed, score in enumerate(values)]
    return pd.DataFrame(episodes, columns=["policy", "run", "task", "variant", "seed", "score", "failure"])


def test_aggregates_know_how_many_tasks_they_have() -> None:
    frame = scores(
        [
            ("a", 0, "FindDupe", "Demo", [1.0, 0.0]),
            ("a", 1, "FindDupe", "Demo", [1.0, 1.0]),
            ("a", 0, "MakeLine", "Demo", [0.5, 0.0]),
            ("a", 0, "MakeLine", "All", [0.25]),
        ]
    )
    demo, every = by_variant(frame).to_dict("records")
    assert (demo["variant"], demo["tasks"], demo["runs"], demo["episodes"]) == ("Demo", 2, 2, 6)
    assert demo["mean"] == pytest.approx((0.75 + 0.25) / 2)
    assert (every["variant"], every["tasks"], every["mean"]) == ("All", 1, 0.25)
    cells = by_environment(frame)
    assert list(cells["mean"]) == [0.75, 0.25, 0.25]
    assert cells["std"].iloc[0] == 0.25
    assert cells["std"].iloc[1:].isna().all()


def test_published_results_are_all_there() -> None:
    table = published_results()
    assert len(table) == 660
    assert table["policy"].nunique() == 11
    for _, group in table.groupby("policy"):
        assert set(zip(group["task"], group["variant"], strict=True)) == set(ENVIRONMENTS[:60])  # those of the paper
    assert len(published_by_environment()) == 660


TABLE_1 = """
BC (ST)                     0.64 0.29  0.56 0.27  0.14 0.16  0.39 0.30  0.52 0.33
BC (ST, allo.)              0.58 0.33  0.48 0.29  0.04 0.04  0.42 0.32  0.50 0.37
BC (ST, no aug.)            0.55 0.37  0.37 0.30  0.12 0.15  0.33 0.30  0.41 0.33
BC (ST, no trans./rot. aug.) 0.55 0.37  0.41 0.31  0.13 0.15  0.33 0.30  0.43 0.35
BC (MT)                     0.59 0.33  0.53 0.31  0.14 0.18  0.30 0.25  0.51 0.36
GAIL (ST)                   0.72 0.35  0.69 0.33  0.22 0.23  0.27 0.24  0.60 0.42
GAIL (ST, allo.)            0.57 0.46  0.49 0.40  0.03 0.03  0.39 0.36  0.50 0.45
GAIL (ST, no aug.)          0.44 0.42  0.32 0.31  0.09 0.12  0.19 0.23  0.28 0.33
WGAIL-GP (ST)               0.42 0.38  0.33 0.32  0.14 0.20  0.10 0.11  0.33 0.33
GAIL (MT)                   0.37 0.41  0.33 0.36  0.16 0.25  0.11 0.12  0.28 0.36
"""


def test_published_aggregates_are_the_papers_table_1() -> None:
    """Equal up to the rounding of the published results."""
    table = published_by_variant().set_index(["policy", "variant"])
    variants = ["Demo", "Jitter", "Layout", "Colour", "Shape"]
    for line in TABLE_1.strip().splitlines():
        policy, numbers = re.fullmatch(r"(.*?\))\s+([\d. ]+)", line).groups()
        expected = np.array(numbers.split(), float).reshape(-1, 2)
        computed = table.loc[policy].loc[variants, ["mean", "std"]].to_numpy(float)
        np.testing.assert_allclose(computed, expected, atol=0.0101, err_msg=policy)
