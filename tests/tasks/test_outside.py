"""The example tasks outside of the benchmark: what they ask for, and that their plans lead there."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import magical_mj
from magical_mj.tasks.planning import Noise, scene_after
from magical_mj.tasks.registry import environments, task_spec
from magical_mj.utils.errors import InvalidSceneError

NAMES = ("RED_LEFT", "VISIT_STAR", "PAIR_UP", "HUDDLE")


@pytest.fixture(autouse=True)
def importable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(Path(__file__).parents[2] / "examples" / "outside"), *sys.path])


@pytest.mark.parametrize("name", NAMES)
def test_plans_lead_to_the_full_score_in_every_variant(name: str) -> None:
    task = f"outside:{name}"
    spec, noise = task_spec(task), Noise(np.random.default_rng(0), 1.0)
    assert spec.score(spec.demo, spec.demo, "paper") == 0
    for _, variant in environments(task, "all"):
        for seed in range(4):
            scene = magical_mj.sample_scene(task, variant, seed)
            after = scene_after(scene, spec.subgoals(scene, scene, noise))
            assert spec.score(scene, after, "paper") == 1
            assert spec.subgoals(scene, after, noise) == ()


@pytest.mark.parametrize(("name", "shape", "colour"), [("RED_LEFT", None, "red"), ("VISIT_STAR", "star", None)])
def test_names_that_count_are_never_exchanged(name: str, shape: str | None, colour: str | None) -> None:
    """The scene of every seed has exactly one block of that name, and no scene without it is accepted."""
    task = f"outside:{name}"
    for seed in range(10):
        blocks = magical_mj.sample_scene(task, "All", seed).blocks
        assert sum(block.shape == shape or block.colour == colour for block in blocks) == 1
    spec = task_spec(task)
    others = [block for block in spec.demo.blocks if block.shape != shape and block.colour != colour]
    with pytest.raises(InvalidSceneError, match="1 "):
        spec.check(magical_mj.Scene(spec.demo.robot, tuple(others)))
