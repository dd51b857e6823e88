"""Intervals cover scenes and runs: by hand, and by properties."""

from __future__ import annotations

import numpy as np
import pytest

from magical_mj.evaluation.reports.intervals import SHARED, Cell, Estimate, estimate, mean_over


def of(*runs: list[float]) -> Estimate:
    return mean_over([("policies", "scenes", np.array(runs))])


def gain(first: np.ndarray, second: np.ndarray, same_runs: bool = False) -> Estimate:
    cells = [Cell(scores, sign, same_runs or sign, "") for sign, scores in ((1, first), (-1, second))]
    return estimate(cells)


def solved(count: int, scenes: int) -> list[float]:
    return [1.0] * count + [0.0] * (scenes - count)


def test_the_interval_of_one_run_is_wilsons() -> None:
    """For scores of 0 and 1, whose variance is m (1 - m) up to that of one more scene."""
    square = 1.959964**2
    for count in (0, 3, 50, 100):
        mean = count / 100
        middle, half = mean + square / 200, np.sqrt(square * mean * (1 - mean) / 100 + (square / 200) ** 2)
        wilson = np.array([middle - half, middle + half]) / (1 + square / 100)
        assert of(solved(count, 100))[1:] == pytest.approx(wilson, abs=0.005)
    assert of(solved(0, 100))[1:] == pytest.approx((0, square / (100 + square)), abs=1e-6)


def test_equal_scores_still_have_an_interval() -> None:
    """Twelve scenes that score 0 do not prove that the next one does. Further runs say more, if not five times."""
    twelve, five_runs = of(solved(0, 12)), of(*[solved(0, 12)] * 5)
    assert (twelve.low, five_runs.low) == (0, 0)
    assert 0.2 < twelve.high < 0.3
    square = 1.959964**2 * (SHARED + (1 - SHARED) / 5) / 12
    assert square / (1 + square) < five_runs.high < twelve.high
    assert of([0.25] * 12).high - of([0.25] * 12).low > 0.05
    nothing = np.zeros((1, 12))
    assert gain(nothing, nothing).low < -0.1 < 0.1 < gain(nothing, nothing).high


def test_runs_that_differ_widen_an_interval_more_than_scenes() -> None:
    """Two runs of 7 and 9 of 20: their interval is not just that of the two means, nor narrower than one run's."""
    means = of(solved(7, 20), solved(9, 20))
    assert means.value == pytest.approx(0.4)
    assert means.low < 0.3
    assert means.high > 0.5
    apart = of(solved(0, 100), solved(100, 100))
    assert (apart.low, apart.high) == (0, 1)
    equal, unequal = (of(*(solved(50 + step * by, 100) for step in range(-2, 3))) for by in (0, 20))
    assert unequal.high - unequal.low > 2 * (equal.high - equal.low)


def test_more_tasks_narrow_an_interval() -> None:
    one = np.array([solved(8, 20), solved(14, 20)])
    widths = [
        found.high - found.low for tasks in (1, 4) for found in [mean_over((task, task, one) for task in range(tasks))]
    ]
    assert widths[1] < 0.6 * widths[0]
    same_policies = mean_over(("", variant, one) for variant in range(4))
    assert same_policies.high - same_policies.low > widths[1]


def test_the_same_scenes_make_a_difference_clearer() -> None:
    """One policy solves the scenes of the other and some more. In unrelated scenes, this says less."""
    first, second = np.array([solved(40, 60)]), np.array([solved(32, 60)])
    apart = gain(first, second[:, ::-1])
    paired = gain(first, second)
    assert paired.value == pytest.approx(apart.value) == pytest.approx(8 / 60)
    assert paired.decided
    assert not apart.decided
    assert gain(second, first)[1:] == pytest.approx((-paired.high, -paired.low))


def test_the_same_policies_are_compared_run_by_run() -> None:
    """Each of three runs loses 0.15, although they differ by more: a shift is clear, another method is not."""
    rng = np.random.default_rng(0)
    runs = np.array([0.2, 0.5, 0.8])[:, None] + 0.05 * rng.standard_normal((3, 40))
    assert gain(runs, runs - 0.15, same_runs=True).decided
    assert not gain(runs, runs - 0.15).decided


def test_missing_episodes_and_orders() -> None:
    scores = np.array([[0.2, 0.4, 0.9, 1.0], [0.0, 0.3, 0.8, 0.1]])
    whole = of(*scores.tolist())
    assert of(*scores[::-1, ::-1].tolist()) == pytest.approx(whole)
    scores[1, 3] = np.nan
    assert of(*scores.tolist()).value == pytest.approx((scores[0].mean() + scores[1, :3].mean()) / 2)
    assert np.isnan(of([0.5], [0.7]).low)  # one scene
