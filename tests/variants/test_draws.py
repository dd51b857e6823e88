"""The distributions of the variants' draws. The seeds are fixed and the bounds wide, so no test fails by chance."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

import numpy as np
import pytest

from magical_mj.scene import Dynamics, Pose, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, environment_axes, sample_scene, task_spec
from magical_mj.variants.rules import DYNAMICS_RANGES

SIZE_SLACK = 1e-12
"""For the rounding of a region's edges."""


drawn = cache(sample_scene)


def scenes(task: str, variant: str, number: int) -> list[Scene]:
    return [drawn(task, variant, seed) for seed in range(number)]


def outer_poses(scene: Scene) -> list[Pose]:
    return [block.pose for block in scene.blocks if not any(region.contains(block) for region in scene.regions)]


@pytest.mark.parametrize("task", TASKS)
def test_jitter_moves_everything_a_little_around_the_demo(task: str) -> None:
    demo = sample_scene(task, "Demo", 0)
    for scene in scenes(task, "Jitter", 50):
        things = zip((scene.robot, *scene.blocks), (demo.robot, *demo.blocks), strict=True)
        for thing, old in things:
            assert max(abs(thing.x - old.x), abs(thing.y - old.y)) <= c.JITTER_POSITION
            assert abs(thing.angle - old.angle) <= c.JITTER_ANGLE
            assert thing.pose != old.pose
        for region, old in zip(scene.regions, demo.regions, strict=True):
            low, high = task_spec(task).region_size
            for size, old_size in ((region.width, old.width), (region.height, old.height)):
                assert abs(size - old_size) <= c.JITTER_REGION_SIZE + SIZE_SLACK
                assert low - SIZE_SLACK <= size <= high + SIZE_SLACK
            reach = c.JITTER_POSITION + c.JITTER_REGION_SIZE / 2
            assert math.dist(region.centre, old.centre) <= reach * math.sqrt(2)


@pytest.mark.parametrize("task", ["FindDupe", "FixColour"])
def test_jitter_does_not_recentre_the_blocks_in_the_regions(task: str) -> None:
    demo = sample_scene(task, "Demo", 0)
    mean = np.mean([[b.pose for b in scene.blocks] for scene in scenes(task, "Jitter", 300)], axis=0)
    assert np.allclose(mean[:, :2], [b.pose[:2] for b in demo.blocks], atol=0.006)


@pytest.mark.parametrize(("task", "variant"), [pair for pair in ENVIRONMENTS if "layout" in environment_axes(*pair)])
def test_layout_uses_the_whole_workspace(task: str, variant: str) -> None:
    drawn_scenes = scenes(task, variant, 300)
    poses = np.array([pose for scene in drawn_scenes for pose in (scene.robot.pose, *outer_poses(scene))])
    assert np.allclose(poses.mean(axis=0), 0, atol=0.25)
    assert np.all(poses.min(axis=0) < [-0.72, -0.72, -3.0])
    assert np.all(poses.max(axis=0) > [0.72, 0.72, 3.0])
    assert np.abs(poses[:, 2]).max() <= math.pi
    low, high = task_spec(task).region_size
    sizes = [size for scene in drawn_scenes for region in scene.regions for size in (region.width, region.height)]
    assert all(low - SIZE_SLACK <= size <= high + SIZE_SLACK for size in sizes)
    if sizes:
        assert min(sizes) < low + 0.05 * (high - low)
        assert max(sizes) > high - 0.05 * (high - low)


@pytest.mark.parametrize(("task", "margin"), [("FindDupe", 0.06), ("FixColour", 0.12)])
def test_layout_places_inner_blocks_around_the_regions_centre(task: str, margin: float) -> None:
    offsets = []
    for scene in scenes(task, "Layout", 200):
        for region in scene.regions:
            (block,) = (block for block in scene.blocks if region.contains(block))
            room = min(region.width, region.height) / 2 - margin
            offsets.append(((block.x - region.centre[0]) / room, (block.y - region.centre[1]) / room))
    assert 0.95 < np.abs(offsets).max() <= 1 + SIZE_SLACK
    assert np.allclose(np.mean(offsets, axis=0), 0, atol=0.12)


def test_dynamics_are_uniform_in_their_ranges() -> None:
    drawn_scenes = [scene.dynamics for scene in scenes("MakeLine", "Dynamics", 500)]
    for name, (low, high) in DYNAMICS_RANGES.items():
        values = np.array([getattr(dynamics, name) for dynamics in drawn_scenes])
        assert low <= values.min() < low + 0.02 * (high - low)
        assert high - 0.02 * (high - low) < values.max() <= high
        assert values.mean() == pytest.approx((low + high) / 2, abs=0.05 * (high - low))
        assert low < getattr(Dynamics(), name) < high


