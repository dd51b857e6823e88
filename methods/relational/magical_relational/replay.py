"""Demonstrations, replayed: which blocks they move and how, and the samples that they yield.

A demonstration can be read in two ways. By default, each motion of a block counts. With `deliveries`, it is a series of
deliveries:

- A block that is only bumped counts as unmoved.
- A block that any demonstration moves matters in all of them.
- A block in a region remains in it until the robot moves it.
- The robot's current block is the released one until the robot has backed off from it, and then the next one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_mj.demos import Demonstration
from magical_mj.engine import Engine
from magical_mj.learners.networks import COLOURS, SHAPES, blocks_of, regions_of
from magical_mj.scene.actions import ACTIONS, NOOP, Gripper
from magical_mj.scene.state_vector import MAX_BLOCKS, MAX_REGIONS

MOVED: Final = 0.03
"""A block farther (units) from its start counts as moved."""
BUMPED: Final = 0.25
"""The largest motion (units) of a block that was only bumped."""
GRIPPING: Final = 3
"""The robot counts as having reached a block this number of steps before the block moves."""
CARRIED: Final = 4
"""Shorter motions of a block, in steps, do not count as carrying or pushing."""
FRONT: Final = 0.2
"""The distance (units) of the robot's front from its centre."""
NEXT_TO: Final = 0.45
"""A robot is next to a block if the distance (units) between their centres is smaller."""
OPENING: Final = 3
"""The number of steps for opening the fingers. Later actions without effect are left out."""
PATH_POINTS: Final = 16
"""The number of points that describe the robot's path ahead."""


class Freedom(IntEnum):
    """The allowed motions of the robot together with its current block."""

    NONE = 0
    TURNS = 1
    ANYWHERE = 2
    REMOVES = 3
    """Turns about the region from which the block is removed. The block must not end in a region."""


class Samples(NamedTuple):
    """States, their actions, and the objects that may be displaced."""

    states: Tensor
    """Shape (n, names)."""
    actions: Tensor
    """Shape (n,)."""
    groups: Tensor
    """Each block's group, which is displaced as a whole, shape (n, MAX_BLOCKS): its region, or MAX_REGIONS + its own
    number; -1 if the block does not exist."""
    movable: Tensor
    """Which of these groups may be displaced, shape (n, MAX_REGIONS + MAX_BLOCKS)."""
    droppable: Tensor
    """Which of these groups may be missing, shape (n, MAX_REGIONS + MAX_BLOCKS)."""
    path: Tensor
    """The next positions in the arena of the robot, and of its front or held block, shape (n, PATH_POINTS, 2)."""
    pair: Tensor
    """Whether each block is the one that the robot is about to grip, or moves, shape (n, MAX_BLOCKS)."""
    pivot: Tensor
    """The centre of rotation of the robot and this block, in the arena, shape (n, 2)."""
    freedom: Tensor
    """Each sample's `Freedom`, shape (n,)."""
    looks: Tensor
    """1 for each shape and colour that an unmoved block may have, shape (n, 4 * 4): number 4 * shape + colour."""

    def of(self, rows: Tensor | slice) -> Samples:
        """A selection of samples. A slice shares its memory."""
        return Samples(*(values[rows] for values in self))


def joined(parts: Sequence[Samples]) -> Samples:
    """Concatenates samples."""
    return Samples(*(torch.cat(values) for values in zip(*parts, strict=True)))


def front(poses: NDArray[Any]) -> NDArray[Any]:
    """The positions of the robot's front, for poses (..., 3)."""
    heading = np.stack([-np.sin(poses[..., 2]), np.cos(poses[..., 2])], -1)
    return poses[..., :2] + FRONT * heading.astype(poses.dtype)


def in_hand(state: NDArray[np.float32], block: int) -> NDArray[np.float64]:
    """A block's position in the robot's frame, in a state (names,): units to the right and ahead."""
    x, y = blocks_of(torch.from_numpy(state[None]))[0, block, 1:3].numpy() - state[:2]
    sin, cos = math.sin(state[2]), math.cos(state[2])
    return np.array([cos * x + sin * y, cos * y - sin * x])


class Motion(NamedTuple):
    """A block's motion, from the step `begin` until before the step `end`."""

    block: int
    begin: int
    end: int


