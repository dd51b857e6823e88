"""Trained policies: that they play in evaluations, draw by the episode, and are refused when they are damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from magical_mj.evaluation import evaluate
from magical_mj.learners import checkpoint, load_policy, train
from magical_mj.learners.policy import POLICY
from magical_mj.policies.interface import Episode
from magical_mj.utils.errors import SettingsError, TrainingError
from tests.helpers.learners import tiny


def test_the_policy_plays_in_evaluations(tmp_path: Path) -> None:
    """Given as a folder, one by one or side by side, it plays the same."""
    train(tiny(tasks="MoveToRegion,FixColour"), tmp_path / "run")
    path = str(tmp_path / "run")
    frames = [
        evaluate(path, tasks=["FixColour"], variants="Demo,Layout", episodes=2, **how) for how in ({}, {"envs": 2})
    ]
    keys = ["task", "variant", "seed"]
    scores = [frame.sort_values(keys)["score"].to_list() for frame in frames]
    assert len(scores[0]) == 4
    assert scores[0] == scores[1]
    with pytest.raises(SettingsError, match="trained on the preset LoRes4E, not LoRes4A: give --preset LoRes4E"):
        evaluate(path, tasks=["FixColour"], episodes=1, preset="LoRes4A")
    with pytest.raises(SettingsError, match=r"cannot act in MakeLine: give --tasks MoveToRegion,FixColour"):
        evaluate(path, tasks=["MakeLine"], episodes=1)


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
    for weights in loaded._actor.parameters():
        weights.data.fill_(float("nan"))
    with pytest.raises(ValueError, match="not finite"):
        loaded(picture)


@pytest.mark.parametrize("spoil", ["missing", "cut", "text", "other"])
def test_damaged_policies_are_refused(spoil: str, tmp_path: Path) -> None:
    path = tmp_path / POLICY
    if spoil == "cut":
        train(tiny(), tmp_path / "run")
        path.write_bytes((tmp_path / "run" / POLICY).read_bytes()[:-1000])
    elif spoil == "text":
        path.write_text("not a safetensors file at all")
    elif spoil == "other":
        checkpoint.write(path, {"weights": {"a": torch.zeros(2)}})
    with pytest.raises(TrainingError, match=r"policy\.safetensors"):
        load_policy(tmp_path)
