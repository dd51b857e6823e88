"""Driving as a person with a keyboard would: turn towards a point, drive there, and correct the heading on the way.

What is done depends on where the point is in the robot's frame and on little else, so that a learner can find the
rule again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from magical_mj.actions import Drive, Gripper, Turn
from magical_mj.experts.lookahead import Lookahead

Point = tuple[float, float]

AIM: Final = 0.19  # rad; one action turns by 0.31, so that smaller errors would only be turned into their opposites
FACE: Final = 0.6  # rad, so far off the robot does not drive on while it turns
BEHIND: Final = 1.1  # rad, so far off a robot that carries a block turns while it drives back
BRAKING: Final = 2.4  # units/s^2
VIA: Final = 0.12  # world units: so near the points on the way are passed
EITHER: Final = 0.6  # rad: so near to right behind the robot turns to the right, whichever way is shorter
NEAR: Final = 0.3  # world units: to points so near behind it the robot backs up rather than turns round
STUCK, FREED = 3, 7  # actions without progress after which the robot backs up, and tries again
PATIENCE: Final = 12  # and gives up
PROGRESS: Final = 0.01  # world units or radians


def steer(
    world: Lookahead, point: Point, ahead: float, gripper: Gripper, *, reverse: bool
) -> tuple[Gripper, Turn, Drive]:
    """The action that brings a point to its place ahead of the robot.

    Args:
        world: where the robot is.
        point: in world units.
        ahead: how far ahead of the robot it shall be.
        gripper: what the fingers do meanwhile.
        reverse: turn while driving back if the point is far to the side.
    """
    right, forward = world.relative(point)
    bearing = math.atan2(-right, forward)
    turn = Turn.NONE if abs(bearing) <= AIM else Turn.LEFT if 0 < bearing < math.pi - EITHER else Turn.RIGHT
    if abs(bearing) > BEHIND and reverse:
        return gripper, turn, Drive.BACK
    if abs(bearing) > math.pi - FACE and math.hypot(right, forward) < NEAR:
        return gripper, Turn.NONE, Drive.BACK
    if abs(bearing) > FACE:
        return gripper, turn, Drive.NONE
    if forward > ahead:
        return gripper, turn, Drive.FORWARD
    return gripper, turn, Drive.NONE if turn else Drive.BACK


def drive(
    world: Lookahead,
    route: Sequence[Point],
    gripper: Gripper,
    limit: int,
    *,
    ahead: float = 0.0,
    within: float,
    reverse: bool = False,
) -> bool:
    """Drive past the points of a route until the last one is where it shall be; whether it is.

    Args:
        world: where to drive.
        route: points in world units.
        gripper: what the fingers do meanwhile.
        limit: the number of actions at which to give up.
        ahead: how far ahead of the robot the points shall be.
        within: how near that must be met in the end, once the robot is at rest.
        reverse: see `steer`.
    """
    return all(
        _drive(world, point, gripper, limit, ahead, within if point is route[-1] else VIA, reverse) for point in route
    )


def _drive(
    world: Lookahead, point: Point, gripper: Gripper, limit: int, ahead: float, within: float, reverse: bool
) -> bool:
    patience = Patience()
    while True:
        right, forward = world.relative(point)
        speed = world.speed[0]
        gap = math.hypot(right, forward - ahead - speed * abs(speed) / (2 * BRAKING))
        if gap < within:
            return True
        bearing = math.atan2(-right, forward)
        if patience.ends(gap + 0.3 * abs(bearing)) or len(world.trace) >= limit:
            return False
        if patience.stuck:
            world.act(gripper, Turn.NONE, Drive.BACK)
        else:
            world.act(*steer(world, point, ahead, gripper, reverse=reverse))


class Patience:
    """Counts the actions without progress: after a few the robot should free itself, after more it should give up."""

    def __init__(self) -> None:
        self._least, self._waited = math.inf, 0

    def ends(self, left: float) -> bool:
        """Whether to give up, with so much left to do."""
        self._waited = 0 if left < self._least - PROGRESS else self._waited + 1
        self._least = min(self._least, left)
        return self._waited > PATIENCE

    @property
    def stuck(self) -> bool:
        """Whether to back up."""
        return STUCK <= self._waited < FREED
