"""What `relational` learns from, and may assume about a task beyond it: assumptions change samples, or add some.

- egocentric: where in the arena something happens does not matter, only how it looks from the robot. (It changes no
  sample: the network is not told where in the arena it is.)
- mirror: the task is the same in a mirror.
- rename: colours and shapes are names: what matters is which things share them. False for a task that names a colour.
- hindsight: what the demonstrations pursue is to take a block, and to leave it: any way there that is not much too long
  is as good as theirs. Such ways are played in the simulation of the demo scene (`magical_relational.hindsight`).
- grips: and so is any way to get that block between the fingers, from wherever the robot is next to it, and wherever it
  has pushed it. Such ways are found by trying in the same simulation (`magical_relational.grips`).
- displace: what a demonstration never involves does not matter: not where it is, nor whether it is there. On the way to
  a block, everything else may be elsewhere, and so may blocks that come later; where `egocentric` was kept, the robot
  may be anywhere with that block, and turned with a block that it brings to a region. False where the mere place of a
  thing counts.

Each is false somewhere. `magical_relational.method` keeps those with which the demo scene does not suffer.
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
from magical_mj.scene.actions import ACTIONS, Turn
from magical_mj.scene.state_vector import FINGERS, MAX_BLOCKS, MAX_REGIONS

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

    def of(self, rows: Tensor | slice) -> Samples:
        """Some of them; of a slice, the same memory."""
        return Samples(*(values[rows] for values in self))


def joined(parts: Sequence[Samples]) -> Samples:
    """All samples of several."""
    return Samples(*(torch.cat(values) for values in zip(*parts, strict=True)))


def front(poses: NDArray[Any]) -> NDArray[Any]:
    """Where the robot's front is, for poses (..., 3)."""
    heading = np.stack([-np.sin(poses[..., 2]), np.cos(poses[..., 2])], -1)
    return poses[..., :2] + FRONT * heading.astype(poses.dtype)


def in_hand(state: NDArray[np.float32], block: int) -> NDArray[np.float64]:
    """Where a block is in the robot's frame, in a state (names,): units to the right and ahead."""
    x, y = blocks_of(torch.from_numpy(state[None]))[0, block, 1:3].numpy() - state[:2]
    sin, cos = math.sin(state[2]), math.cos(state[2])
    return np.array([cos * x + sin * y, cos * y - sin * x])


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
        blocks = blocks_of(torch.from_numpy(self.states)).numpy()
        there, self.places = blocks[..., 0] > 0, blocks[..., 1:3]
        places = self.places
        steps = self.never = len(places)
        far = np.linalg.norm(places - places[:1], axis=2) > MOVED
        self.begins = np.where(far.any(0), far.argmax(0), self.never)
        changes = np.linalg.norm(np.diff(places, axis=0), axis=2) > MOVED / 10
        self.moving = np.concatenate([changes, np.zeros_like(changes[:1])])
        later = np.where(self.moving, np.arange(steps)[:, None], self.never)
        self.next = np.minimum.accumulate(later[::-1], 0)[::-1]
        self._regions, robot = regions_of(torch.from_numpy(self.states[0])).numpy(), self.states[:, :2]
        within = np.stack([_inside(region, places) & there for region in self._regions])
        visited = np.stack([_inside(region, robot) for region in self._regions])
        self.used = (within[:, -1] != within[:, 0]).any(1) | (visited[:, -1] != visited[:, 0])
        self._groups = np.where(there, MAX_REGIONS + np.arange(MAX_BLOCKS), -1)
        for number, inside in enumerate(within):
            self._groups[inside] = number

    def samples(self, steps: NDArray[np.int64]) -> Samples:
        """The states before some of its actions, with these actions."""
        states, actions = torch.from_numpy(self.states[steps]), torch.from_numpy(self.actions[steps])
        return Samples(states, actions, *self.loose(steps), self._ahead(steps), *self.freedoms(steps))

    def loose(self, steps: NDArray[np.int64]) -> tuple[Tensor, Tensor, Tensor]:
        """What belongs together at these steps, what of it may be displaced, and what may be missing."""
        groups = self._groups[steps]
        coming, target = self.next[steps].min(1), self.next[steps].argmin(1)
        on_its_way = (coming < self.never) & (coming > steps + GRIPPING)
        movable, droppable = (np.zeros((len(steps), MAX_REGIONS + MAX_BLOCKS), bool) for _ in range(2))
        for group in range(MAX_REGIONS + MAX_BLOCKS):
            members = groups == group
            exists = members.any(1) | (group < MAX_REGIONS and self._regions[group, 0] > 0)
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


CLEAR: Final = 0.3
"""Units between the middles of a displaced thing and of others."""
REACH: Final = 0.75
"""The greatest coordinate of a displaced thing."""
ON_THE_WAY: Final = 0.36
"""Units that a displaced block keeps from the way of the robot and of what it holds."""
TRIES: Final = 6
"""Places in which a robot with its block is tried."""
_MIRRORED: Final = torch.tensor([a._replace(turn=Turn((0, 2, 1)[a.turn])).number for a in ACTIONS])


def mirror(states: Tensor, actions: Tensor, generator: torch.Generator) -> Tensor:
    """Mirrors half of the states left to right, in place; returns the actions, mirrored likewise."""
    half = torch.rand(len(states), generator=generator) < 0.5
    sign = 1.0 - 2.0 * half[:, None]
    states[:, [0, 2, 3, 5]] *= sign
    fingers = states[:, FINGERS].clone()
    states[:, FINGERS] = torch.where(half[:, None], -fingers.flip(1), fingers)
    blocks, regions = blocks_of(states), regions_of(states)
    blocks[..., [1, 3, 4, 6]] *= sign[..., None]
    regions[..., [1, 3]] = torch.where(half[:, None, None], -regions[..., [3, 1]], regions[..., [1, 3]])
    return torch.where(half, _MIRRORED[actions], actions)


