"""What every sampled scene must be, over all 60 environments, and how the draws are distributed."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from magical_mj import constants as c
from magical_mj.constants import COLOURS, SHAPES
from magical_mj.errors import InvalidSeedError, PlacementError, UnknownNameError
from magical_mj.geometry import check_scene, inside_walls, region_solid, solids, touch
from magical_mj.registry import ENVIRONMENTS, TASKS, VARIANTS, environment_axes, sample_scene, task_spec, variant_name
from magical_mj.scene import Dynamics, Pose, Scene
from magical_mj.variants import vary
from magical_mj.variants.dynamics import RANGES

TABLE = """
MoveToCorner    Demo Jitter -      Colour Shape -         Dynamics All
MoveToRegion    Demo Jitter Layout Colour -     -         Dynamics All
MatchRegions    Demo Jitter Layout Colour Shape CountPlus Dynamics All
MakeLine        Demo Jitter Layout Colour Shape CountPlus Dynamics All
FindDupe        Demo Jitter Layout Colour Shape CountPlus Dynamics All
FixColour       Demo Jitter Layout Colour Shape CountPlus Dynamics All
ClusterColour   Demo Jitter Layout Colour Shape CountPlus Dynamics All
ClusterShape    Demo Jitter Layout Colour Shape CountPlus Dynamics All
"""
"""The paper's table of what exists; here, and nowhere else, it is written out by hand."""

SIZE_SLACK = 1e-12


def scenes(task: str, variant: str, number: int) -> list[Scene]:
    return [sample_scene(task, variant, seed) for seed in range(number)]


def outer_poses(scene: Scene) -> list[Pose]:
    return [block.pose for block in scene.blocks if not any(region.contains(block) for region in scene.regions)]


def test_the_environments_are_those_of_the_paper() -> None:
    rows = [line.split() for line in TABLE.strip().splitlines()]
    assert [row[0] for row in rows] == list(TASKS)
    assert [(row[0], variant) for row in rows for variant in row[1:] if variant != "-"] == list(ENVIRONMENTS)
    assert len(ENVIRONMENTS) == 60


@pytest.mark.parametrize(("task", "variant"), ENVIRONMENTS)
def test_every_scene_is_legal_and_of_its_task(task: str, variant: str) -> None:
    """Inside the walls, nothing touching; only blocks that belong in a region touch one, and just that one."""
    for scene in scenes(task, variant, 30):
        check_scene(scene)
        task_spec(task).check(scene)
        bodies = solids(scene)
        regions = [region_solid(region) for region in scene.regions]
        assert all(inside_walls(solid) for solid in [*bodies.values(), *regions])
        everything = list(bodies.items())
        for index, (name, solid) in enumerate(everything):
            assert not any(touch(solid, other) for _, other in everything[:index]), name
        for number, area in enumerate(regions):
            guests = {f"block {i}" for i, b in enumerate(scene.blocks) if scene.regions[number].contains(b)}
            assert not any(touch(area, other) for other in regions[:number])
            assert not any(touch(area, solid) for name, solid in everything if name not in guests)
            assert len(guests) == (task in ("FindDupe", "FixColour"))
        assert scene.robot.fingers == (c.FINGER_OPEN, -c.FINGER_OPEN)


def _aspects(scene: Scene) -> dict[str, object]:
    """The scene taken apart by what an axis may change."""
    return {
        "poses": (scene.robot.pose, [b.pose for b in scene.blocks], [replace(r, colour="red") for r in scene.regions]),
        "colour": ([b.colour for b in scene.blocks], [r.colour for r in scene.regions]),
        "shape": [b.shape for b in scene.blocks],
        "count": (len(scene.blocks), len(scene.regions)),
        "dynamics": scene.dynamics,
    }


@pytest.mark.parametrize(("task", "variant"), ENVIRONMENTS)
def test_a_variant_changes_what_it_declares_and_nothing_else(task: str, variant: str) -> None:
    axes: set[str] = set(environment_axes(task, variant))
    if axes & {"jitter", "layout"}:
        axes = axes - {"jitter", "layout"} | {"poses"}
    demo = _aspects(sample_scene(task, "Demo", 0))
    found = [_aspects(scene) for scene in scenes(task, variant, 12)]
    changed = {aspect for aspect in demo for scene in found if scene[aspect] != demo[aspect]}
    assert changed == axes


@pytest.mark.parametrize("task", TASKS)
def test_each_axis_has_random_numbers_of_its_own(task: str) -> None:
    """So the scene of All is that of the parts: a draw added to one axis never moves another."""
    for seed in range(5):
        everything = sample_scene(task, "All", seed)
        assert everything.dynamics == sample_scene(task, "Dynamics", seed).dynamics
        if (task, "CountPlus") in ENVIRONMENTS:
            assert replace(everything, dynamics=Dynamics()) == sample_scene(task, "CountPlus", seed)
    if task == "MoveToRegion":
        everything, coloured, laid_out = (sample_scene(task, name, 7) for name in ("All", "Colour", "Layout"))
        assert everything.regions[0] == replace(laid_out.regions[0], colour=coloured.regions[0].colour)
        assert everything.robot == laid_out.robot


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


