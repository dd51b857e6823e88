"""Invariants of all sampled scenes in all 60 environments, and invalid arguments."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from magical_mj.scene import Block, Dynamics, GoalRegion, Robot, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.geometry import check_scene, inside_walls, region_solid, solids, touch
from magical_mj.tasks.registry import (
    ENVIRONMENTS,
    TASKS,
    VARIANTS,
    environment_axes,
    sample_scene,
    task_spec,
    variant_name,
)
from magical_mj.utils.errors import InvalidSeedError, PlacementError, UnknownNameError
from magical_mj.variants import placement, vary

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
"""The paper's table of environments, written by hand. It is the only copy."""


def scenes(task: str, variant: str, number: int) -> list[Scene]:
    return [sample_scene(task, variant, seed) for seed in range(number)]


def test_the_first_environments_are_those_of_the_paper() -> None:
    rows = [line.split() for line in TABLE.strip().splitlines()]
    pairs = [(row[0], variant) for row in rows for variant in row[1:] if variant != "-"]
    assert [row[0] for row in rows] == list(TASKS[: len(rows)])
    assert pairs == list(ENVIRONMENTS[: len(pairs)])
    assert len(pairs) == 60


@pytest.mark.parametrize("task", TASKS)
def test_every_scene_is_legal_and_of_its_task(task: str) -> None:
    """All inside the walls, without contacts. Only blocks that belong in a region touch one, and only that one."""
    demo = task_spec(task).demo
    belong = any(region.contains(block) for region in demo.regions for block in demo.blocks)
    for scene in (scene for name, variant in ENVIRONMENTS if name == task for scene in scenes(task, variant, 30)):
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
            assert bool(guests) == belong
        assert scene.robot.fingers == (c.FINGER_OPEN, -c.FINGER_OPEN)


def _aspects(scene: Scene) -> dict[str, object]:
    """The parts of a scene that the axes change."""
    return {
        "poses": (scene.robot.pose, [b.pose for b in scene.blocks], [replace(r, colour="red") for r in scene.regions]),
        "colour": ([b.colour for b in scene.blocks], [r.colour for r in scene.regions]),
        "shape": [b.shape for b in scene.blocks],
        "count": (len(scene.blocks), len(scene.regions)),
        "dynamics": scene.dynamics,
    }


def test_a_variant_changes_what_it_declares_and_nothing_else() -> None:
    for task, variant in ENVIRONMENTS:
        axes: set[str] = set(environment_axes(task, variant))
        if axes & {"jitter", "layout"}:
            axes = axes - {"jitter", "layout"} | {"poses"}
        demo = _aspects(sample_scene(task, "Demo", 0))
        varied = [_aspects(scene) for scene in scenes(task, variant, 12)]
        changed = {aspect for aspect in demo for scene in varied if scene[aspect] != demo[aspect]}
        assert changed == axes, (task, variant)


@pytest.mark.parametrize("task", TASKS)
def test_each_axis_has_random_numbers_of_its_own(task: str) -> None:
    """So the scene of All consists of the scenes of its axes. Another draw in one axis never changes the others."""
    for seed in range(5):
        everything = sample_scene(task, "All", seed)
        assert everything.dynamics == sample_scene(task, "Dynamics", seed).dynamics
        if (task, "CountPlus") in ENVIRONMENTS:
            assert replace(everything, dynamics=Dynamics()) == sample_scene(task, "CountPlus", seed)
    if task == "MoveToRegion":
        everything, coloured, laid_out = (sample_scene(task, name, 7) for name in ("All", "Colour", "Layout"))
        assert everything.regions[0] == replace(laid_out.regions[0], colour=coloured.regions[0].colour)
        assert everything.robot == laid_out.robot


def test_seeds_may_have_any_size_and_integer_type() -> None:
    assert sample_scene("MakeLine", "All", np.uint8(7)) == sample_scene("MakeLine", "All", 7)  # type: ignore[arg-type]
    big = [2**32, 2**64, 10**40, 10**40 + 1]
    assert len({sample_scene("MakeLine", "All", seed) for seed in [0, 1, *big]}) == 6


@pytest.mark.parametrize("seed", [-1, 1.0, "7", None, True, [1]])
def test_other_seeds_are_refused(seed: Any) -> None:
    for variant in ("Demo", "All"):
        with pytest.raises(InvalidSeedError, match="seeds are integers"):
            sample_scene("MakeLine", variant, seed)


def test_variants_go_by_their_names_in_the_ids_too() -> None:
    assert [variant_name(f"Test{name}") for name in VARIANTS[1:]] == list(VARIANTS[1:])
    assert sample_scene("FindDupe", "TestAll", 3) == sample_scene("FindDupe", "All", 3)


@pytest.mark.parametrize(
    ("task", "variant", "word"),
    [
        ("FindDup", "All", "FindDupe"),
        ("FindDupe", "Jiter", "Jitter"),
        ("FindDupe", "TestDemo", "Demo"),
        ("FindDupe", None, "None"),
        ("MoveToRegion", "Shape", "its shape cannot vary"),
        ("MoveToCorner", "TestCountPlus", "layout and count"),
    ],
)
def test_unknown_environments_are_refused_with_the_known_ones(task: str, variant: Any, word: str) -> None:
    with pytest.raises(UnknownNameError, match=word):
        sample_scene(task, variant, 0)


def test_a_placement_that_cannot_be_gives_up_and_names_remedies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(placement, "MAX_TRIES", 100)
    crowded = replace(task_spec("FixColour"), region_size=(0.4, 1.9))
    with pytest.raises(PlacementError, match="no room for GoalRegion"):
        vary(crowded, "Layout", 0)


def test_scenes_that_a_task_does_not_accept_are_drawn_again() -> None:
    spec = task_spec("MoveToRegion")
    choosy = replace(spec, accepts=lambda scene: scene.robot.x > 0)
    for variant in ("Layout", "All"):
        plain, accepted = ([vary(rules, variant, seed) for seed in range(20)] for rules in (spec, choosy))
        assert all(scene.robot.x > 0 for scene in accepted)
        assert any(scene.robot.x <= 0 for scene in plain)
        assert [scene for scene in plain if scene.robot.x > 0] == [
            again for scene, again in zip(plain, accepted, strict=True) if scene == again
        ]


def test_a_task_that_accepts_no_scene_is_an_error() -> None:
    with pytest.raises(PlacementError, match="none of 300 scenes of MoveToRegion-Jitter with seed 4"):
        vary(replace(task_spec("MoveToRegion"), accepts=lambda _: False), "Jitter", 4)


@pytest.mark.parametrize("border", ["solid", "dashed"])
def test_a_longer_body_is_moved_out_of_regions_and_zones(border: Any) -> None:
    robot, block = Robot(0, 0, 0, body="longstick"), Block("square", "red", -0.3, 0, 0)
    region = GoalRegion("red", 0.18, -1, 1, 1, border)
    moved = placement.with_room(Scene(robot, (block,), (region,)))
    assert moved.robot != robot
    assert not any(touch(solids(moved)["robot"], other) for other in (solids(moved)["block 0"], region_solid(region)))
    assert placement.contact(moved) is None
