"""Trained policies: that they play in evaluations, draw by the episode, and are refused when they are damaged."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from magical_mj.learners import load_policy, train
from magical_mj.learners.policy import POLICY
from magical_mj.policies.interface import Episode
from magical_mj.utils.errors import SettingsError
from tests.helpers.learners import tiny


def test_a_policy_draws_by_the_episode(tmp_path: Path) -> None:
    policy = train(tiny(), tmp_path / "run")
    loaded = load_policy(tmp_path / "run")
    picture = np.random.default_rng(0).integers(0, 256, (96, 96, 12)).astype(np.uint8)

    def actions(agent: object, seed: int) -> list[int]:
        agent.reset(Episode("MoveToRegion", "Demo", seed))
        return [agent(picture) for _ in range(30)]

    assert actions(policy, 0) == actions(loaded, 0) != actions(loaded, 1)
    assert len(set(actions(loaded, 0))) > 5  # two seconds of training leave it undecided
    with pytest.raises(SettingsError, match=r"arrays of shape \(96, 96, 12\)"):
        loaded(picture[:, :, :3])
    with pytest.raises(SettingsError, match="trained on MoveToRegion, and cannot act in FindDupe"):
        loaded.reset(Episode("FindDupe", "Demo", 0))
    for weights in loaded.actor.parameters():
        weights.data.fill_(float("nan"))
    with pytest.raises(ValueError, match="not finite"):
        loaded(picture)


@contextmanager
def doubles() -> Iterator[None]:
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(torch.float32)


@contextmanager
def rough_products() -> Iterator[None]:
    torch.set_float32_matmul_precision("medium")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision("highest")


@pytest.mark.parametrize(
    "setting",
    [doubles(), rough_products(), torch.no_grad(), torch.inference_mode(), torch.autocast("cpu"), torch.device("meta")],
    ids=["doubles", "rough-products", "no-grad", "inference", "autocast", "device"],
)
def test_no_result_depends_on_the_callers_settings_of_torch(tmp_path: Path, setting: Any) -> None:
    """They are the caller's again afterwards."""
    picture = np.random.default_rng(0).integers(0, 256, (1, 96, 96, 12)).astype(np.uint8)

    def drawn(folder: Path) -> tuple[bytes, list[int]]:
        train(tiny(**{"bc.batches": 4, "checkpoints": 1}), folder)
        policy = load_policy(folder)
        policy.reset(Episode("MoveToRegion", "Demo", 0))
        return (folder / POLICY).read_bytes(), [int(policy(picture[0])) for _ in range(20)]

    usual = drawn(tmp_path / "usual")
    with setting:
        before = torch.get_default_dtype(), torch.is_grad_enabled(), torch.get_float32_matmul_precision()
        assert drawn(tmp_path / "other") == usual
        assert (torch.get_default_dtype(), torch.is_grad_enabled(), torch.get_float32_matmul_precision()) == before
