"""Intervals in simulated evaluations whose true mean is known."""

from __future__ import annotations

import pytest

from tools.coverage import contained, told_apart

WEEKLY = [(1, 20, 1), (1, 100, 8), (2, 20, 2), (5, 100, 8)]


@pytest.mark.xdist_group("results")
@pytest.mark.parametrize(
    ("runs", "scenes", "tasks"), [(2, 100, 8), *(pytest.param(*sizes, marks=pytest.mark.weekly) for sizes in WEEKLY)]
)
def test_intervals_contain_the_true_mean(runs: int, scenes: int, tasks: int) -> None:
    assert contained(runs, scenes, tasks, samples=200)[0] >= 0.91


@pytest.mark.xdist_group("results")
def test_equal_methods_are_rarely_told_apart() -> None:
    assert 0 < told_apart((2, 3), 100, 8, samples=200)[0] <= 0.09
