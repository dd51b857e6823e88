"""Driving in the imagination: along a way, in closed loop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from magical_mj import constants as c
from magical_mj.actions import Drive, Gripper, Turn
from magical_mj.experts.imagination import Imagination
from magical_mj.experts.navigation import TURN_STEP
from magical_mj.scene import Pose

CHOICES: Final = tuple((turn, drive) for turn in Turn for drive in Drive)
AHEAD: Final = 3  # actions that a choice is judged after
LOOK_BACK: Final = 6  # poses of the way among which the nearest is sought
ARM: Final = 0.2  # world units that an error of a radian counts as
SPEED_GAIN: Final = {Gripper.OPEN: 0.27, Gripper.CLOSE: 0.27}  # units/s per action
NEAR: Final = 0.03  # world units, the end of a way
PATIENCE: Final = 6  # actions more than expected

_SPEED: Final = {Drive.NONE: 0.0, Drive.FORWARD: c.SPEED_FORWARD, Drive.BACK: -c.SPEED_BACKWARD}
_SPIN: Final = {Turn.NONE: 0.0, Turn.LEFT: TURN_STEP, Turn.RIGHT: -TURN_STEP}


def wrapped(angle: float) -> float:
    """The angle in [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def distance(one: Pose, other: Pose) -> float:
    """How far two poses are from each other."""
    return math.hypot(one[0] - other[0], one[1] - other[1]) + ARM * abs(wrapped(one[2] - other[2]))


def predict(pose: Pose, speed: float, turn: Turn, drive: Drive, gain: float) -> Pose:
    """Where the robot is after `AHEAD` actions of the same kind."""
    x, y, angle = pose
    for _ in range(AHEAD):
        speed += max(-gain, min(gain, _SPEED[drive] - speed))
        middle, step = angle + _SPIN[turn] / 2, speed / c.CONTROL_RATE
        x, y, angle = x - step * math.sin(middle), y + step * math.cos(middle), angle + _SPIN[turn]
    return x, y, angle


def follow(world: Imagination, way: Sequence[Pose], gripper: Gripper, limit: int) -> bool:
    """Drive along a way; whether its end was reached."""
    passed, last = 0, len(way) - 1
    for _ in range(min(limit, len(way) + len(way) // 2 + PATIENCE)):
        pose, (speed, _) = world.robot, world.speed
        window = range(passed, min(passed + LOOK_BACK, last) + 1)
        passed = min(window, key=lambda index: distance(pose, way[index]))
        if passed == last and distance(pose, way[last]) < NEAR:
            return True
        aim = way[min(passed + AHEAD, last)]
        turn, drive = min(CHOICES, key=lambda choice: distance(predict(pose, speed, *choice, SPEED_GAIN[gripper]), aim))
        if passed == last and (turn, drive) == (Turn.NONE, Drive.NONE):
            return distance(pose, way[last]) < 3 * NEAR
        world.act(gripper, turn, drive)
    return distance(world.robot, way[last]) < 3 * NEAR
