"""Planning, without a simulator: subgoals, lines and clusters."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

import magical_mj
from magical_mj import ENVIRONMENTS, TASKS
from magical_mj.tasks.cluster import NEARER, right_blocks
from magical_mj.tasks.make_line import are_lines
from magical_mj.tasks.planning import Noise, Subgoal, cluster_targets, line_targets, scene_after
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import PlacementError


def noise(seed: int = 0, strength: float = 1.0) -> Noise:
    return Noise(np.random.default_rng(seed), strength)


@pytest.mark.parametrize(
    ("task", "variant"), [pair for pair in ENVIRONMENTS if pair[1] in ("Demo", "CountPlus", "All")]
)
def test_the_subgoals_solve_the_task(task: str, variant: str) -> None:
    for seed in range(3):
        scene = magical_mj.sample_scene(task, variant, seed)
        todo = task_spec(task).subgoals((scene, scene), noise(seed))
        assert magical_mj.score(task, scene, scene_after(scene, todo)) == 1.0
        assert len({subgoal.block for subgoal in todo}) == len(todo)
        assert all(max(map(abs, subgoal.target)) < 0.9 for subgoal in todo)


def test_a_scene_solved_by_one_set_of_rules_has_subgoals_by_the_other() -> None:
    half = replace(task_spec("FindDupe"), score=lambda initial, final, rules: 1.0 if rules == "paper" else 0.5)
    assert half.subgoals((half.demo, half.demo), noise()) == ()
    assert half.subgoals((half.demo, half.demo), noise(), "released") != ()


def test_a_plan_without_room_says_so() -> None:
    scene = magical_mj.sample_scene("MatchRegions", "Demo", 0)
    everywhere = replace(scene, regions=(replace(scene.regions[0], x_min=-0.9, y_min=-0.9, x_max=0.9, y_max=0.9),))
    with pytest.raises(PlacementError, match="no position for block 2"):
        task_spec("MatchRegions").subgoals((everywhere, everywhere), noise())


@pytest.mark.parametrize("task", TASKS)
def test_a_solved_scene_leaves_nothing_to_do(task: str) -> None:
    scene = magical_mj.sample_scene(task, "Demo", 0)
    solved = scene_after(scene, task_spec(task).subgoals((scene, scene), noise()))
    assert task_spec(task).subgoals((scene, solved), noise()) == ()


def test_a_subgoal_costs_more_the_farther_it_is() -> None:
    scene = magical_mj.sample_scene("MoveToCorner", "Demo", 0)
    block = scene.blocks[0]
    near, far = (Subgoal(0, (block.x - way, block.y)).cost(scene) for way in (0.2, 0.9))
    assert 0 < near < far
    assert Subgoal(0, (block.x, block.y)).cost(scene) == 0


def test_the_mistake_of_a_clumsy_expert_is_mended() -> None:
    """A distractor in the region, and the query out of it: both are subgoals."""
    scene = magical_mj.sample_scene("FindDupe", "Demo", 0)
    poses = [block.pose for block in scene.blocks]
    poses[0], poses[6] = (-0.3, -0.6, 0.0), (0.2, -0.1, 0.0)
    todo = task_spec("FindDupe").subgoals((scene, scene.moved(blocks=poses)), noise())
    assert {subgoal.block for subgoal in todo} == {0, 5, 6}


@pytest.mark.parametrize("seed", range(10))
def test_lines_are_lines_and_move_few_blocks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = [(float(x), float(y)) for x, y in rng.uniform(-0.8, 0.8, (4, 2))]
    targets = line_targets(points, are_lines, noise(seed))
    ends = [target or point for target, point in zip(targets, points, strict=True)]
    assert next(are_lines(np.array([ends])))
    assert targets.count(None) >= 1


@pytest.mark.parametrize("seed", range(5))
def test_clusters_are_clusters_with_room_between_blocks(seed: int) -> None:
    scene = magical_mj.sample_scene("ClusterShape", "CountPlus", seed)
    points = [(block.x, block.y) for block in scene.blocks]
    targets = cluster_targets(points, [block.shape for block in scene.blocks], NEARER, noise(seed))
    after = scene.moved(blocks=[(*(t or p), 0.0) for t, p in zip(targets, points, strict=True)])
    assert all(right_blocks(after, "shape"))
    moved = [target for target in targets if target]
    assert all(math.dist(one, other) > 0.26 for one, other in itertools.combinations(moved, 2))


@pytest.mark.parametrize("seed", range(3))
def test_fixed_blocks_stay(seed: int) -> None:
    scene = magical_mj.sample_scene("ClusterShape", "CountPlus", seed)
    points = [(block.x, block.y) for block in scene.blocks]
    kinds = [block.shape for block in scene.blocks]
    targets = cluster_targets(points, kinds, NEARER, noise(seed))
    moved = next(number for number, target in enumerate(targets) if target)
    targets = cluster_targets(points, kinds, NEARER, noise(seed), fixed={moved})
    assert targets[moved] is None
    assert any(targets)
    assert not any(cluster_targets(points, kinds, NEARER, noise(seed), fixed=range(len(points))))
    assert line_targets(points[:4], are_lines, noise(seed), fixed={seed})[seed] is None


def test_blocks_too_many_for_a_line_stay() -> None:
    points = [(0.15 * number - 0.8, 0.1 * (number % 3)) for number in range(12)]
    assert line_targets(points, are_lines, noise(0)) == [None] * 12


@pytest.mark.parametrize("count", [5, 8])
def test_more_kinds_than_corners_are_clustered_too(count: int) -> None:
    points = [(0.3 * (number % 5) - 0.6, 0.4 * (number // 5) - 0.3) for number in range(2 * count)]
    kinds = [f"kind {number % count}" for number in range(2 * count)]
    targets = cluster_targets(points, kinds, NEARER, noise(0))
    assert len(targets) == len(points)
    assert any(targets)
