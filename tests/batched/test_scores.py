"""Batched scores equal the scalar ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

import magical_mj
from magical_mj.batched.scenes import Capacity, SceneArrays
from magical_mj.batched.scores import Start, score
from magical_mj.scene import Scene
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import InvalidSceneError, UnknownNameError

CASES = json.loads((Path(__file__).parents[1] / "data" / "score_cases.json").read_text())


def batched(task: str, initial: list[Scene], final: list[Scene], rules: Rules) -> list[float]:
    capacity = Capacity.of(initial)
    start = Start.of(SceneArrays.of(initial, capacity))
    now = torch.from_numpy(SceneArrays.of(final, capacity).poses)
    return score(task, start, now, rules).tolist()


@pytest.mark.parametrize("rules", ["paper", "released"])
@pytest.mark.parametrize("task", [name for name in CASES if name != "_conventions"])
def test_known_final_states(task: str, rules: Rules) -> None:
    demo = magical_mj.sample_scene(task, "Demo", 0)
    final = [demo.moved(robot=case["robot"], blocks=case["blocks"]) for case in CASES[task]]
    wanted = [magical_mj.score(task, demo, scene, rules) for scene in final]
    assert batched(task, [demo] * len(final), final, rules) == pytest.approx(wanted, abs=1e-12)
    assert len(set(wanted)) > 1


@pytest.mark.parametrize("rules", ["paper", "released"])
@pytest.mark.parametrize(("task", "variant"), magical_mj.ENVIRONMENTS)
def test_worlds_of_every_kind_in_one_batch(task: str, variant: str, rules: Rules) -> None:
    """Blocks gathered around a few places, so that every score occurs; counts, shapes and colours differ."""
    rng = np.random.default_rng(0)
    initial = [magical_mj.sample_scene(task, variant, seed) for seed in range(40)]
    final = []
    for scene in initial:
        places = [*(region.centre for region in scene.regions), *rng.uniform(-0.8, 0.8, (2, 2))]
        poses = [(*(places[rng.integers(len(places))] + rng.normal(0, 0.08, 2)), 0.0) for _ in scene.blocks]
        if rng.random() < 0.5:
            keep = rng.integers(len(poses) + 1)
            poses[:keep] = [block.pose for block in scene.blocks[:keep]]
        final.append(scene.moved((*rng.uniform(-0.8, 0.8, 2), 0.0), poses))
    wanted = [magical_mj.score(task, one, other, rules) for one, other in zip(initial, final, strict=True)]
    assert batched(task, initial, final, rules) == pytest.approx(wanted, abs=1e-12)


def test_what_does_not_fit_is_refused() -> None:
    small = magical_mj.sample_scene("MoveToCorner", "Demo", 0)
    with pytest.raises(InvalidSceneError, match="does not fit"):
        SceneArrays.of([magical_mj.sample_scene("ClusterShape", "Demo", 0)], Capacity.of([small]))
    start = Start.of(SceneArrays.of([small], Capacity.of([small])))
    with pytest.raises(UnknownNameError, match="batched task"):
        score("PushOut", start, start.poses)
