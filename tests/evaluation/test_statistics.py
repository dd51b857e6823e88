"""Interquartile means and aggregates, compared with manual calculations and the paper's Table 1."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from magical_mj import ENVIRONMENTS, TASKS
from magical_mj.evaluation.reports.results import (
    published_by_environment,
    published_by_variant,
    published_results,
    published_table_1,
)
from magical_mj.evaluation.reports.statistics import (
    by_environment,
    by_variant,
    interquartile_mean,
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


def test_summary_of_runs() -> None:
    """Two tasks with two runs each. The run means are 0.5 and 1, and 0 and 0.25."""
    summary = summarise([np.array([[0.0, 1.0], [1.0, 1.0]]), np.array([[0.0, 0.0], [0.5, 0.0]])])
    assert summary.mean == pytest.approx((0.75 + 0.125) / 2)
    assert summary.std == pytest.approx(np.std([0.5, 1.0, 0.0, 0.25]))
    assert 0 < summary.low < summary.mean < summary.high < 1
    assert math.isnan(summary.iqm)  # of two runs


def test_interquartile_means_are_over_the_runs_of_all_tasks() -> None:
    """Ten run means, 0 to 0.9: two at each end are left out."""
    means = np.arange(10).reshape(2, 5) / 10
    assert summarise([np.repeat(one[:, None], 3, axis=1) for one in means]).iqm == pytest.approx(0.45)


def test_tasks_have_equal_weight_whatever_their_runs() -> None:
    """Two tasks. If one has a second run that equals its first, the result must not change."""
    once = summarise([np.array([[1.0, 0.5]]), np.array([[0.0, 0.5]])])
    more = summarise([np.array([[1.0, 0.5]] * 2), np.array([[0.0, 0.5]])])
    assert (more.mean, more.std) == (once.mean, once.std) == (0.5, 0.25)
    assert more.low < more.high


def test_ranks_do_not_depend_on_the_last_digit() -> None:
    forth, back = [0.1, 0.2, 0.3, 0.7, 0.6, 0.9], [0.9, 0.6, 0.7, 0.3, 0.2, 0.1]
    assert np.mean(forth) != np.mean(back)
    assert rank_correlation({"a": forth, "b": back, "c": 1.0}, {"a": 0.0, "b": 0.0, "c": 1.0}) == 1


def test_one_run_has_no_spread_but_an_interval_over_its_episodes() -> None:
    summary = summarise([np.array([[0.0, 0.0, 1.0, 1.0]])])
    assert summary.mean == 0.5
    assert math.isnan(summary.std)
    assert 0 < summary.low < 0.25
    assert 0.75 < summary.high < 1


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
