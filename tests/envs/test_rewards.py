"""Dense rewards: the remaining distance of every task, and the rewards that follow from it in every interface."""

from __future__ import annotations

import itertools
import math
import re
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray

import magical_mj
from magical_mj.demos import Demonstration
from magical_mj.scene import Block, GoalRegion, Scene
from magical_mj.tasks import KNOWN, RULES
from magical_mj.tasks.make_line import SPEC as MAKE_LINE
from magical_mj.tasks.move_to_region import SPEC as MOVE_TO_REGION
from magical_mj.tasks.registry import task_spec
from magical_mj.tasks.rules import WRONG, way_out
from magical_mj.utils.errors import SettingsError, TaskError
from magical_mj.wrappers import ContinuousActions, ScoreAtTheEnd

MOVES = 0.01
"""World units that something covers in a step if it is carried."""
CARRIED = 0.15
"""World units of the shortest way that counts as carrying."""
PAUSE = 4
"""Steps of rest that end a carrying phase."""
FREE = {"MakeLine": 0.9, "ClusterColour": 0.75, "ClusterShape": 0.8}
"""The share of phases that must decrease the distance where many arrangements are right: the expert may pursue another
one than the nearest."""
SPECS = {**KNOWN, "Untrodden": replace(MAKE_LINE, distance=None, name="Untrodden")}
UNTRODDEN = SPECS["Untrodden"]


def places(scene: Scene) -> list[tuple[float, float]]:
    """The positions of what a task is about: of the blocks, or the robot if there are none."""
    return [(item.x, item.y) for item in scene.blocks or (scene.robot,)]


def phases(ways: NDArray[np.float64]) -> Iterator[tuple[int, int]]:
    """First and last step of each phase in which something is carried, from positions, shape (steps + 1, n, 2)."""
    moves = np.linalg.norm(np.diff(ways, axis=0), axis=-1).max(axis=1) > MOVES
    step = 0
    while step < len(moves):
        end = step
        while end < len(moves) and moves[end : end + PAUSE].any():
            end += 1
        if np.linalg.norm(ways[end] - ways[step], axis=-1).max() > CARRIED:
            yield step, end
        step = max(end, step + 1)


@pytest.mark.parametrize("task", KNOWN)
def test_the_distance_falls_while_demonstrations_carry_and_is_0_exactly_if_the_score_is_1(task: str) -> None:
    spec, falls = task_spec(task), list[float]()
    for demo in magical_mj.demos.load(task):
        scenes = demo.scenes()
        left = [spec.remaining((scenes[0], scene), "paper") for scene in scenes]
        for scene, distance in zip(scenes[::5], left[::5], strict=True):
            assert (distance == 0.0) == (spec.checked_score((scenes[0], scene), "paper") == 1.0)
        assert left[0] > 0.0 == left[-1]
        falls += [left[start] - left[end] for start, end in phases(np.array([places(scene) for scene in scenes]))]
    share = np.mean([fall > 0 for fall in falls])
    assert share >= FREE.get(task, 0.85)  # some push another block aside
    assert np.mean([fall >= 0 for fall in falls]) >= (0.95 if task not in FREE else share)
    assert np.mean(falls) > 0.1


@pytest.mark.parametrize("task", KNOWN)
def test_in_random_scenes_it_is_0_exactly_if_the_score_is_1_by_both_rules(task: str) -> None:
    spec, rng, most = task_spec(task), np.random.default_rng(0), 0.0
    for variant in ("Demo", "All"):
        initial = magical_mj.sample_scene(task, variant, 3)
        half = initial.half_width
        for trial in range(150):
            spread = half if trial % 2 else 0.35  # near each other, more is right by chance
            blocks = [(*rng.uniform(-spread, spread, 2), 0.0) for _ in initial.blocks]
            now = initial.moved(robot=(*rng.uniform(-half, half, 2), 0.0), blocks=blocks)
            for rules in RULES:
                left, reached = (function((initial, now), rules) for function in (spec.remaining, spec.checked_score))
                assert (left == 0.0) == (reached == 1.0)
                assert left == 0.0 or left > WRONG * (1 - 1e-9)
                most = max(most, left / max(len(now.blocks), 1))
    assert most < 6.0 if "Cluster" not in task else most < 20.0


def test_distances_of_scenes_by_hand() -> None:
    def left(task: str, now: Scene, rules: Any = "paper", initial: Scene | None = None) -> float:
        return task_spec(task).remaining((initial or task_spec(task).demo, now), rules)

    region = MOVE_TO_REGION.demo.regions[0]
    away = MOVE_TO_REGION.demo.moved(robot=(region.x_max + 0.3, region.y_max + 0.4, 0.0))
    assert left("MoveToRegion", away) == pytest.approx(WRONG + 0.5)
    corner = task_spec("MoveToCorner").demo.moved(blocks=[(0.0, 1.0, 0.0)])
    assert left("MoveToCorner", corner) == pytest.approx(WRONG + 1 - math.sqrt(0.5))
    row = MAKE_LINE.demo.moved(blocks=[(x, 0.0, 0.0) for x in (-0.4, 0.0, 0.5, 0.9)])
    assert left("MakeLine", row) == pytest.approx(WRONG + 0.08)  # the gap of 0.5
    match = task_spec("MatchRegions").demo
    (goal,) = match.regions
    poses = [list(block.pose) for block in match.blocks]
    for number, block in enumerate(match.blocks):
        if block.colour == goal.colour:
            poses[number][:2] = goal.centre
    poses[2][:2] = goal.x_min + 0.05, goal.centre[1]  # a distractor that has to leave by the left side
    assert left("MatchRegions", match.moved(blocks=poses)) == pytest.approx(WRONG + 0.05)
    fix = task_spec("FixColour").demo
    odd = fix.moved(blocks=[*[block.pose for block in fix.blocks[:2]], (-0.67, 0.0, 0.0)])
    assert left("FixColour", odd, initial=fix) == pytest.approx(WRONG + 0.011)


