"""The 18 discrete actions: gripper (open, close) x turn (none, left, right) x drive (none, forward, back).

The number of an action is ``9 * gripper + 3 * turn + drive``, as in the original (Toyer et al. 2020,
section 3 "Action space").
"""

from __future__ import annotations

import itertools
import operator
from enum import IntEnum
from typing import Any, Final, NamedTuple

import numpy as np

from magical_mj.errors import InvalidActionError


class Gripper(IntEnum):
    """What the two fingers are driven to."""

    OPEN = 0
    CLOSE = 1


class Turn(IntEnum):
    """Which way the robot turns; left is counter-clockwise."""

    NONE = 0
    LEFT = 1
    RIGHT = 2


class Drive(IntEnum):
    """Which way the robot drives along its heading."""

    NONE = 0
    FORWARD = 1
    BACK = 2


class Action(NamedTuple):
    """One of the 18 actions as a triple; ``int(...)`` of it is meaningless, use :attr:`number`."""

    gripper: Gripper = Gripper.OPEN
    turn: Turn = Turn.NONE
    drive: Drive = Drive.NONE

    @property
    def number(self) -> int:
        """The action's number in 0..17."""
        return 9 * self.gripper + 3 * self.turn + self.drive

    @property
    def name(self) -> str:
        """A readable name such as ``"close-left-forward"`` or ``"open-none-none"``."""
        return "-".join(part.name.lower() for part in self)


ACTIONS: Final[tuple[Action, ...]] = tuple(Action(*parts) for parts in itertools.product(Gripper, Turn, Drive))
"""All actions; ``ACTIONS[n].number == n``."""

NOOP: Final = Action().number
"""The action that does nothing: the gripper is open at the start and stays so."""


def action_number(action: Any) -> int:
    """`action` as an int in 0..17.

    Takes ints, numpy integers, 0-d integer arrays and :class:`Action` triples.

    Raises:
        InvalidActionError: for anything else, such as 18, 1.5 or None.
    """
    if isinstance(action, Action):
        return action.number
    try:
        if isinstance(action, np.ndarray) and action.ndim == 0:
            action = action.item()
        number = operator.index(action)
    except (TypeError, ValueError):
        number = -1
    if isinstance(action, bool | np.bool_) or not 0 <= number < len(ACTIONS):
        raise InvalidActionError(
            f"{action!r} is not an action: actions are the integers 0..{len(ACTIONS) - 1} "
            "(9 * gripper + 3 * turn + drive; see magical_mj.actions.ACTIONS)"
        )
    return number
