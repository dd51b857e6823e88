"""What `relational` learns from: states and actions, and what may be changed in each state under which assumption."""

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
from magical_mj.learners.relational_network import blocks_of, regions_of
from magical_mj.scene.state_vector import MAX_BLOCKS, MAX_REGIONS

MOVED: Final = 0.03
"""Units that a block must move to count as moved."""
GRIPPING: Final = 3
"""Steps before a block moves, in which the robot counts as being there."""
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


class Samples(NamedTuple):
    """States, what was done in them, and what may be displaced."""

    states: Tensor
    """Shape (n, names)."""
    actions: Tensor
    """Shape (n,)."""
    groups: Tensor
    """With what each block is displaced, shape (n, MAX_BLOCKS): the region that it is in, or MAX_REGIONS + its own
    number; -1 if there is no such block."""
    movable: Tensor
    """Which of these groups may be displaced, shape (n, MAX_REGIONS + MAX_BLOCKS)."""
    droppable: Tensor
    """Which may be missing, likewise."""
    way: Tensor
    """Where the robot, and its front or what it holds, will be soon, in the arena, shape (n, WAY, 2)."""
    pair: Tensor
    """The block that the robot is about to take, or moves, shape (n, MAX_BLOCKS)."""
    pivot: Tensor
    """About what the robot and this block may be turned, in the arena, shape (n, 2)."""
    freedom: Tensor
    """A `Freedom` for each, shape (n,)."""

    def of(self, rows: Tensor) -> Samples:
        """Some of them."""
        return Samples(*(values[rows] for values in self))


def joined(parts: Sequence[Samples]) -> Samples:
    """All samples of several."""
    return Samples(*(torch.cat(values) for values in zip(*parts, strict=True)))


def front(poses: NDArray[Any]) -> NDArray[Any]:
    """Where the robot's front is, for poses (..., 3)."""
    heading = np.stack([-np.sin(poses[..., 2]), np.cos(poses[..., 2])], -1)
    return poses[..., :2] + FRONT * heading.astype(poses.dtype)


class Motion(NamedTuple):
    """A block on the move, from a step to before another one."""

    block: int
    begin: int
    end: int


class Replay:
    """A demonstration, replayed: its states before and after each action, and who moved when.

    Attributes:
        states: shape (steps + 1, names).
        saved: the engine's, likewise.
        actions: shape (steps,).
        never: a step after all others.
        places: of the blocks, in the arena, shape (steps + 1, MAX_BLOCKS, 2).
        begins: the step at which each block begins to move, or `never`, shape (MAX_BLOCKS,).
        next: the step at which each block moves next, from each step on, or `never`, shape (steps + 1, MAX_BLOCKS).
        moving: which blocks move in each step, likewise.
        used: which regions a block or the robot enters or leaves, shape (MAX_REGIONS,).
    """

    def __init__(self, engine: Engine, demonstration: Demonstration) -> None:
        engine.reset(scene=demonstration.scene)
        self.actions = np.asarray(demonstration.actions, dtype=np.int64)
        states, self.saved = [engine.state_vector()], [engine.get_state()]
        for action in self.actions.tolist():
            engine.step(action)
            states.append(engine.state_vector())
            self.saved.append(engine.get_state())
        self.states = np.array(states)
        tensor = torch.from_numpy(self.states)
        self.places = places = blocks_of(tensor)[..., 1:3].numpy()
        steps = self.never = len(places)
        far = np.linalg.norm(places - places[:1], axis=2) > MOVED
        self.begins = np.where(far.any(0), far.argmax(0), self.never)
        changes = np.linalg.norm(np.diff(places, axis=0), axis=2) > MOVED / 10
        self.moving = np.concatenate([changes, np.zeros_like(changes[:1])])
        later = np.where(self.moving, np.arange(steps)[:, None], self.never)
        self.next = np.minimum.accumulate(later[::-1], 0)[::-1]
        self._regions, robot = regions_of(tensor[:1])[0].numpy(), self.states[:, :2]
        within = np.stack([_inside(region, places) & (places[..., 0] != 0) for region in self._regions])
        visited = np.stack([_inside(region, robot) for region in self._regions])
        self.used = (within[:, -1] != within[:, 0]).any(1) | (visited[:, -1] != visited[:, 0])

    def samples(self, steps: NDArray[np.int64]) -> Samples:
        """The states before some of its actions, with these actions."""
        states, actions = torch.from_numpy(self.states[steps]), torch.from_numpy(self.actions[steps])
        return Samples(states, actions, *self.loose(steps), self._ahead(steps), *self.freedoms(steps))

    def loose(self, steps: NDArray[np.int64]) -> tuple[Tensor, Tensor, Tensor]:
        """What belongs together at these steps, what of it may be displaced, and what may be missing."""
        states = torch.from_numpy(self.states[steps])
        groups, there = _groups(states), regions_of(states)[..., 0].numpy() > 0
        coming, target = self.next[steps].min(1), self.next[steps].argmin(1)
        on_its_way = (coming < self.never) & (coming > steps + GRIPPING)
        movable, droppable = (np.zeros((len(steps), MAX_REGIONS + MAX_BLOCKS), bool) for _ in range(2))
        for group in range(MAX_REGIONS + MAX_BLOCKS):
            members = groups == group
            exists = members.any(1) | (group < MAX_REGIONS and there[:, group])
            begins = np.where(members, self.begins, self.never).min(1)
            used = group < MAX_REGIONS and bool(self.used[group])
            droppable[:, group] = exists & (begins == self.never) & (not used)
            comes_next = members[np.arange(len(steps)), target] & (coming < self.never)
            later = (steps < begins) & (group >= MAX_REGIONS)
            movable[:, group] = droppable[:, group] | (exists & ~comes_next & (on_its_way | later))
        return torch.from_numpy(groups), torch.from_numpy(movable), torch.from_numpy(droppable)

    def freedoms(self, steps: NDArray[np.int64]) -> tuple[Tensor, Tensor, Tensor]:
        """See `Samples.pair`, `pivot` and `freedom`."""
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
        """When one block was on the move, for at least `CARRIED` steps; short rests count as moving."""
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


def _inside(region: NDArray[np.float32], places: NDArray[np.float32]) -> NDArray[np.bool_]:
    x, y = places[..., 0], places[..., 1]
    return (region[0] > 0) & (x >= region[1]) & (x <= region[3]) & (y >= region[2]) & (y <= region[4])


def _groups(states: Tensor) -> NDArray[np.int64]:
    """See `Samples.groups`."""
    blocks, regions = blocks_of(states).numpy(), regions_of(states).numpy()
    groups = np.where(blocks[..., 0] > 0, MAX_REGIONS + np.arange(MAX_BLOCKS), -1)
    for number in range(MAX_REGIONS):
        low, high = regions[:, None, number, 1:3], regions[:, None, number, 3:5]
        within = ((blocks[..., 1:3] >= low) & (blocks[..., 1:3] <= high)).all(2)
        groups[within & (blocks[..., 0] > 0) & (regions[:, None, number, 0] > 0)] = number
    return groups
