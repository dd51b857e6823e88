"""The indices of a scene's coordinates in MuJoCo's vectors."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from magical_mj.assets.mjcf import AXES
from magical_mj.assets.robot import actuators, controls
from magical_mj.assets.scene_mjcf import scene_mjcf
from magical_mj.assets.scene_model import FINGERS, own_coordinates
from magical_mj.scene import Block, Pebble, Robot, Scene
from magical_mj.scene.bodies import BODIES, body_named


@pytest.mark.parametrize("body", BODIES)
def test_the_order_of_a_models_coordinates_is_that_of_its_names(body: str) -> None:
    blocks = (Block("star", "red", 0.5, 0.5, 1), Block("circle", "blue", -0.5, 0.5, 0))
    scene = Scene(Robot(0, 0, 0, body=body), blocks, pebbles=(Pebble(0.5, -0.5), Pebble(-0.5, -0.5)))
    model = mujoco.MjModel.from_xml_string(scene_mjcf(scene))
    found = own_coordinates(len(blocks), body, 2)

    def rows(addresses: str, bodies: list[str]) -> list[list[int]]:
        return [[getattr(model.joint(f"{name}_{axis}"), addresses)[0] for axis in AXES] for name in bodies]

    bodies = ["robot", "block0", "block1"]
    np.testing.assert_array_equal(found.qpos, rows("qposadr", bodies))
    np.testing.assert_array_equal(found.qvel, rows("dofadr", bodies))
    np.testing.assert_array_equal(found.pebbles, rows("qposadr", ["pebble0", "pebble1"]))
    fingers = FINGERS if body_named(body).fingers else ()
    np.testing.assert_array_equal(found.fingers, [model.joint(name).qposadr[0] for name in fingers])
    assert [model.actuator(int(index)).name for index in found.ctrl] == list(actuators(body))
    assert len(found.ctrl) == model.nu == len(controls(body)[0])