class Replay:
    """A demonstration, replayed: its states before and after each action, and the blocks' motions.

    Attributes:
        states: shape (steps + 1, names).
        saved: the engine's states, of the same length.
        actions: shape (steps,).
        never: the number of states; as a step it means "does not occur".
        positions: of the blocks, in the arena, shape (steps + 1, MAX_BLOCKS, 2).
        matters: whether each block is moved, here or in another demonstration (see `read`), shape (MAX_BLOCKS,).
        begins: the step of each block's first motion, or `never`, shape (MAX_BLOCKS,).
        next: for each step, the step of each block's next motion, or `never`, shape (steps + 1, MAX_BLOCKS).
        moving: whether each block moves in each step, shape (steps + 1, MAX_BLOCKS).
        used: whether a block or the robot enters or leaves each region, shape (MAX_REGIONS,).
    """

    def __init__(self, engine: Engine, demonstration: Demonstration, *, deliveries: bool = False) -> None:
        """Replays a demonstration. With `deliveries`, reads it as a series of deliveries (see above)."""
        self.deliveries = deliveries
        engine.reset(scene=demonstration.scene)
        self.actions = np.asarray(demonstration.actions, dtype=np.int64)
        states, self.saved = [engine.state_vector()], [engine.get_state()]
        for action in self.actions.tolist():
            engine.step(action)
            states.append(engine.state_vector())
            self.saved.append(engine.get_state())
        self.states = np.array(states)
        blocks = blocks_of(torch.from_numpy(self.states)).numpy()
        there, self.positions = blocks[..., 0] > 0, blocks[..., 1:3]
        positions = self.positions
        steps = self.never = len(positions)
        shift = np.linalg.norm(positions - positions[:1], axis=2)
        far = (shift > MOVED) & (shift.max(0) > (BUMPED if deliveries else MOVED))
        self.matters = far.any(0)
        self.begins = np.where(self.matters, far.argmax(0), self.never)
        changes = np.linalg.norm(np.diff(positions, axis=0), axis=2) > MOVED / 10
        changes &= self.matters | (not deliveries)
        self.moving = np.concatenate([changes, np.zeros_like(changes[:1])])
        later = np.where(self.moving, np.arange(steps)[:, None], self.never)
        self.next = np.minimum.accumulate(later[::-1], 0)[::-1]
        self._regions, robot = regions_of(torch.from_numpy(self.states[0])).numpy(), self.states[:, :2]
        within = np.stack([_inside(region, positions) & there for region in self._regions])
        visited = np.stack([_inside(region, robot) for region in self._regions])
        self.used = (within[:, -1] != within[:, 0]).any(1) | (visited[:, -1] != visited[:, 0])
        self._groups = np.where(there, MAX_REGIONS + np.arange(MAX_BLOCKS), -1)
        for number, inside in enumerate(within):
            self._groups[inside] = number
        self._left = [self._released(step) for step in range(steps)]

    def samples(self, steps: NDArray[np.int64]) -> Samples:
        """The states before these steps' actions, and the actions."""
        states, actions = torch.from_numpy(self.states[steps]), torch.from_numpy(self.actions[steps])
        loose, freedoms = self.loose(steps), self.freedoms(steps)
        return Samples(states, actions, *loose, self._ahead(steps), *freedoms, self.looks(len(steps)))

    def looks(self, count: int) -> Tensor:
        """See `Samples.looks`. They share shapes and colours with the same objects as one of the unmoved blocks.

        These objects are the regions, and the blocks in regions.
        """
        state = torch.from_numpy(self.states[:1])
        blocks, regions = blocks_of(state)[0], regions_of(state)[0]
        inside, there = self._groups[0] < MAX_REGIONS, self._groups[0] >= 0
        known = blocks[torch.from_numpy(inside & there)]
        colours = torch.cat([known[:, COLOURS], regions[regions[:, 0] > 0, 5:]])

        def relations(shapes: Tensor, own: Tensor) -> Tensor:
            return torch.cat([shapes @ known[:, SHAPES].T, own @ colours.T], 1)

        free = blocks[torch.from_numpy(there & ~inside & ~self.matters)]
        every = torch.eye(4).repeat_interleave(4, 0), torch.eye(4).repeat(4, 1)
        same = torch.cdist(relations(*every), relations(free[:, SHAPES], free[:, COLOURS])) < 0.5
        return same.any(1).float().expand(count, -1)

    def loose(self, steps: NDArray[np.int64]) -> tuple[Tensor, Tensor, Tensor]:
        """The groups at these steps, those that may be displaced, and those that may be missing."""
        groups = self._groups[steps]
        coming, target = self.next[steps].min(1), self.next[steps].argmin(1)
        approaching = (coming < self.never) & (coming > steps + GRIPPING)
        leaves = np.array([self._left[step] is not None for step in steps], dtype=bool)
        movable, droppable = (np.zeros((len(steps), MAX_REGIONS + MAX_BLOCKS), bool) for _ in range(2))
        for group in range(MAX_REGIONS + MAX_BLOCKS):
            members = groups == group
            exists = members.any(1) | (group < MAX_REGIONS and self._regions[group, 0] > 0)
            begins = np.where(members, self.begins, self.never).min(1)
            used = group < MAX_REGIONS and bool(self.used[group])
            droppable[:, group] = exists & ~(members & self.matters).any(1) & (not used)
            comes_next = members[np.arange(len(steps)), target] & (coming < self.never)
            later = (steps < begins) & (begins < self.never) & (group >= MAX_REGIONS)
            others = ~comes_next & (approaching | later)
            movable[:, group] = droppable[:, group] | (exists & (others | (leaves & later)))
        return torch.from_numpy(groups), torch.from_numpy(movable), torch.from_numpy(droppable)

    def freedoms(self, steps: NDArray[np.int64]) -> tuple[Tensor, Tensor, Tensor]:
        """See `Samples.pair`, `pivot` and `freedom`."""
        pair = np.zeros((len(steps), MAX_BLOCKS), bool)
        pivot, freedom = np.zeros((len(steps), 2), np.float32), np.zeros(len(steps), np.int64)
        for row, step in enumerate(steps):
            block, freedom[row], around = self._freedom(int(step))
            if freedom[row] > Freedom.NONE:
                pair[row, block], pivot[row] = True, around
        return torch.from_numpy(pair), torch.from_numpy(pivot), torch.from_numpy(freedom)

    def _freedom(self, step: int) -> tuple[int, Freedom, NDArray[np.float32] | None]:
        """The robot's current block at a step, its freedom, and the centre of rotation."""
        coming, block = int(self.next[step].min()), int(self.next[step].argmin())
        left = self._left[step]
        if coming <= step + 1 or left is not None:
            block = block if left is None else left
            alone = left is not None or (self.next[step] <= step + 1).sum() == 1
            first, last = self._motion(step, block)
            there, here = (self._home(self.positions[at, block]) if alone else None for at in (last, first))
            if there is None and here is not None and self.deliveries:
                return block, Freedom.REMOVES, here
            return block, Freedom.NONE if there is None else Freedom.TURNS, there
        if coming == self.never:
            return block, Freedom.NONE, None
        home = self._home(self.positions[step, block]) if self.deliveries else None
        return (block, Freedom.ANYWHERE, self.positions[step, block]) if home is None else (block, Freedom.TURNS, home)

    def _released(self, step: int) -> int | None:
        """The block that the robot has released and is still next to, while no block moves."""
        before = np.flatnonzero(self.moving[:step].any(1))
        if not self.deliveries or not len(before) or self.next[step].min() <= step + 1:
            return None
        block = int(self.moving[before[-1]].argmax())
        away = np.linalg.norm(self.positions[step, block] - self.states[step, :2])
        return block if away < NEXT_TO else None

    def motions(self) -> list[Motion]:
        """The motions of single blocks, of at least `CARRIED` steps. Short rests count as moving."""
        found = []
        for block in range(MAX_BLOCKS):
            steps = np.flatnonzero(self.moving[:, block])
            parts = np.split(steps, np.flatnonzero(np.diff(steps) > CARRIED) + 1)
            found += [Motion(block, int(part[0]), int(part[-1]) + 1) for part in parts if len(part) >= CARRIED]
        return found

    def releases(self) -> NDArray[np.int64]:
        """The steps in which the robot opens its fingers after carrying a block, and backs off."""
        found = list[int]()
        closed = np.array([ACTIONS[action].gripper == Gripper.CLOSE for action in self.actions])
        for block, begin, end in self.motions():
            held = np.flatnonzero(closed[begin:end]) + begin
            if len(held) < CARRIED:
                continue
            first = step = int(held[-1]) + 1
            while step < len(closed) and not closed[step] and (step < first + OPENING or self.actions[step] != NOOP):
                if np.linalg.norm(self.positions[step, block] - self.states[step, :2]) > NEXT_TO:
                    break
                found.append(step)
                step += 1
        return np.array(found, dtype=np.int64)

    def _ahead(self, steps: NDArray[np.int64]) -> Tensor:
        """See `Samples.path`: the robot and its front in every other step, until it has reached a block."""
        coming = self.next[steps].min(1)
        last = np.where(coming > steps + 1, np.minimum(coming, self.never - 1), self.never - 1)
        later = np.minimum(steps[:, None] + np.arange(0, PATH_POINTS, 2), last[:, None])
        robot = self.states[later][..., :3]
        return torch.from_numpy(np.concatenate([robot[..., :2], front(robot)], 1))

    def _motion(self, step: int, block: int) -> tuple[int, int]:
        """The first and the last step of a block's motion at, or before, a step."""
        last = step
        while last < self.never - 1 and self.next[last, block] <= last + CARRIED:
            last += 1
        before = np.flatnonzero(self.moving[: step + 1, block])
        gaps = np.flatnonzero(np.diff(before) > CARRIED)
        return (int(before[gaps[-1] + 1] if len(gaps) else before[0]) if len(before) else step), last

    def _home(self, position: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """The centre of a region, if the position is near it."""
        for region in self._regions:
            middle, half = (region[1:3] + region[3:5]) / 2, (region[3:5] - region[1:3]).min() / 2
            if region[0] > 0 and np.linalg.norm(position - middle) < half - MOVED:
                return middle
        return None


def read(engine: Engine, demonstrations: Sequence[Demonstration], *, deliveries: bool) -> list[Replay]:
    """Replays demonstrations. With `deliveries`, a block that any of them moves matters in all of them."""
    replays = [Replay(engine, demonstration, deliveries=deliveries) for demonstration in demonstrations]
    if deliveries:
        matters = np.any([replay.matters for replay in replays], axis=0)
        for replay in replays:
            replay.matters = matters
    return replays


def _inside(region: NDArray[np.float32], positions: NDArray[np.float32]) -> NDArray[np.bool_]:
    x, y = positions[..., 0], positions[..., 1]
    return (region[0] > 0) & (x >= region[1]) & (x <= region[3]) & (y >= region[2]) & (y <= region[4])