def assert_uniform(values: Iterable[Any], options: Iterable[Any]) -> None:
    """Only the options occur, and all about equally often (within five standard deviations)."""
    counts = Counter(values)
    assert set(counts) == set(options)
    expected = counts.total() / len(counts)
    assert all(abs(count - expected) < 5 * math.sqrt(expected) for count in counts.values()), counts


def test_fix_colour_draws_the_odd_colour_uniformly_from_the_other_three() -> None:
    odd = []
    for scene in scenes("FixColour", "Colour", 3000):
        pairs = list(enumerate(zip(scene.regions, scene.blocks, strict=True)))
        odd += [(i, region.colour, block.colour) for i, (region, block) in pairs if region.colour != block.colour]
    assert len(odd) == 3000
    assert_uniform((index for index, _, _ in odd), range(3))
    assert_uniform(((own, other) for _, own, other in odd), [(a, b) for a in COLOURS for b in COLOURS if a != b])


def test_match_regions_has_four_colourings() -> None:
    drawn_scenes = scenes("MatchRegions", "Colour", 1000)
    assert_uniform(
        ((scene.regions[0].colour, *(b.colour for b in scene.blocks)) for scene in drawn_scenes),
        [
            ("red", "red", "red", "blue", "yellow", "yellow"),
            ("green", "green", "green", "blue", "yellow", "yellow"),
            ("blue", "blue", "blue", "green", "yellow", "yellow"),
            ("yellow", "yellow", "yellow", "green", "blue", "blue"),
        ],
    )


def test_find_dupe_may_have_further_duplicates_by_chance() -> None:
    drawn_scenes = scenes("FindDupe", "Shape", 1000)
    assert_uniform((scene.blocks[-1].shape for scene in drawn_scenes), SHAPES)
    duplicates = [
        sum((b.shape, b.colour) == (q.shape, q.colour) for b in others)
        for *others, q in (scene.blocks for scene in drawn_scenes)
    ]
    assert sum(number == 2 for number in duplicates) == pytest.approx(250, abs=70)
    for scene in scenes("FindDupe", "Colour", 50):
        assert scene.regions[0].colour == scene.blocks[-1].colour == scene.blocks[-2].colour


def _targets(scene: Scene) -> int:
    return sum(block.colour == scene.regions[0].colour for block in scene.blocks)


def _distractors(scene: Scene) -> tuple[int, ...]:
    counts = Counter(block.colour for block in scene.blocks)
    return tuple(counts[colour] for colour in COLOURS if colour != scene.regions[0].colour)


@pytest.mark.parametrize(
    ("task", "count", "options"),
    [
        ("MatchRegions", _targets, [1, 2]),
        ("MatchRegions", _distractors, [(i, j, k) for i in range(3) for j in range(3) for k in range(3)]),
        ("MakeLine", lambda scene: len(scene.blocks), [3, 4]),
        ("FindDupe", lambda scene: len(scene.blocks), [3, 4, 5, 6, 7]),
        ("FixColour", lambda scene: (len(scene.blocks), len(scene.regions)), [(2, 2), (3, 3)]),
        ("ClusterColour", lambda scene: len(scene.blocks), [7, 8, 9, 10]),
        ("ClusterShape", lambda scene: len(scene.blocks), [7, 8, 9, 10]),
    ],
)
def test_counts_are_uniform(task: str, count: Callable[[Scene], Any], options: list[Any]) -> None:
    assert_uniform((count(scene) for scene in scenes(task, "CountPlus", 600)), options)


@pytest.mark.parametrize("task", ["ClusterColour", "ClusterShape"])
def test_clusters_have_every_colour_and_shape_in_random_order(task: str) -> None:
    for variant in ("Colour", "Shape", "CountPlus", "All"):
        for scene in scenes(task, variant, 50):
            assert {block.colour for block in scene.blocks} == set(COLOURS)
            assert {block.shape for block in scene.blocks} == set(SHAPES)
    drawn_scenes = scenes(task, "CountPlus", 600)
    for place in (0, 6):
        assert_uniform((scene.blocks[place].colour for scene in drawn_scenes), COLOURS)
        assert_uniform((scene.blocks[place].shape for scene in drawn_scenes), SHAPES)


def test_shapes_that_do_not_fit_the_demo_poses_are_drawn_again() -> None:
    """In ClusterColour, two neighbours cannot both be stars; in ClusterShape, a square would be in the wall."""
    assert_uniform((scene.blocks[4].shape for scene in scenes("ClusterShape", "Shape", 600)), set(SHAPES) - {"square"})
    pairs = {(scene.blocks[2].shape, scene.blocks[5].shape) for scene in scenes("ClusterColour", "Shape", 300)}
    assert pairs == {(a, b) for a in SHAPES for b in SHAPES} - {("star", "star"), ("star", "pentagon")}
