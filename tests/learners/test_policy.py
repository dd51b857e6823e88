"""Trained policies: that they play in evaluations, draw by the episode, and are refused when they are damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from magical_mj.learners import load_policy, train
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