def rename(states: Tensor, generator: torch.Generator) -> None:
    """Exchanges the four colours with each other in each state, and the four shapes, in place."""
    for columns, rows in ((SHAPES, (blocks_of(states)[..., SHAPES],)), (COLOURS, _colours(states))):
        width = columns.stop - columns.start
        order = torch.rand(len(states), width, generator=generator).argsort(1)
        exchange = torch.nn.functional.one_hot(order, width).float()
        for names in rows:
            names.copy_(names @ exchange)


def _colours(states: Tensor) -> tuple[Tensor, Tensor]:
    return blocks_of(states)[..., COLOURS], regions_of(states)[..., 5:]


def displace(samples: Samples, generator: torch.Generator, *, pairs: bool) -> None:
    """Moves some things elsewhere, and removes some of those that may be missing, in place.

    With `pairs`, first the robot and the block that it is about to take, or holds, are turned and moved against all
    else. It sees them as before only where it does not see the arena.
    """
    waiting = (samples.freedom > Freedom.NONE) & (torch.rand(len(samples.freedom), generator=generator) < 0.8)
    for _ in range(TRIES if pairs else 0):
        waiting &= ~_move_pairs(samples, waiting, generator)
    states, movable, droppable = samples.states, samples.movable, samples.droppable
    shape = movable.shape
    moving = movable & (torch.rand(shape, generator=generator) < torch.where(droppable, 0.85, 0.5))
    dropped = moving & droppable & (torch.rand(shape, generator=generator) < 0.35)
    blocks, regions = blocks_of(states), regions_of(states)
    # Headings would tell which block is which, and how the arena is turned.
    turned = moving.any(1)[:, None] & ~samples.pair
    blocks[..., 3] += math.tau * torch.rand(turned.shape, generator=generator) * turned
    places = (torch.rand((*shape, 2), generator=generator) * 2 - 1) * REACH
    for group in movable.any(0).nonzero()[:, 0].tolist():
        mine = samples.groups == group
        old = (
            (regions[:, group, 1:3] + regions[:, group, 3:5]) / 2
            if group < MAX_REGIONS
            else blocks[:, group - MAX_REGIONS, 1:3]
        )
        new = places[:, group]
        apart = (blocks[..., 1:3] - new[:, None]).norm(dim=2) + 10.0 * (mine | (blocks[..., 0] < 0.5))
        free = (apart.amin(1) > CLEAR) & ((states[:, :2] - new).norm(dim=1) > CLEAR) & moving[:, group]
        free &= ((samples.way - new[:, None]).norm(dim=2).amin(1) > ON_THE_WAY) | ~mine.any(1)
        shift = (new - old) * free[:, None]
        blocks[..., 1:3] += shift[:, None] * mine[..., None]
        blocks[..., 0] *= ~(mine & dropped[:, group, None])
        if group < MAX_REGIONS:
            regions[:, group, 1:5] += shift.repeat(1, 2)
            regions[:, group, 0] *= ~dropped[:, group]


def _move_pairs(samples: Samples, waiting: Tensor, generator: torch.Generator) -> Tensor:
    """Turns robots with their blocks and their ways ahead, about `pivot`, and takes the free ones elsewhere.

    Returns those of the waiting ones, of shape (n,), for which there was room.
    """
    states, pair, pivot = samples.states, samples.pair, samples.pivot
    blocks, count = blocks_of(states), len(states)
    angle = math.tau * torch.rand(count, generator=generator)
    elsewhere = (torch.rand((count, 2), generator=generator) * 2 - 1) * REACH
    goal = torch.where((samples.freedom == Freedom.ANYWHERE)[:, None], elsewhere, pivot)
    sin, cos = angle.sin(), angle.cos()
    turn = torch.stack([cos, sin, -sin, cos], 1).unflatten(1, (2, 2))

    def moved(places: Tensor) -> Tensor:
        return goal[:, None] + (places - pivot[:, None]) @ turn

    robot, way, held = moved(states[:, None, :2])[:, 0], moved(samples.way), moved(blocks[..., 1:3])
    absent = 10.0 * (pair | (blocks[..., 0] < 0.5))[:, None]

    def gap(places: Tensor, least: float) -> Tensor:
        """To the nearest other block, or `least` if that is less."""
        return (torch.cdist(places, blocks[..., 1:3]) + absent).amin((1, 2)).clamp(max=least)

    taken = pair.int().argmax(1)[:, None, None].expand(-1, 1, 2)
    now, then = (places.gather(1, taken) for places in (blocks[..., 1:3], held))
    fits = waiting & (robot.abs().amax(1) < 1.0)
    fits &= (gap(way, ON_THE_WAY) >= gap(samples.way, ON_THE_WAY)) & (gap(then, CLEAR) >= gap(now, CLEAR))
    states[:, :2] = torch.where(fits[:, None], robot, states[:, :2])
    states[:, 2] += angle * fits
    both = fits[:, None] & pair
    blocks[..., 1:3] = torch.where(both[..., None], held, blocks[..., 1:3])
    blocks[..., 3] += angle[:, None] * both
    samples.way.copy_(torch.where(fits[:, None, None], way, samples.way))
    return fits
