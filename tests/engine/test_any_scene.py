"""Any scene that is legal can be drawn, observed, exported and written as JSON, however odd; or says why not."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

import magical_mj
from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.geometry import check_scene
from magical_mj.scene.state_vector import CAMERAS, MAX_BLOCKS, MAX_REGIONS
from magical_mj.utils.errors import InvalidSceneError

PLACES = [
    (x, y)
    for x in np.linspace(-0.8, 0.8, 6)
    for y in np.linspace(-0.8, 0.8, 6)
    if math.dist((x, y), (-0.7, -0.7)) > 0.55
]
COUNTS = [(0, 0), (0, 30), (30, 0), (30, 30), (3, 4), (10, 3), (11, 3), (1, 4)]


def random_scene(rng: np.random.Generator, blocks: int, regions: int) -> Scene:
    """A legal scene: blocks on a grid beside the robot, and regions of all sizes anywhere."""
    places = rng.permutation(PLACES)[:blocks].tolist()
    robot = Robot(-0.7, -0.7, float(rng.uniform(-0.2, 0.2)), (float(rng.uniform(0, 0.1)), 0.0))
    return Scene(
        robot,
        tuple(
            Block(str(rng.choice(c.SHAPES)), str(rng.choice(c.COLOURS)), x, y, float(rng.uniform(-9, 9)))  # type: ignore[arg-type]
            for x, y in places
        ),
        tuple(random_region(rng) for _ in range(regions)),
    )


def random_region(rng: np.random.Generator) -> GoalRegion:
    width, height = 2 * 10 ** rng.uniform(-4, 0, size=2)
    x, y = rng.uniform(-1, 1 - width), rng.uniform(-1, 1 - height)
    return GoalRegion(str(rng.choice(c.COLOURS)), x, y, x + width, y + height)  # type: ignore[arg-type]


@pytest.mark.parametrize("number", range(16))
def test_a_legal_scene_can_be_drawn_observed_exported_and_written(number: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(number)
    counts = COUNTS[number] if number < len(COUNTS) else tuple(rng.integers(31, size=2).tolist())
    scene = random_scene(rng, *counts)
    check_scene(scene)
    assert Scene.from_json(scene.to_json()) == scene

    env = magical_mj.Engine.of_scene(scene)
    for view in CAMERAS:
        assert len(np.unique(env.render(view, 64).reshape(-1, 3), axis=0)) > 3

    model = mujoco.MjModel.from_xml_path(str(magical_mj.export_mjcf(env, tmp_path / "model.xml")))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    env.step(0)
    controls = model.numeric("controls").data.reshape(18, 6)
    data.ctrl[:] = controls[0]
    mujoco.mj_step(model, data, 10)
    np.testing.assert_array_equal(data.qpos, env.data.qpos)
    env.close()

    if len(scene.blocks) <= MAX_BLOCKS and len(scene.regions) <= MAX_REGIONS:
        assert np.isfinite(magical_mj.Engine.of_scene(scene).state_vector()).all()
    else:
        with pytest.raises(InvalidSceneError, match="use pictures as observations"):
            magical_mj.Engine.of_scene(scene).state_vector()


def test_scenes_of_any_size_take_turns_in_one_environment() -> None:
    """Each is drawn as it is drawn alone, whatever was drawn before."""
    rng = np.random.default_rng(0)
    scenes = [random_scene(rng, *counts) for counts in [*COUNTS, (2, 9), (2, 1)]]
    alone = []
    for scene in scenes:
        env = magical_mj.Engine.of_scene(scene)
        env.reset()
        alone.append(env.render("allo", 64))
        env.close()
    env = magical_mj.Engine.of_scene(scenes[0])
    for index in rng.integers(len(scenes), size=30).tolist():
        env.reset(scene=scenes[index])
        np.testing.assert_array_equal(env.render("allo", 64), alone[index])
    env.close()
