"""Interquartile means, intervals and aggregates, compared with manual calculations, scipy, and the paper's Table 1."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pandas as pd
import pytest
import scipy.stats

from magical_mj import ENVIRONMENTS, TASKS
from magical_mj.evaluation.reports.results import (
    published_by_environment,
    published_by_variant,
    published_results,
    published_table_1,
)
from magical_mj.evaluation.reports.statistics import (
    bootstrap,
    by_environment,
    by_variant,
    interquartile_mean,
    mean_interval,
    percentile_interval,
    rank_correlation,
    resample,
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
    """Two tasks with two runs each. The run means are 0.5 and 1, and 0 and 0.25; the first scene is 0 in one run."""
    summary = summarise(
        [
            [np.array([0.0, 1.0]), np.array([1.0, 1.0])],
            [np.array([0.0, 0.0]), np.array([0.5, 0.0])],
        ]
    )
    assert summary.mean == pytest.approx((0.75 + 0.125) / 2)
    assert summary.std == pytest.approx(np.std([0.5, 1.0, 0.0, 0.25]))
    assert summary.iqm == pytest.approx((0.25 + 0.5) / 2)
    assert summary.low == 0.0  # the worst run twice, and in the first task its worst scene: 1 draw in 16
    assert summary.high == pytest.approx((1.0 + 0.5) / 2)


def test_intervals_draw_runs_and_scenes() -> None:
    """Compared with all ways to draw two runs and three scenes, which are equally likely."""
    scores = np.array([[0.0, 0.2, 0.9], [0.3, 0.4, 1.0]])
    ways = itertools.product(itertools.product(range(2), repeat=2), itertools.product(range(3), repeat=3))
    exact = [scores[np.ix_(runs, scenes)].mean() for runs, scenes in ways]
    (draws,) = resample([list(scores)])
    assert draws.mean() == pytest.approx(np.mean(exact), abs=0.02)
    assert draws.std() == pytest.approx(np.std(exact), rel=0.1)
    np.testing.assert_allclose(percentile_interval(draws), np.quantile(exact, [0.025, 0.975]), atol=0.06)


def test_a_run_is_drawn_for_all_environments_together() -> None:
    """What one run lacks here it has there: their mean does not vary. One with another number of runs is apart."""
    low, high = np.zeros(4), np.ones(4)
    assert set(resample([[low, high], [high, low]]).mean(axis=0)) == {0.5}
    both = resample([[low, high], [high, low, low]])
    assert abs(rank_correlation(dict(enumerate(both[0])), dict(enumerate(both[1])))) < 0.1


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


def test_published_aggregates_are_the_papers_table_1() -> None:
    """Means over tasks are the printed ones, and equal those of the printed environments up to their rounding."""
    printed = published_table_1().set_index(["policy", "variant"])
    assert printed.loc[("BC (ST)", "Shape"), "mean"] == 0.52
    assert len(printed) == 10 * 5
    shown = published_by_variant().set_index(["policy", "variant"])
    pd.testing.assert_frame_equal(shown.loc[printed.index, ["mean", "std"]], printed)
    computed = published_by_variant([*TASKS[1:], TASKS[0]]).set_index(["policy", "variant"])
    np.testing.assert_allclose(computed.loc[printed.index, ["mean", "std"]], printed, atol=0.0101)
