"""The indices of a scene's coordinates and controls in MuJoCo's vectors `qpos`, `qvel` and `ctrl`.

Models that this package compiles list them in one order, and demonstrations are recorded in that order. Users may add
joints and actuators to the model of a composer environment. There, indices are looked up by name.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.mjcf import AXES, index_of, planar_name
from magical_mj.assets.robot import actuators, joints
from magical_mj.scene.bodies import GRIPPER, body_named

Indices = NDArray[np.int64]

FINGERS: Final = ("left_finger", "right_finger")


class Coordinates(NamedTuple):
    """Indices into MuJoCo's vectors."""

    qpos: Indices
    """x, y and angle of the robot, and then of each block. Shape (1 + blocks, 3)."""
    qvel: Indices
    """Velocities of the same coordinates. Shape (1 + blocks, 3)."""
    fingers: Indices
    """Indices into `qpos`: the left and the right finger. Shape (2,), without fingers (0,)."""
    pebbles: Indices
    """Indices into `qpos`: x, y and angle of each pebble. Shape (pebbles, 3)."""
    ctrl: Indices
    """The robot's actuators. Shape (6,), without fingers (4,)."""


@lru_cache(64)
def own_coordinates(blocks: int, body: str = GRIPPER, pebbles: int = 0) -> Coordinates:
    """The coordinates in a model that this package compiles.

    Args:
        blocks: the number of blocks.
        body: the robot's body.
        pebbles: the number of pebbles.
    """
    robot = len(AXES) * blocks
    first, order = robot + len(joints(body)), joints(body)
    planar = np.arange(len(AXES)) + np.array([robot, *range(0, robot, len(AXES))])[:, None]
    fingers = [robot + order.index(name) for name in FINGERS] if body_named(body).fingers else []
    grit = np.arange(first, first + len(AXES) * pebbles).reshape(-1, len(AXES))
    return Coordinates(planar, planar, np.array(fingers, np.int64), grit, np.arange(len(actuators(body))))


def find_coordinates(model: mujoco.MjModel, blocks: int, body: str = GRIPPER, pebbles: int = 0) -> Coordinates:
    """The coordinates in the model of a composer environment, which may contain more than the scene.

    Raises:
        SettingsError: if the model lacks a joint or an actuator of the scene.
    """

    def find(*names: str, kind: str = "joint") -> Indices:
        return np.array([index_of(model, kind, name) for name in names], np.int64)

    def planar(*bodies: str) -> Indices:
        names = (planar_name(f"{body}_{axis}", f"{body}/") for body in bodies for axis in AXES)
        return find(*names).reshape(-1, len(AXES))

    moving = planar("robot", *(f"block{index}" for index in range(blocks)))
    fingers = find(*(f"robot/{name}" for name in FINGERS if body_named(body).fingers))
    grit = planar(*(f"pebble{index}" for index in range(pebbles)))
    return Coordinates(
        model.jnt_qposadr[moving].astype(np.int64),
        model.jnt_dofadr[moving].astype(np.int64),
        model.jnt_qposadr[fingers].astype(np.int64),
        model.jnt_qposadr[grit].astype(np.int64),
        find(*(f"robot/{name}" for name in actuators(body)), kind="actuator"),
    )
