"""The remaining distance of intents, and dense rewards by it."""

from __future__ import annotations

from contextlib import closing

import gymnasium
import numpy as np
import pytest

import magical_mj
from magical_mj.intents import EIGHT, SETS, parse
from magical_mj.intents.distances import remaining
from magical_mj.intents.selectors import UngroundedError
from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.tasks.registry import task_spec
from magical_mj.tasks.rules import WRONG

GAP = np.hypot(0.2, 0.45)
"""The distance of the two blocks in the scene by hand."""


def spread(initial: Scene, rng: np.random.Generator, side: float) -> Scene:
    """The scene with random poses."""
    blocks = [(*rng.uniform(-side, side, 2), 0.0) for _ in initial.blocks]
    return initial.moved((*rng.uniform(-1, 1, 2), 0.0), blocks)


@pytest.mark.parametrize("task", [task for task in EIGHT if task != "FixColour"])  # which has a further condition
def test_it_is_the_distance_of_the_task_that_says_the_same(task: str) -> None:
    rng = np.random.default_rng(0)
    for seed in range(40):
        initial = magical_mj.sample_scene(task, "All", seed)
        now = spread(initial, rng, 0.4 if seed % 2 else 1.0)
        assert remaining(EIGHT[task], initial, now) == task_spec(task).remaining((initial, now), "paper")


def test_it_is_0_exactly_if_the_intent_holds() -> None:
    rng, held = np.random.default_rng(1), 0
    intents = [intent for name in ("train", "relation") for intent in SETS[name][:150]]
    for seed, intent in enumerate(intents):
        initial = magical_mj.sample_scene("FindDupe" if seed % 2 else "MatchRegions", "All", seed)
        for side in (0.05, 0.3, 0.6, 1.0):
            now = spread(initial, rng, side) if side > 0.05 else initial
            try:
                left = remaining(intent, initial, now)
            except UngroundedError:
                continue
            assert (left == 0.0) == intent.holds(initial, now), intent
            assert left == 0.0 or left > WRONG * (1 - 1e-9)
            held += left == 0.0
    assert held > 10


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("wall(colour=red, left)", WRONG + 0.55),
        ("wall(any, all, left)", WRONG + 0.35),
        ("near(colour=red, to=blue)", WRONG + GAP - 0.45),
        ("exactly(1, all)", WRONG + 0.1),
        ("exactly(2, all)", 2 * WRONG + 0.1 + 0.4),
        ("robot in()", WRONG + 0.5),
        ("robot wall(bottom)", WRONG + 0.2),
        ("untouched(colour=red)", 0.0),
        ("apart(all)", 2 * (WRONG + 0.7 - GAP)),
        ("wall(colour=red, left) & robot in()", 2 * WRONG + 1.05),
    ],
)
def test_distances_by_hand(text: str, wanted: float) -> None:
    """The red block is 0.4 below the region, the blue one 0.1 beside it; the robot is 0.5 below it."""
    region = GoalRegion("green", -0.3, 0.0, 0.3, 0.4)
    red, blue = Block("star", "red", -0.2, -0.4, 0.0), Block("circle", "blue", -0.4, 0.05, 0.0)
    scene = Scene(Robot(0.0, -0.5, 0.0), (red, blue), (region,))
    assert remaining(parse(text), scene, scene) == pytest.approx(wanted)
    moved = scene.moved(blocks=[(-0.2, -0.9, 0.0), blue.pose])
    assert remaining(parse("untouched(all)"), scene, moved) == pytest.approx(WRONG + 0.5 - 0.15)


def test_dense_rewards_of_an_intent_add_up() -> None:
    task = "intent:exactly(2, all) & robot wall(any)"
    with closing(gymnasium.make(magical_mj.env_id(task, "Layout", "State"), reward="dense")) as env:
        env.reset(seed=1)
        engine = env.unwrapped.engine  # type: ignore[attr-defined]
        before, done, rewards = engine.remaining(), False, []
        while not done:
            _, reward, _, done, info = env.step(1)
            rewards.append(reward)
        assert sum(rewards) == pytest.approx(before - engine.remaining() + info["eval_score"])
        assert np.abs(rewards).max() > 0.0
