"""Driving like a person with a keyboard: turn towards a point, drive there, and correct the heading on the way.

The actions depend mostly on the point's position in the robot's frame, so that a learner can recover the rule.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from magical_mj.policies.expert.lookahead import Lookahead
from magical_mj.scene.actions import Drive, Gripper, Turn

Point = tuple[float, float]

AIM: Final = 0.19  # rad; one action turns by 0.31, so that smaller errors cannot be corrected
FACE: Final = 0.6  # rad; with a larger error the robot turns without driving
BEHIND: Final = 1.1  # rad; with a larger error a robot that carries a block drives back while it turns
BRAKING: Final = 2.4  # units/s^2
VIA: Final = 0.12  # world units: intermediate points count as reached within this distance
EITHER: Final = 0.6  # rad: to points this close to straight behind, the robot always turns right
NEAR: Final = 0.3  # world units: to points this close behind it, the robot drives back instead of turning around
STUCK, FREED = 3, 7  # actions without progress after which the robot drives back, and then tries again
PATIENCE: Final = 12  # and gives up
PROGRESS: Final = 0.01  # world units or radians


def steer(
    lookahead: Lookahead, point: Point, ahead: float, gripper: Gripper, *, reverse: bool
) -> tuple[Gripper, Turn, Drive]:
    """The next action towards the pose in which a point is straight ahead of the robot at a given distance.

    Args:
        lookahead: the copy of the simulation.
        point: x, y in world units.
        ahead: the desired distance of the point ahead of the robot's centre.
        gripper: the command for the fingers.
        reverse: turn while driving back if the point is far to the side.
    """
    right, forward = lookahead.relative(point)
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
    lookahead: Lookahead,
    route: Sequence[Point],
    gripper: Gripper,
    limit: int,
    *,
    ahead: float = 0.0,
    within: float,
    reverse: bool = False,
) -> bool:
    """Drives along a route until its last point is straight ahead at the given distance; returns whether it is.

    Args:
        lookahead: the copy of the simulation.
        route: points in world units.
        gripper: the command for the fingers.
        limit: the number of actions after which to give up.
        ahead: the desired distance of the points ahead of the robot's centre.
        within: the tolerance (world units) at the end, when the robot is at rest.
        reverse: see `steer`.
    """
    return all(
        _drive(lookahead, point, gripper, limit, ahead, within if point is route[-1] else VIA, reverse)
        for point in route
    )


def _drive(
    lookahead: Lookahead, point: Point, gripper: Gripper, limit: int, ahead: float, within: float, reverse: bool
) -> bool:
    patience = Patience()
    while True:
        right, forward = lookahead.relative(point)
        speed = lookahead.speed[0]
        gap = math.hypot(right, forward - ahead - speed * abs(speed) / (2 * BRAKING))
        if gap < within:
            return True
        bearing = math.atan2(-right, forward)
        if patience.ends(gap + 0.3 * abs(bearing)) or len(lookahead.trace) >= limit:
            return False
        if patience.stuck:
            lookahead.act(gripper, Turn.NONE, Drive.BACK)
        else:
            lookahead.act(*steer(lookahead, point, ahead, gripper, reverse=reverse))


class Patience:
    """Counts the actions without progress: after a few the robot should free itself, after more it should give up."""

    def __init__(self) -> None:
        self._least, self._waited = math.inf, 0

    def ends(self, left: float) -> bool:
        """Whether to give up; `left` is the remaining distance."""
        self._waited = 0 if left < self._least - PROGRESS else self._waited + 1
        self._least = min(self._least, left)
        return self._waited > PATIENCE

    @property
    def stuck(self) -> bool:
        """Whether to back up."""
        return STUCK <= self._waited < FREED