@pytest.mark.parametrize(("task", "variant"), [pair for pair in ENVIRONMENTS if pair[1] in ("Layout", "All")])
def test_layout_uses_the_whole_workspace(task: str, variant: str) -> None:
    if "layout" not in environment_axes(task, variant):
        return
    found = scenes(task, variant, 300)
    poses = np.array([pose for scene in found for pose in (scene.robot.pose, *outer_poses(scene))])
    assert np.allclose(poses.mean(axis=0), 0, atol=0.25)
    assert np.all(poses.min(axis=0) < [-0.72, -0.72, -3.0])
    assert np.all(poses.max(axis=0) > [0.72, 0.72, 3.0])
    assert np.abs(poses[:, 2]).max() <= math.pi
    low, high = task_spec(task).region_size
    sizes = [size for scene in found for region in scene.regions for size in (region.width, region.height)]
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
    found = [scene.dynamics for scene in scenes("MakeLine", "Dynamics", 500)]
    for name, (low, high) in RANGES.items():
        values = np.array([getattr(dynamics, name) for dynamics in found])
        assert low <= values.min() < low + 0.02 * (high - low)
        assert high - 0.02 * (high - low) < values.max() <= high
        assert values.mean() == pytest.approx((low + high) / 2, abs=0.05 * (high - low))
        assert low < getattr(Dynamics(), name) < high


def assert_uniform(values: Iterable[Any], options: Iterable[Any]) -> None:
    """Each of the options occurs, nothing else does, and all about equally often (five standard deviations)."""
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
    found = scenes("MatchRegions", "Colour", 1000)
    assert_uniform(
        ((scene.regions[0].colour, *(b.colour for b in scene.blocks)) for scene in found),
        [
            ("red", "red", "red", "blue", "yellow", "yellow"),
            ("green", "green", "green", "blue", "yellow", "yellow"),
            ("blue", "blue", "blue", "green", "yellow", "yellow"),
            ("yellow", "yellow", "yellow", "green", "blue", "blue"),
        ],
    )


def test_find_dupe_may_have_further_duplicates_by_chance() -> None:
    found = scenes("FindDupe", "Shape", 1000)
    assert_uniform((scene.blocks[-1].shape for scene in found), SHAPES)
    duplicates = [
        sum((b.shape, b.colour) == (q.shape, q.colour) for b in others)
        for *others, q in (scene.blocks for scene in found)
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
    found = scenes(task, "CountPlus", 800)
    for place in (0, 6):
        assert_uniform((scene.blocks[place].colour for scene in found), COLOURS)
        assert_uniform((scene.blocks[place].shape for scene in found), SHAPES)


def test_scenes_are_the_same_in_another_process() -> None:
    code = (
        "from magical_mj.registry import ENVIRONMENTS, sample_scene\n"
        "import sys\n"
        "for pair in ENVIRONMENTS: sys.stdout.write(sample_scene(*pair, 11).to_json() + '\\n')"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "12345"}
    run = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert run.stdout.splitlines() == [sample_scene(*pair, 11).to_json() for pair in ENVIRONMENTS]


def test_seeds_may_have_any_size_and_integer_type() -> None:
    assert sample_scene("MakeLine", "All", np.uint8(7)) == sample_scene("MakeLine", "All", 7)  # type: ignore[arg-type]
    big = [2**32, 2**64, 10**40, 10**40 + 1]
    assert len({sample_scene("MakeLine", "All", seed) for seed in [0, 1, *big]}) == 6


@pytest.mark.parametrize("seed", [-1, 1.0, "7", None, True, [1]])
@pytest.mark.parametrize("variant", ["Demo", "All"])
def test_other_seeds_are_refused(seed: Any, variant: str) -> None:
    with pytest.raises(InvalidSeedError, match="is not a seed: seeds are the integers from 0 up"):
        sample_scene("MakeLine", variant, seed)


def test_variants_go_by_their_names_in_the_ids_too() -> None:
    assert [variant_name(f"Test{name}") for name in VARIANTS[1:]] == list(VARIANTS[1:])
    assert sample_scene("FindDupe", "TestAll", 3) == sample_scene("FindDupe", "All", 3)


@pytest.mark.parametrize(
    ("task", "variant", "message"),
    [
        ("FindDup", "All", r"unknown task 'FindDup'\. Did you mean 'FindDupe'\?"),
        ("FindDupe", "Jiter", r"unknown variant 'Jiter'\. Did you mean 'Jitter'\? There are: Demo, Jitter, Layout"),
        ("FindDupe", "TestDemo", r"unknown variant 'TestDemo'\. Did you mean 'Demo'\?"),
        ("FindDupe", None, "unknown variant None"),
        ("MoveToRegion", "Shape", "no variant 'Shape', for its shape cannot vary. It has: Demo, Jitter, Layout, Col"),
        ("MoveToCorner", "TestCountPlus", "no variant 'CountPlus', for its layout and count cannot vary. It has: Demo"),
    ],
)
def test_what_does_not_exist_is_refused_with_what_does(task: str, variant: Any, message: str) -> None:
    with pytest.raises(UnknownNameError, match=message):
        sample_scene(task, variant, 0)


def test_shapes_that_do_not_fit_the_demo_poses_are_drawn_again() -> None:
    """In ClusterColour two neighbours cannot both be stars, in ClusterShape a square would be in the wall."""
    assert_uniform((scene.blocks[4].shape for scene in scenes("ClusterShape", "Shape", 600)), set(SHAPES) - {"square"})
    pairs = {(scene.blocks[2].shape, scene.blocks[5].shape) for scene in scenes("ClusterColour", "Shape", 300)}
    assert pairs == {(a, b) for a in SHAPES for b in SHAPES} - {("star", "star"), ("star", "pentagon")}


def test_a_placement_that_cannot_be_gives_up_and_names_remedies() -> None:
    crowded = replace(task_spec("FixColour"), region_size=(1.2, 1.3))
    with pytest.raises(PlacementError, match=r"found no room for GoalRegion.*Use fewer blocks, fewer or smaller reg"):
        vary(crowded, "Layout", 0)