def expected(demo: Demonstration) -> list[float]:
    """The dense rewards of a demonstration of a whole episode, from its states."""
    spec, scenes = task_spec(demo.task), demo.scenes()
    left = [spec.remaining((scenes[0], scene), "paper") for scene in scenes]
    rewards = [before - after for before, after in itertools.pairwise(left)]
    return [*rewards[:-1], rewards[-1] + demo.score]


def test_all_interfaces_give_the_same_rewards_which_add_up() -> None:
    demo = magical_mj.demos.load("MoveToRegion")[0]
    rewards, name = expected(demo), "magical_mj/MoveToRegion-Demo-State-v0"
    with closing(gymnasium.make(name, reward="dense")) as env:
        env.reset(seed=0)
        assert [env.step(action)[1] for action in demo.actions] == pytest.approx(rewards)
        assert sum(rewards) == pytest.approx(
            1.0 + task_spec("MoveToRegion").remaining((demo.scene, demo.scene), "paper")
        )
    with closing(magical_mj.load("MoveToRegion", reward="dense", observations=("state",))) as composed:
        composed.reset()
        assert [composed.step(action).reward for action in demo.actions] == pytest.approx(rewards)
    for mode in ("vector_entry_point", "sync"):
        with closing(gymnasium.make_vec(name, 2, vectorization_mode=mode, reward="dense")) as envs:
            envs.reset(seed=0)
            both = np.array([envs.step(np.full(2, action))[1] for action in demo.actions])
            np.testing.assert_allclose(both, np.stack([rewards, rewards], axis=1))
    with closing(ContinuousActions(gymnasium.make(name, reward="dense", max_episode_steps=30))) as wrapped:
        wrapped.reset(seed=0)
        got = [wrapped.step(ContinuousActions.to_vector(action))[1] for action in demo.actions[:30]]
        assert got == pytest.approx([*rewards[:29], rewards[29] + demo.rescored(30)])


def test_rewards_continue_from_states() -> None:
    demo = magical_mj.demos.load("MatchRegions")[0]
    inner = magical_mj.MagicalEnv("MatchRegions", preset="State", reward="dense")
    env = ScoreAtTheEnd(inner)
    env.reset(seed=0)
    rewards = expected(demo)
    for action in demo.actions[:30]:
        env.step(action)
    state = inner.get_state()
    for action in demo.actions[30:50]:
        env.step(action)
    inner.set_state(state)
    assert [inner.step(action)[1] for action in demo.actions[30:60]] == pytest.approx(rewards[30:60])
    before = inner.engine.remaining()
    inner.engine.data.qpos[:] = magical_mj.Engine(
        "MatchRegions", seed=0
    ).data.qpos  # moved by hand, which has no reward
    moved = inner.engine.remaining()
    assert moved != pytest.approx(before)
    reward = inner.step(0)[1]
    assert reward == pytest.approx(moved - inner.engine.remaining())


def test_tasks_without_a_formula_or_with_a_wrong_one_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"{__name__}:UNTRODDEN"
    for make in (
        lambda: magical_mj.MagicalEnv(name, reward="dense"),
        lambda: gymnasium.make(magical_mj.env_id(name), reward="dense"),
        lambda: magical_mj.load(name, reward="dense"),
    ):
        with pytest.raises(TaskError, match=r'Untrodden .*has no dense rewards: use reward="score".*`distance`'):
            make()
    for wrong in (-1.0, math.nan, "far", None):
        spec = replace(MOVE_TO_REGION, distance=lambda *_, wrong=wrong: wrong)
        with pytest.raises(TaskError, match="distance must return a finite number >= 0"):
            spec.remaining((spec.demo, spec.demo), "paper")
    with pytest.raises(TaskError, match="distance must be a function, or None"):
        replace(MOVE_TO_REGION, distance=1.0)  # type: ignore[arg-type]


def test_batched_worlds_have_none() -> None:
    pytest.importorskip("warp")
    with pytest.raises(SettingsError, match="batched environments have no dense rewards"):
        magical_mj.batched.make("MoveToRegion", num_envs=1, device="cpu", reward="dense")


def test_the_table_in_the_docs_has_all_tasks_and_their_bounds() -> None:
    page = (Path(__file__).parents[2] / "docs" / "rewards.md").read_text("utf-8").partition("## Curves")[0]
    rows = dict(re.findall(r"^\| ([A-Z][\w, ]+?)(?:, by.*?)? \| .* \| ([\d.]+)", page, re.MULTILINE))
    tasks = {task: most for names, most in rows.items() for task in names.split(", ")}
    assert tasks.keys() - {"Task"} == set(KNOWN)
    for task in KNOWN:
        said = " ".join((sys.modules[task_spec(task).score.__module__].__doc__ or "").split())
        if not task.startswith("Cluster"):  # whose docstring is that of magical_mj.tasks.cluster
            assert f"t most {tasks[task]}" in said


def test_ways_out_of_a_region_of_equal_length_all_count() -> None:
    region = GoalRegion("red", 0.25, 0.25, 1.0, 1.0)
    near, on, beyond = (way_out(region, Block("star", "red", 0.5, y, 0.0)) for y in (0.75 - 1e-9, 0.75, 0.75 + 1e-9))
    assert near == pytest.approx(on) == pytest.approx(beyond)


def test_old_names_of_dense_rewards_take_truth_values_only() -> None:
    with pytest.raises(SettingsError, match="True or False"):
        gymnasium.make("magical_mj/FindDupe-Demo-State-v0", debug_reward="False")
