"""The 18 discrete actions: gripper (open, close) x turn (none, left, right) x drive (none, forward, back).

The number of an action is ``9 * gripper + 3 * turn + drive``, as in the original (Toyer et al. 2020, appendix "Action
and observation space"). For learners of continuous actions, the same 18 actions have the form of vectors (drive, turn,
grip).
"""

from __future__ import annotations

import itertools
import math
from enum import IntEnum
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magical_mj.utils.errors import InvalidActionError, as_integer, short_repr

__all__ = [
    "ACTIONS",
    "NOOP",
    "THRESHOLD",
    "Action",
    "Drive",
    "Gripper",
    "Turn",
    "action_number",
    "to_discrete",
    "to_vector",
]


class Gripper(IntEnum):
    """The target position of both fingers."""

    OPEN = 0
    CLOSE = 1


class Turn(IntEnum):
    """The robot's turn direction. Left is counter-clockwise."""

    NONE = 0
    LEFT = 1
    RIGHT = 2


class Drive(IntEnum):
    """The robot's drive direction along its heading."""

    NONE = 0
    FORWARD = 1
    BACK = 2


class Action(NamedTuple):
    """One of the 18 actions as a triple. :attr:`number` is its number; ``int(...)`` does not work."""

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
"""The no-op. The gripper is open at the start and stays open."""


def action_number(action: Any) -> int:
    """`action` as an int in 0..17.

    Accepts ints, numpy integers, 0-d integer arrays and :class:`Action` triples.

    Raises:
        InvalidActionError: for all other values, such as 18, 1.5 or None.
    """
    if isinstance(action, Action):
        action = int(action.number) if action in ACTIONS else action
    number = as_integer(action, 0, len(ACTIONS) - 1)
    if number is None:
        raise InvalidActionError(
            f"{short_repr(action)} is not an action: actions are the integers 0..{len(ACTIONS) - 1} "
            f"(9 * gripper + 3 * turn + drive; see magical_mj.actions.ACTIONS){_hint(action)}"
        )
    return number


def _hint(action: Any) -> str:
    """Advice for arrays from networks and batches that are given instead of an action."""
    shape = (len(action),) if isinstance(action, list) else getattr(action, "shape", ())
    if not isinstance(shape, tuple) or not shape:
        return ""
    if math.prod(shape) == len(ACTIONS):
        return "; if these are values of all actions, take the argmax: int(np.argmax(values))"
    return "; take its only entry: int(action[0])" if shape == (1,) else ""


THRESHOLD: Final = 0.5
"""The threshold of drive and turn in a vector: larger magnitudes command motion. Grip closes above 0."""

_VECTORS: Final = np.array(
    [
        ((0.0, 1.0, -1.0)[action.drive], (0.0, 1.0, -1.0)[action.turn], 1.0 if action.gripper else -1.0)
        for action in ACTIONS
    ],
    np.float32,
)


def to_vector(numbers: ArrayLike) -> NDArray[np.float32]:
    """Actions as vectors (drive, turn, grip) with entries in {-1, 0, 1}.

    Drive: 1 forward, -1 back; turn: 1 left (counter-clockwise), -1 right; grip: 1 close, -1 open.

    Args:
        numbers: action numbers in 0..17, any shape.

    Returns:
        New vectors, shape (*numbers.shape, 3). `to_discrete` is the inverse.

    Raises:
        InvalidActionError: if one of the numbers is not an action.
    """
    array = as_array(numbers)
    if array.dtype.kind not in "iu" or (array.size and not (array.min() >= 0 and array.max() < len(ACTIONS))):
        raise InvalidActionError(f"actions must be integers in 0..{len(ACTIONS) - 1}, not {short_repr(numbers)}")
    return _VECTORS[array]


def to_discrete(vector: ArrayLike) -> int:
    """The action that a vector (drive, turn, grip) commands: the inverse of `to_vector` on all 18 actions.

    Drive and turn command motion above 0.5 and below -0.5. Grip closes above 0. Entries should be in [-1, 1]. Larger
    ones have the same effect as 1 or -1.

    Args:
        vector: shape (3,).

    Raises:
        InvalidActionError: for another shape, or entries that are not finite numbers.
    """
    entries = _finite(vector, 3)
    if entries is None:
        raise InvalidActionError(
            f"{short_repr(vector)} is not a continuous action: it must be three finite numbers in [-1, 1] "
            f"(drive, turn, grip){tensor_hint(vector)}"
        )
    drive, turn, grip = entries
    return Action(Gripper(int(grip > 0)), Turn(_direction(turn)), Drive(_direction(drive))).number


def _direction(entry: float) -> int:
    """The value of `Turn` or `Drive` that an entry of a vector commands."""
    if entry > THRESHOLD:
        return 1
    return 2 if entry < -THRESHOLD else 0


def as_speeds(action: ArrayLike, size: int) -> NDArray[np.float64]:
    """An x-magical action as numbers: (speed, turn), and grip for a gripper. Shape (size,).

    Raises an `InvalidActionError` for another shape, or entries that are not finite numbers.
    """
    entries = _finite(action, size)
    if entries is None:
        parts = "speed, turn, grip" if size == 3 else "speed, turn; this body has no gripper"
        raise InvalidActionError(
            f"{short_repr(action)} is not an action here: it must be {size} finite numbers in [-1, 1] ({parts})"
            f"{tensor_hint(action)}"
        )
    return entries


def _finite(values: ArrayLike, size: int) -> NDArray[np.float64] | None:
    """The values as an array; None unless they are `size` finite numbers."""
    array = as_array(values)
    if array.shape != (size,) or array.dtype.kind not in "biufO":
        return None
    try:
        entries = array.astype(np.float64)
    except (TypeError, ValueError, OverflowError, RuntimeError):  # for arrays of objects
        return None
    return entries if np.isfinite(entries).all() else None


def as_array(values: Any) -> NDArray[Any]:
    """The values as an array. Empty if they cannot be converted, such as ragged lists and some tensors."""
    try:
        return np.asarray(values)
    except (TypeError, ValueError, OverflowError, RuntimeError):  # RuntimeError for tensors that require gradients
        return np.empty(0)


def tensor_hint(values: Any) -> str:
    """Advice for tensors that numpy cannot convert."""
    return "; for a tensor, give tensor.detach().float().cpu()" if hasattr(values, "detach") else ""
