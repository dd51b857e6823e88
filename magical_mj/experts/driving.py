"""Driving along a path, in closed loop, in the copy of the simulation."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from magical_mj import constants as c
from magical_mj.actions import Drive, Gripper, Turn
from magical_mj.experts.lookahead import Lookahead
from magical_mj.scene import Pose

ARM: Final = 0.2  # world units that an error of a radian counts as
NEAR: Final = 0.03  # world units from the end of a way: there
CLOSE: Final = 0.09  # near enough when time is up
LOOK_AHEAD: Final = 5  # poses of the way among which the nearest is sought
PATIENCE: Final = 6  # actions more than expected
STEP: Final = 1 / c.CONTROL_RATE
GAIN: Final = 0.3  # units/s that the robot gains in an action
SPIN_LAG: Final = 0.045  # s

_CHOICES: Final = tuple(itertools.product(Turn, Drive))
_PAIRS: Final = tuple(itertools.product(_CHOICES, _CHOICES))
_SPEED: Final = {Drive.NONE: 0.0, Drive.FORWARD: c.SPEED_FORWARD, Drive.BACK: -c.SPEED_BACKWARD}
_SPIN: Final = {Turn.NONE: 0.0, Turn.LEFT: c.SPEED_TURN, Turn.RIGHT: -c.SPEED_TURN}
_SPINS: Final = np.array([[_SPIN[turn] for turn, _ in pair] for pair in _PAIRS]).T
_SPEEDS: Final = np.array([[_SPEED[drive] for _, drive in pair] for pair in _PAIRS]).T
"""What all pairs of choices command. Shape (2, 81)."""


def follow(world: Lookahead, way: Sequence[Pose], gripper: Gripper, limit: int) -> bool:
    """Drive along a way; whether its end was reached.

    At every step all pairs of actions are compared, the second one held for two steps.
    """
    if len(way) < 2:
        return True
    poses, passed, last = np.array(way), 0, len(way) - 1
    for _ in range(min(limit, len(way) + len(way) // 2 + PATIENCE)):
        here = np.array(world.robot)
        ahead = poses[passed : passed + LOOK_AHEAD]
        distances = np.hypot(*(ahead[:, :2] - here[:2]).T) + ARM * np.abs(ahead[:, 2] - here[2])
        nearest = int(distances.argmin())
        passed += nearest
        if passed == last and distances[nearest] < NEAR:
            return True
        aims = poses[np.minimum(passed + np.arange(1, 4), last)]
        turn, drive = _choose(world.robot, world.speed, aims)
        world.act(gripper, turn, drive)
    x, y, angle = world.robot
    return math.hypot(x - way[-1][0], y - way[-1][1]) + ARM * abs(angle - way[-1][2]) < CLOSE


def _choose(pose: Pose, speeds: tuple[float, float], aims: np.ndarray) -> tuple[Turn, Drive]:
    """The first of the two choices that bring the robot nearest to the next three poses of the way."""
    x, y, angle = (np.full(len(_PAIRS), value) for value in pose)
    speed, spin = (np.full(len(_PAIRS), value) for value in speeds)
    cost = np.zeros(len(_PAIRS))
    for number, (aim_x, aim_y, aim_angle) in enumerate(aims.tolist()):
        which = min(number, 1)
        turned = _SPINS[which] * STEP + (spin - _SPINS[which]) * SPIN_LAG
        change = np.clip(_SPEEDS[which] - speed, -GAIN, GAIN)
        advance = (speed + change / 2) * STEP
        middle = angle + turned / 2
        x, y, angle = x - advance * np.sin(middle), y + advance * np.cos(middle), angle + turned
        speed, spin = speed + change, _SPINS[which]
        cost += np.hypot(x - aim_x, y - aim_y) + ARM * np.abs(angle - aim_angle)
    return _PAIRS[int(cost.argmin())][0]
