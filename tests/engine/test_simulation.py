"""Compiled models: a model rewritten for another scene equals one compiled from that scene, to the bit."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import pytest

import magical_mj
from magical_mj.assets.region import DASHES, dash_count
from magical_mj.assets.scene_mjcf import scene_mjcf
from magical_mj.assets.scene_model import SceneModel, rewrite_region, scene_spec
from magical_mj.engine.simulation import Simulation
from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.tasks.registry import task_spec
from magical_mj.variants.placement import jitter
from tests.helpers.environments import TWO_EACH


def arrays(parts: object) -> Iterator[tuple[str, Any]]:
    """Every number and array of a MuJoCo structure and of its nested structures."""
    for name in dir(parts):
        if name.startswith("_"):
            continue
        try:
            value = getattr(parts, name)
        except (AttributeError, ValueError):  # not available in this version
            continue
        if isinstance(value, np.ndarray | int | float | bytes):
            yield name, value
        elif type(value).__module__.startswith("mujoco") and not callable(value):
            yield from ((f"{name}.{part}", inner) for part, inner in arrays(value))


def assert_same_model(model: mujoco.MjModel, other: mujoco.MjModel) -> None:
    fields, wanted = dict(arrays(model)), dict(arrays(other))
    assert fields.keys() == wanted.keys()
    assert {"body_pos", "skin_vert", "dof_invweight0", "stat.meaninertia", "opt.timestep"} <= fields.keys()
    for name, value in fields.items():
        if name.startswith("stat."):  # only used by viewers
            np.testing.assert_allclose(value, wanted[name], rtol=1e-12, err_msg=name)
        else:
            np.testing.assert_array_equal(value, wanted[name], err_msg=name)


def repeats(task: str, variant: str) -> list[tuple[SceneModel, SceneModel]]:
    """Two pairs of scenes of the environment that differ but have the same structure."""
    scenes = [magical_mj.sample_scene(task, variant, seed) for seed in range(8)]
    size = task_spec(task).region_size
    moved = jitter(scenes[0], np.random.default_rng(0), size)  # if no two scenes have the same structure
    models = [SceneModel(scene) for scene in dict.fromkeys((scenes[0], moved, *scenes))]
    pairs = ((a, b) for a, b in itertools.permutations(models, 2) if a.structure == b.structure)
    return list(itertools.islice(pairs, 2))


def test_rewriting_equals_compiling() -> None:
    for task, variant in TWO_EACH:
        pairs = repeats(task, variant)
        assert len(pairs) == 2
        for before, after in pairs:
            used, fresh = Simulation.of(before.scene), mujoco.MjModel.from_xml_string(scene_mjcf(after.scene))
            for _ in range(3):
                used.act(10)  # earlier steps must not matter
            model = used.model
            used.start(after.scene)
            assert used.model is model
            assert_same_model(used.model, fresh)


def test_rewriting_changes_everything_that_a_scene_holds() -> None:
    """Two scenes differ in every number of their blocks, regions, dynamics and fingers."""
    first = magical_mj.sample_scene("MatchRegions", "Colour", 0)
    dynamics = magical_mj.sample_scene("MatchRegions", "Dynamics", 0).dynamics
    other = Scene(
        Robot(-0.7, 0.6, 2.5, fingers=(0.3, -0.1)),
        tuple(Block(b.shape, "yellow", b.x / 2, b.y / 2 - 0.3, b.angle + 1) for b in first.blocks),
        (GoalRegion("green", -0.9, -0.1, -0.2, 0.6),),
        dynamics,
    )
    used = Simulation.of(first)
    SceneModel(other).rewrite(used.model, used.data)
    assert_same_model(used.model, mujoco.MjModel.from_xml_string(scene_mjcf(other)))


def test_regions_that_outgrow_a_model_are_not_squeezed_in() -> None:
    small, large = GoalRegion("red", -0.3, -0.3, 0.3, 0.3), GoalRegion("red", -1.0, -1.0, 1.0, 1.0)
    assert dash_count(small) == DASHES < dash_count(large)
    models = [SceneModel(Scene(Robot(0, 0, 0), regions=(region,))) for region in (small, large)]
    assert models[0].structure != models[1].structure
    with pytest.raises(ValueError, match="broadcast"):
        rewrite_region(Simulation.of(models[0].scene).model, 0, large)


def test_a_spec_that_was_changed_leaves_the_next_one_as_it_should_be() -> None:
    model = SceneModel(magical_mj.sample_scene("FixColour", "All", 3))
    changed = scene_spec(model.structure)
    changed.worldbody.add_site()
    block = changed.body("block0")
    block.first_body().add_geom(size=[0.1] * 3)
    block.first_geom().meshname = "star_fill"
    fresh = mujoco.MjModel.from_xml_string(scene_mjcf(model.scene))
    assert changed.compile().ngeom == fresh.ngeom + 1
    assert_same_model(Simulation.of(model.scene).model, fresh)
