"""POINT: its penalty on samples whose dependence is known, where Grad-CAM looks, and that the penalty falls."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from magical_mj.learners import load_settings
from magical_mj.learners.bc import Point, distance_correlation, looked_at
from magical_mj.utils.errors import SettingsError
from tests.helpers.learners import TINY

SMALL: dict[str, Any] = {"bc.batch_size": 3}


def test_dependence_is_told_from_independence() -> None:
    generator = torch.Generator().manual_seed(0)
    places, others = (torch.rand((200, 2), generator=generator) for _ in range(2))
    turned = places @ torch.tensor([[0.0, 3.0], [-3.0, 0.0]]) + 5
    assert distance_correlation(turned, places) == pytest.approx(1, abs=1e-4)
    assert abs(distance_correlation(others, places)) < 0.05
    assert distance_correlation((places - 0.5).square(), places) > 0.1  # without any linear correlation
    assert abs(distance_correlation(torch.zeros(200, 3), places)) < 1e-6


def test_constant_features_have_a_finite_gradient() -> None:
    features = torch.ones((6, 3), requires_grad=True)
    distance_correlation(features, torch.rand(6, 2)).backward()
    assert features.grad is not None
    assert features.grad.isfinite().all()


def test_it_looks_where_the_reason_is() -> None:
    """The chosen logit grows with channel 0, and falls with channel 1, which is therefore not looked at."""
    maps = torch.zeros((2, 2, 5, 5))
    maps[0, 0, 4, 2] = maps[1, 0, 2, 0] = 1.0
    maps[:, 1, 0, 0] = 7.0
    maps.requires_grad_()
    places = looked_at(maps, (maps[:, 0] - maps[:, 1]).sum())
    torch.testing.assert_close(places, torch.tensor([[0.0, 1.0], [-1.0, 0.0]]), atol=1e-5, rtol=0)


def test_the_penalty_falls_where_it_weighs() -> None:
    def last(weight: float) -> float:
        changes: dict[str, Any] = {**TINY, "bc.batches": 30, "bc.batch_size": 16, "point.weight": weight}
        learner = Point(load_settings("point", "MoveToRegion", quick=True, **changes))
        penalties = [learner.update()["penalty"] for _ in range(learner.updates)]
        return sum(penalties[-10:]) / 10

    assert last(5.0) < last(0.0)


def test_point_needs_pictures_and_large_batches() -> None:
    with pytest.raises(SettingsError, match="from pictures"):
        Point(load_settings("point", "MoveToRegion", preset="State"))
    with pytest.raises(SettingsError, match="at least 4"):
        Point(load_settings("point", "MoveToRegion", **SMALL))
