"""`redraw`: its pictures are those of the environments, and its two policies are trained one after the other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from magical_mj import TASKS, Engine, demos
from magical_mj.evaluation import evaluate
from magical_mj.learners import load_settings, redraw, train
from magical_mj.learners.data import shipped
from magical_mj.learners.networks import blocks_of, regions_of
from magical_mj.learners.redraw import Redraw, Redrawer
from magical_mj.learners.relational import REPORT
from magical_mj.utils.errors import SettingsError
from tests.helpers.learners import RELATIONAL, TINY

SMALL: dict[str, Any] = {**TINY, **RELATIONAL, "network.channels": 8, "bc.batches": 3, "bc.batch_size": 8}


def drawn(states: torch.Tensor, view: str = "ego") -> np.ndarray:
    pictures = np.empty((len(states), 96, 96, 3), np.uint8)
    Redrawer(view, "software").draw(states, pictures)
    return pictures


@pytest.mark.parametrize("task", TASKS)
def test_what_was_seen_is_seen_again(task: str) -> None:
    demonstration = shipped(task)[0]
    states = np.asarray(demos.transitions([demonstration], preset="State")[0])
    seen = np.asarray(demos.transitions([demonstration], preset="LoRes4E", renderer="software")[0])
    steps = np.linspace(0, len(states) - 1, 5).astype(int)
    again = drawn(torch.from_numpy(states[steps]))
    assert (again != seen[steps][..., 9:]).mean() < 1e-3  # states are rounded to single precision


def test_what_is_missing_is_not_seen() -> None:
    scene = shipped("FixColour")[0].scene
    states = torch.from_numpy(Engine.of_scene(scene).state_vector()[None].copy())
    blocks_of(states)[0, 1, 0] = regions_of(states)[0, 0, 0] = 0
    less = replace(scene, blocks=(scene.blocks[0], *scene.blocks[2:]), regions=scene.regions[1:])
    expected = Engine.of_scene(less, renderer="software").render("allo", 96)
    assert (drawn(states, "allo")[0] != expected).mean() < 1e-3


def test_a_policy_is_trained_kept_and_evaluated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(redraw, "POOL", 16)
    train(load_settings("redraw", "MoveToRegion", quick=True, **SMALL), tmp_path / "run")
    assert (tmp_path / "run" / REPORT).is_file()
    played = evaluate(str(tmp_path / "run"), tasks="MoveToRegion", variants="Demo", episodes=1, renderer="software")
    assert played["failure"].isna().all()


@pytest.mark.parametrize("wrong", [{"preset": "State"}, {"preset": "LoRes3EA"}, {"tasks": "MoveToRegion,FixColour"}])
def test_it_learns_one_task_from_one_view(wrong: dict[str, str]) -> None:
    with pytest.raises(SettingsError, match="one task from one view"):
        Redraw(load_settings("redraw", **{"tasks": "FixColour", **SMALL, **wrong}))
