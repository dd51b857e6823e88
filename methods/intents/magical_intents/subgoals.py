"""Labels for the skill, in hindsight: the objects that a demonstration moved, and the positions that they reached.

A demonstration moves blocks one after the other, and then perhaps the robot. The label of a step is the object that is
being brought, or will be brought next, and the position that it reached. Labels are computed from states and actions
alone.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from magical_mj.actions import ACTIONS, Drive, Gripper, Turn
from magical_mj.learners.networks import blocks_of
from magical_mj.observations import MAX_BLOCKS

ROBOT: Final = MAX_BLOCKS
"""The number of the robot among objects. Blocks have their own numbers."""
DONE: Final = MAX_BLOCKS + 1
"""The label of steps after the last object was brought."""
STIRRED: Final = 0.003
"""Smaller motions of a block in a step (units) do not count."""
PAUSE: Final = 6
"""A block that rests for at most this number of steps is still being moved."""
CARRIED: Final = 0.1
"""A block that moved less far (units) was not brought."""
LEAVING: Final = 8
"""The robot backs off from a block for at most this number of steps."""
_CLOSED: Final = np.array([a.gripper == Gripper.CLOSE for a in ACTIONS])
_LEAVES: Final = np.array([a.gripper == Gripper.OPEN and a[1:] in ((0, 0), (0, Drive.BACK)) for a in ACTIONS])
_FORWARD: Final = np.array([a.drive == Drive.FORWARD for a in ACTIONS])
_MOVES: Final = np.array([a.drive != Drive.NONE or a.turn != Turn.NONE for a in ACTIONS])


class Labels(NamedTuple):
    """The labels of each step.

    Attributes:
        objects: numbers of objects, shape (steps,).
        places: their target positions, shape (steps, 2); 0 after the last object.
    """

    objects: NDArray[np.int64]
    places: NDArray[np.float32]


def labels_of(states: NDArray[np.float32], actions: NDArray[Any]) -> Labels:
    """The labels of a demonstration with these states (steps, names) before its actions (steps,)."""
    count = len(actions)
    objects, places = np.full(count, DONE), np.zeros((count, 2), np.float32)
    begin = 0
    for block, end in _brought(states, actions):
        leave = end
        while leave < min(count, end + LEAVING) and _LEAVES[actions[leave]]:
            leave += 1
        if leave > begin:
            objects[begin:leave] = block
            places[begin:leave] = _positions(states)[min(end, count - 1), block]
            begin = leave
    if _FORWARD[actions[begin:]].any():
        end = begin + int(np.flatnonzero(_MOVES[actions[begin:]]).max()) + 1
        objects[begin:end], places[begin:end] = ROBOT, states[-1, :2]
    return Labels(objects, places)


def _brought(states: NDArray[np.float32], actions: NDArray[Any]) -> list[tuple[int, int]]:
    """Blocks that were brought with closed fingers, and the steps when they arrived, in this order.

    If several blocks moved at the same time, only the one that moved farthest counts: it pushed the others.
    """
    positions, found = _positions(states), []
    moving = np.linalg.norm(np.diff(positions, axis=0), axis=2) > STIRRED
    for block in range(MAX_BLOCKS):
        steps = np.flatnonzero(moving[:, block])
        for part in np.split(steps, np.flatnonzero(np.diff(steps) > PAUSE) + 1) if len(steps) else ():
            begin, end = int(part[0]), int(part[-1]) + 1
            distance = float(np.linalg.norm(positions[end, block] - positions[begin, block]))
            if distance > CARRIED and _CLOSED[actions[begin:end]].mean() > 0.5:
                found.append((distance, begin, end, block))
    kept: list[tuple[int, int, int]] = []
    for _, begin, end, block in sorted(found, reverse=True):
        if all(begin >= other_end or end <= other for other, other_end, _ in kept):
            kept.append((begin, end, block))
    return [(block, end) for _, end, block in sorted(kept)]


def _positions(states: NDArray[np.float32]) -> NDArray[np.float32]:
    return blocks_of(torch.from_numpy(states))[..., 1:3].numpy()
