"""Replayed demonstrations: their blocks' motions, and the samples that they yield.

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

from magical_mj.actions import ACTIONS, NOOP, Action, Gripper
from magical_mj.demos import Demonstration
from magical_mj.engine import Engine
from magical_mj.learners.networks import COLOURS, SHAPES, blocks_of, regions_of
from magical_mj.observations import MAX_BLOCKS, MAX_REGIONS

MOVED: Final = 0.03
"""A block farther (units) from its start counts as moved."""
BUMPED: Final = 0.25
"""In deliveries, a block that moves less far (units) was only bumped."""
GRIPPING: Final = 3
"""The robot has reached a block at this number of steps before the block moves."""
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
CLOSING: Final = Action(Gripper.CLOSE).number
"""This action and all with larger numbers close the fingers."""


class Freedom(IntEnum):
    """The allowed motions of the robot together with its current block."""

    NONE = 0
    TURNS = 1
    ANYWHERE = 2
    REMOVES = 3
    """Turns about the region that the block leaves. The block must not end in a region."""


class Samples(NamedTuple):
    """States, their actions, and what may be changed in the states."""

    states: Tensor
    """Shape (n, names)."""
    actions: Tensor
    """Shape (n,)."""
    groups: Tensor
    """Each block's group, shape (n, MAX_BLOCKS): the number of its region, otherwise MAX_REGIONS + its own number.
    -1 if the block does not exist. Groups are displaced as a whole."""
    movable: Tensor
    """Which of these groups may be displaced, shape (n, MAX_REGIONS + MAX_BLOCKS)."""
    droppable: Tensor
    """Which of these groups may be missing, shape (n, MAX_REGIONS + MAX_BLOCKS)."""
    path: Tensor
    """The next positions of the robot, and of its front or held block, in the arena, shape (n, PATH_POINTS, 2)."""
    pair: Tensor
    """Whether each block is the robot's current one, which it approaches, moves or leaves, shape (n, MAX_BLOCKS).
    False for all blocks if the freedom is NONE."""
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


Pivot = NDArray[np.float32] | None
"""A centre of rotation in the arena, shape (2,), if there is one."""


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
        exists, self.positions = blocks[..., 0] > 0, blocks[..., 1:3]
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
        within = np.stack([_inside(region, positions) & exists for region in self._regions])
        visited = np.stack([_inside(region, robot) for region in self._regions])
        self.used = (within[:, -1] != within[:, 0]).any(1) | (visited[:, -1] != visited[:, 0])
        self._groups = np.where(exists, MAX_REGIONS + np.arange(MAX_BLOCKS), -1)
        for number, inside in enumerate(within):
            self._groups[inside] = number
        self._released = [self._released_block(step) for step in range(steps)]

    def samples(self, steps: NDArray[np.int64]) -> Samples:
        """The states before these steps' actions, and the actions."""
        states, actions = torch.from_numpy(self.states[steps]), torch.from_numpy(self.actions[steps])
        displaceable, freedoms = self.displaceable(steps), self.freedoms(steps)
        return Samples(states, actions, *displaceable, self._path(steps), *freedoms, self.looks(len(steps)))

    def looks(self, count: int) -> Tensor:
        """See `Samples.looks`: the shapes and colours with the same relations as those of one of the unmoved blocks.

        A block's relations are the regions, and the blocks in regions, that have its colour or its shape.
        """
        state = torch.from_numpy(self.states[:1])
        blocks, regions = blocks_of(state)[0], regions_of(state)[0]
        in_region, exists = self._groups[0] < MAX_REGIONS, self._groups[0] >= 0
        inside = blocks[torch.from_numpy(in_region & exists)]
        present_colours = torch.cat([inside[:, COLOURS], regions[regions[:, 0] > 0, 5:]])

        def relations(shapes: Tensor, colours: Tensor) -> Tensor:
            return torch.cat([shapes @ inside[:, SHAPES].T, colours @ present_colours.T], 1)

        unmoved = blocks[torch.from_numpy(exists & ~in_region & ~self.matters)]
        all_looks = torch.eye(4).repeat_interleave(4, 0), torch.eye(4).repeat(4, 1)
        same = torch.cdist(relations(*all_looks), relations(unmoved[:, SHAPES], unmoved[:, COLOURS])) < 0.5
        return same.any(1).float().expand(count, -1)

    def displaceable(self, steps: NDArray[np.int64]) -> tuple[Tensor, Tensor, Tensor]:
        """See `Samples.groups`, `movable` and `droppable`, for the states at these steps.

        A group that the demonstration does not involve may always be displaced, or be missing. Others may be displaced

        - if they contain the next block to move: only before this block's first motion, while the robot still backs
          off from the previous block,
        - otherwise: until the robot has reached the next block; single blocks also until their own first motion.
        """
        groups = self._groups[steps]
        next_step, next_block = self.next[steps].min(1), self.next[steps].argmin(1)
        follows = next_step < self.never
        approaches = follows & (next_step > steps + GRIPPING)
        backs_off = np.array([self._released[step] is not None for step in steps], dtype=bool)
        movable, droppable = (np.zeros((len(steps), MAX_REGIONS + MAX_BLOCKS), bool) for _ in range(2))
        for group in range(MAX_REGIONS + MAX_BLOCKS):
            is_region, members = group < MAX_REGIONS, groups == group
            exists = members.any(1) | (is_region and self._regions[group, 0] > 0)
            involved = (members & self.matters).any(1) | (is_region and bool(self.used[group]))
            first_motion = np.where(members, self.begins, self.never).min(1)
            waits = (not is_region) & (steps < first_motion) & (first_motion < self.never)
            contains_next = members[np.arange(len(steps)), next_block] & follows
            idle = np.where(contains_next, waits & backs_off, waits | approaches)
            droppable[:, group] = exists & ~involved
            movable[:, group] = exists & (~involved | idle)
        return torch.from_numpy(groups), torch.from_numpy(movable), torch.from_numpy(droppable)

    def freedoms(self, steps: NDArray[np.int64]) -> tuple[Tensor, Tensor, Tensor]:
        """See `Samples.pair`, `pivot` and `freedom`."""
        pair = np.zeros((len(steps), MAX_BLOCKS), bool)
        pivots, freedoms = np.zeros((len(steps), 2), np.float32), np.zeros(len(steps), np.int64)
        for row, step in enumerate(steps.tolist()):
            block, freedom, pivot = self._current_block(step)
            freedoms[row] = freedom
            if freedom > Freedom.NONE:
                pair[row, block], pivots[row] = True, pivot
        return torch.from_numpy(pair), torch.from_numpy(pivots), torch.from_numpy(freedoms)

    def _current_block(self, step: int) -> tuple[int, Freedom, Pivot]:
        """The robot's current block at a step, its freedom, and the centre of rotation."""
        released = self._released[step]
        if released is not None:
            return released, *self._freedom_of_delivery(step, released)
        block = int(self.next[step].argmin())
        if self.next[step, block] == self.never:  # no block moves any more
            return block, Freedom.NONE, None
        moving = (self.next[step] <= step + 1).sum()
        if moving == 0:
            return block, *self._freedom_of_approach(step, block)
        if moving == 1:
            return block, *self._freedom_of_delivery(step, block)
        return block, Freedom.NONE, None

    def _freedom_of_approach(self, step: int, block: int) -> tuple[Freedom, Pivot]:
        """While the robot drives to a block: anywhere. If a delivery begins in a region, it turns about the region."""
        position = self.positions[step, block]
        centre = self._region_centre(position) if self.deliveries else None
        return (Freedom.ANYWHERE, position) if centre is None else (Freedom.TURNS, centre)

    def _freedom_of_delivery(self, step: int, block: int) -> tuple[Freedom, Pivot]:
        """While a block moves, and after its release: turns about the region where its motion ends.

        If the motion ends outside of regions, a delivery turns about the region where it began.
        """
        first, last = self._motion_around(step, block)
        begin, end = (self._region_centre(self.positions[at, block]) for at in (first, last))
        if end is not None:
            return Freedom.TURNS, end
        if begin is not None and self.deliveries:
            return Freedom.REMOVES, begin
        return Freedom.NONE, None

    def _released_block(self, step: int) -> int | None:
        """The block that the robot has released and is still next to, while no block moves."""
        before = np.flatnonzero(self.moving[:step].any(1))
        if not self.deliveries or not len(before) or self.next[step].min() <= step + 1:
            return None
        block = int(self.moving[before[-1]].argmax())
        distance = np.linalg.norm(self.positions[step, block] - self.states[step, :2])
        return block if distance < NEXT_TO else None

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

    def _path(self, steps: NDArray[np.int64]) -> Tensor:
        """See `Samples.path`: the robot and its front in every other step, until it has reached a block."""
        coming = self.next[steps].min(1)
        last = np.where(coming > steps + 1, np.minimum(coming, self.never - 1), self.never - 1)
        later = np.minimum(steps[:, None] + np.arange(0, PATH_POINTS, 2), last[:, None])
        robot = self.states[later][..., :3]
        return torch.from_numpy(np.concatenate([robot[..., :2], front(robot)], 1))

    def _motion_around(self, step: int, block: int) -> tuple[int, int]:
        """The first and the last step of a block's motion at, or before, a step."""
        last = step
        while last < self.never - 1 and self.next[last, block] <= last + CARRIED:
            last += 1
        before = np.flatnonzero(self.moving[: step + 1, block])
        gaps = np.flatnonzero(np.diff(before) > CARRIED)
        return (int(before[gaps[-1] + 1] if len(gaps) else before[0]) if len(before) else step), last

    def _region_centre(self, position: NDArray[np.float32]) -> Pivot:
        """The centre of the region that contains a position well inside; None without such a region."""
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
