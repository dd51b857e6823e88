"""What `research.hindsight` learns from: samples of `relational`, and how the robot may be moved with its block."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_mj.demos import Demonstration
from magical_mj.engine import Engine
from magical_mj.learners.assumptions import MOVED, Replay, Samples
from magical_mj.learners.relational_network import blocks_of, regions_of
from magical_mj.scene.state_vector import MAX_BLOCKS

CARRIED: Final = 4
"""Steps that a block must move for to count as carried or pushed."""
FRONT: Final = 0.2
"""Units from the robot's middle to its front."""
WAY: Final = 16
"""Places that tell where the robot will go."""


class Freedom(IntEnum):
    """How the robot may be moved, with the block that it deals with."""

    NONE = 0
    TURNS = 1
    ANYWHERE = 2


class FreeSamples(NamedTuple):
    """Samples, and what else may be changed in them."""

    shown: Samples
    way: Tensor
    """Where the robot, and its front or what it holds, will be soon, shape (n, WAY, 2)."""
    pair: Tensor
    """The block that the robot is about to take, or moves, shape (n, MAX_BLOCKS)."""
    pivot: Tensor
    """About what the robot and this block may be turned, shape (n, 2)."""
    freedom: Tensor
    """A `Freedom` for each, shape (n,)."""

    def of(self, rows: Tensor) -> FreeSamples:
        """Some of them."""
        return FreeSamples(self.shown.of(rows), *(values[rows] for values in self[1:]))


def joined(parts: Sequence[FreeSamples]) -> FreeSamples:
    """All samples of several."""
    shown = Samples(*(torch.cat(values) for values in zip(*(part.shown for part in parts), strict=True)))
    return FreeSamples(shown, *(torch.cat(values) for values in zip(*(part[1:] for part in parts), strict=True)))


def front(poses: NDArray[Any]) -> NDArray[Any]:
    """Where the robot's front is, for poses (..., 3)."""
    heading = np.stack([-np.sin(poses[..., 2]), np.cos(poses[..., 2])], -1)
    return poses[..., :2] + FRONT * heading.astype(poses.dtype)


class Motion(NamedTuple):
    """A block on the move, from a step to before another one."""

    block: int
    begin: int
    end: int


class FreeReplay(Replay):
    """A replayed demonstration that also says how the robot may be moved.

    Attributes:
        places: of the blocks, shape (steps + 1, MAX_BLOCKS, 2).
        moving: which of them move in each step, likewise.
    """

    def __init__(self, engine: Engine, demonstration: Demonstration) -> None:
        super().__init__(engine, demonstration)
        tensor = torch.from_numpy(self.states)
        self.places = blocks_of(tensor)[..., 1:3].numpy()
        self.moving = self.next == np.arange(len(self.places))[:, None]
        self._regions = regions_of(tensor[:1])[0].numpy()

    def free_samples(self, steps: NDArray[np.int64]) -> FreeSamples:
        """The states before some of its actions, with these actions."""
        return FreeSamples(self.samples(steps), self._ahead(steps), *self.freedoms(steps))

    def freedoms(self, steps: NDArray[np.int64]) -> tuple[Tensor, Tensor, Tensor]:
        """See `FreeSamples.pair`, `pivot` and `freedom`."""
        pair = np.zeros((len(steps), MAX_BLOCKS), bool)
        pivot, freedom = np.zeros((len(steps), 2), np.float32), np.zeros(len(steps), np.int64)
        for row, step in enumerate(steps):
            coming, target = self.next[step].min(), int(self.next[step].argmin())
            if coming == self.never:
                continue
            if coming > step + 1:
                pair[row, target], pivot[row], freedom[row] = True, self.places[step, target], Freedom.ANYWHERE
            elif (self.next[step] <= step + 1).sum() == 1:
                around = self._around(step, target)
                if around is not None:
                    pair[row, target], pivot[row], freedom[row] = True, around, Freedom.TURNS
        return torch.from_numpy(pair), torch.from_numpy(pivot), torch.from_numpy(freedom)

    def motions(self) -> list[Motion]:
        """When one block and no other was on the move, for at least `CARRIED` steps; short rests count as moving."""
        found = []
        for block in range(MAX_BLOCKS):
            steps = np.flatnonzero(self.moving[:, block])
            parts = np.split(steps, np.flatnonzero(np.diff(steps) > CARRIED) + 1)
            found += [Motion(block, int(part[0]), int(part[-1]) + 1) for part in parts if len(part) >= CARRIED]
        return found

    def _ahead(self, steps: NDArray[np.int64]) -> Tensor:
        """See `Samples.way`: the robot and its front in each second of the next steps, until it has reached a block."""
        coming = self.next[steps].min(1)
        last = np.where(coming > steps + 1, np.minimum(coming, self.never - 1), self.never - 1)
        later = np.minimum(steps[:, None] + np.arange(0, WAY, 2), last[:, None])
        robot = self.states[later][..., :3]
        return torch.from_numpy(np.concatenate([robot[..., :2], front(robot)], 1))

    def _around(self, step: int, block: int) -> NDArray[np.float32] | None:
        """The middle of the region in which this motion of a block ends, if it ends near it."""
        while step < self.never - 1 and self.next[step, block] <= step + CARRIED:
            step += 1
        for region in self._regions:
            middle, half = (region[1:3] + region[3:5]) / 2, (region[3:5] - region[1:3]).min() / 2
            if region[0] > 0 and np.linalg.norm(self.places[step, block] - middle) < half - MOVED:
                return middle
        return None
