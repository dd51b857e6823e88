"""The samples of `relational`, and its assumptions about a task. Assumptions change samples, or add some.

- egocentric: positions in the arena do not matter, only positions in the robot's frame. (It changes no sample: the
  network does not receive positions in the arena.)
- mirror: the task is the same in a mirror.
- rename: colours and shapes are only labels: what matters is which objects share them. False for a task that names a
  colour.
- hindsight: the demonstrations aim to grip a block and to release it. Any path to these poses that is not much too long
  is as good as theirs. Such paths are played in the simulation of the demo scene (`magical_relational.hindsight`).
- grips: any manoeuvre that grips this block is as good, from any pose of the robot next to it, and after it was
  pushed. Such manoeuvres are found by random search in the same simulation (`magical_relational.grips`).
- displace: objects that a demonstration never involves do not matter, neither their positions nor their presence. On
  the path to a block, all other objects may be at other positions, including blocks that are used later. If
  `egocentric` was kept, the robot may have any pose together with this block, and may be rotated together with a block
  that it brings to a region. False if the absolute position of an object matters.

Each is false in some tasks. `magical_relational.method` keeps an assumption only if the demo score holds.
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
from magical_mj.scene.state_vector import FINGERS, MAX_BLOCKS, MAX_REGIONS, STATE_NAMES

MOVED: Final = 0.03
"""The least motion (units) of a block that counts as moved."""
GRIPPING: Final = 3
"""The robot counts as having reached a block this number of steps before the block moves."""
CARRIED: Final = 4
"""The least number of steps of a block's motion that counts as carrying or pushing."""
FRONT: Final = 0.2
"""The distance (units) of the robot's front from its centre."""
PATH_POINTS: Final = 16
"""The number of points that describe the robot's path ahead."""


class Freedom(IntEnum):
    """The allowed motions of the robot together with its current block."""

    NONE = 0
    TURNS = 1
    ANYWHERE = 2


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
    """Whether it is the block that the robot is about to grip, or moves, shape (n, MAX_BLOCKS)."""
    pivot: Tensor
    """The centre of rotation of the robot and this block, in the arena, shape (n, 2)."""
    freedom: Tensor
    """The `Freedom` of each, shape (n,)."""

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
    """A block's motion, from a first step until before another one."""

    block: int
    begin: int
    end: int


class Replay:
    """A demonstration, replayed: its states before and after each action, and the blocks' motions.

    Attributes:
        states: shape (steps + 1, names).
        saved: the engine's states, of the same length.
        actions: shape (steps,).
        never: a step after all others.
        positions: of the blocks, in the arena, shape (steps + 1, MAX_BLOCKS, 2).
        begins: the step of each block's first motion, or `never`, shape (MAX_BLOCKS,).
        next: for each step, the step of each block's next motion, or `never`, shape (steps + 1, MAX_BLOCKS).
        moving: whether each block moves in each step, shape (steps + 1, MAX_BLOCKS).
        used: whether a block or the robot enters or leaves each region, shape (MAX_REGIONS,).
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
        there, self.positions = blocks[..., 0] > 0, blocks[..., 1:3]
        positions = self.positions
        steps = self.never = len(positions)
        far = np.linalg.norm(positions - positions[:1], axis=2) > MOVED
        self.begins = np.where(far.any(0), far.argmax(0), self.never)
        changes = np.linalg.norm(np.diff(positions, axis=0), axis=2) > MOVED / 10
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

    def samples(self, steps: NDArray[np.int64]) -> Samples:
        """The states before these steps' actions, and the actions."""
        states, actions = torch.from_numpy(self.states[steps]), torch.from_numpy(self.actions[steps])
        return Samples(states, actions, *self.loose(steps), self._ahead(steps), *self.freedoms(steps))

    def loose(self, steps: NDArray[np.int64]) -> tuple[Tensor, Tensor, Tensor]:
        """The groups at these steps, those that may be displaced, and those that may be missing."""
        groups = self._groups[steps]
        coming, target = self.next[steps].min(1), self.next[steps].argmin(1)
        approaching = (coming < self.never) & (coming > steps + GRIPPING)
        movable, droppable = (np.zeros((len(steps), MAX_REGIONS + MAX_BLOCKS), bool) for _ in range(2))
        for group in range(MAX_REGIONS + MAX_BLOCKS):
            members = groups == group
            exists = members.any(1) | (group < MAX_REGIONS and self._regions[group, 0] > 0)
            begins = np.where(members, self.begins, self.never).min(1)
            used = group < MAX_REGIONS and bool(self.used[group])
            droppable[:, group] = exists & (begins == self.never) & (not used)
            comes_next = members[np.arange(len(steps)), target] & (coming < self.never)
            later = (steps < begins) & (group >= MAX_REGIONS)
            movable[:, group] = droppable[:, group] | (exists & ~comes_next & (approaching | later))
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
                pair[row, target], pivot[row], freedom[row] = True, self.positions[step, target], Freedom.ANYWHERE
            elif (self.next[step] <= step + 1).sum() == 1:
                around = self._around(step, target)
                if around is not None:
                    pair[row, target], pivot[row], freedom[row] = True, around, Freedom.TURNS
        return torch.from_numpy(pair), torch.from_numpy(pivot), torch.from_numpy(freedom)

    def motions(self) -> list[Motion]:
        """The motions of single blocks, of at least `CARRIED` steps. Short rests count as moving."""
        found = []
        for block in range(MAX_BLOCKS):
            steps = np.flatnonzero(self.moving[:, block])
            parts = np.split(steps, np.flatnonzero(np.diff(steps) > CARRIED) + 1)
            found += [Motion(block, int(part[0]), int(part[-1]) + 1) for part in parts if len(part) >= CARRIED]
        return found

    def _ahead(self, steps: NDArray[np.int64]) -> Tensor:
        """See `Samples.path`: the robot and its front in every other step, until it has reached a block."""
        coming = self.next[steps].min(1)
        last = np.where(coming > steps + 1, np.minimum(coming, self.never - 1), self.never - 1)
        later = np.minimum(steps[:, None] + np.arange(0, PATH_POINTS, 2), last[:, None])
        robot = self.states[later][..., :3]
        return torch.from_numpy(np.concatenate([robot[..., :2], front(robot)], 1))

    def _around(self, step: int, block: int) -> NDArray[np.float32] | None:
        """The centre of the region at the end of this block's motion, if it ends near that."""
        while step < self.never - 1 and self.next[step, block] <= step + CARRIED:
            step += 1
        for region in self._regions:
            middle, half = (region[1:3] + region[3:5]) / 2, (region[3:5] - region[1:3]).min() / 2
            if region[0] > 0 and np.linalg.norm(self.positions[step, block] - middle) < half - MOVED:
                return middle
        return None


def _inside(region: NDArray[np.float32], positions: NDArray[np.float32]) -> NDArray[np.bool_]:
    x, y = positions[..., 0], positions[..., 1]
    return (region[0] > 0) & (x >= region[1]) & (x <= region[3]) & (y >= region[2]) & (y <= region[4])


CLEAR: Final = 0.3
"""The least distance (units) between the centres of a displaced object and of others."""
REACH: Final = 0.75
"""The largest coordinate of a displaced object."""
PATH_CLEARANCE: Final = 0.36
"""The clearance (units) of a displaced block from the path of the robot and of its held block."""
ATTEMPTS: Final = 6
"""The number of attempts to place a robot with its block."""
_SIGNED: Final = ("x", "angle", "x_velocity", "angle_velocity")
"""Entries whose sign a mirror changes."""
ROBOT_SIGNED: Final = [STATE_NAMES.index(f"robot.{name}") for name in _SIGNED]
_BLOCK: Final = STATE_NAMES.index("block0.present")
BLOCK_SIGNED: Final = [STATE_NAMES.index(f"block0.{name}") - _BLOCK for name in _SIGNED]
X_MIN, X_MAX = (
    STATE_NAMES.index(f"region0.{name}") - STATE_NAMES.index("region0.present") for name in ("x_min", "x_max")
)
_MIRRORED: Final = torch.tensor([a._replace(turn=Turn((0, 2, 1)[a.turn])).number for a in ACTIONS])


def mirror(states: Tensor, actions: Tensor, generator: torch.Generator) -> Tensor:
    """Mirrors half of the states left to right, in place. Returns the actions with the same half mirrored."""
    half = torch.rand(len(states), generator=generator) < 0.5
    sign = 1.0 - 2.0 * half[:, None]
    states[:, ROBOT_SIGNED] *= sign
    fingers = states[:, FINGERS].clone()
    states[:, FINGERS] = torch.where(half[:, None], -fingers.flip(1), fingers)
    blocks, regions = blocks_of(states), regions_of(states)
    blocks[..., BLOCK_SIGNED] *= sign[..., None]
    left, right = regions[..., X_MIN].clone(), regions[..., X_MAX].clone()
    regions[..., X_MIN] = torch.where(half[:, None], -right, left)
    regions[..., X_MAX] = torch.where(half[:, None], -left, right)
    return torch.where(half, _MIRRORED[actions], actions)


def rename(states: Tensor, generator: torch.Generator) -> None:
    """Permutes the four colours and the four shapes in each state, in place."""
    for columns, rows in ((SHAPES, (blocks_of(states)[..., SHAPES],)), (COLOURS, _colours(states))):
        width = columns.stop - columns.start
        order = torch.rand(len(states), width, generator=generator).argsort(1)
        exchange = torch.nn.functional.one_hot(order, width).float()
        for names in rows:
            names.copy_(names @ exchange)


def _colours(states: Tensor) -> tuple[Tensor, Tensor]:
    return blocks_of(states)[..., COLOURS], regions_of(states)[..., 5:]


def displace(samples: Samples, generator: torch.Generator, *, pairs: bool) -> None:
    """Displaces some groups, and removes some of those that may be missing, in place.

    With `pairs`, the robot and the block that it is about to grip or holds are first rotated and moved relative to all
    other objects. Their relative positions stay the same. This changes the robot's pose in the arena.
    """
    waiting = (samples.freedom > Freedom.NONE) & (torch.rand(len(samples.freedom), generator=generator) < 0.8)
    for _ in range(ATTEMPTS if pairs else 0):
        waiting &= ~_move_pairs(samples, waiting, generator)
    states, movable, droppable = samples.states, samples.movable, samples.droppable
    shape = movable.shape
    moving = movable & (torch.rand(shape, generator=generator) < torch.where(droppable, 0.85, 0.5))
    dropped = moving & droppable & (torch.rand(shape, generator=generator) < 0.35)
    blocks, regions = blocks_of(states), regions_of(states)
    # Headings would reveal the identity of a block, and the arena's rotation.
    turned = moving.any(1)[:, None] & ~samples.pair
    blocks[..., 3] += math.tau * torch.rand(turned.shape, generator=generator) * turned
    positions = (torch.rand((*shape, 2), generator=generator) * 2 - 1) * REACH
    for group in movable.any(0).nonzero()[:, 0].tolist():
        mine = samples.groups == group
        old = (
            (regions[:, group, 1:3] + regions[:, group, 3:5]) / 2
            if group < MAX_REGIONS
            else blocks[:, group - MAX_REGIONS, 1:3]
        )
        new = positions[:, group]
        apart = (blocks[..., 1:3] - new[:, None]).norm(dim=2) + 10.0 * (mine | (blocks[..., 0] < 0.5))
        free = (apart.amin(1) > CLEAR) & ((states[:, :2] - new).norm(dim=1) > CLEAR) & moving[:, group]
        free &= ((samples.path - new[:, None]).norm(dim=2).amin(1) > PATH_CLEARANCE) | ~mine.any(1)
        shift = (new - old) * free[:, None]
        blocks[..., 1:3] += shift[:, None] * mine[..., None]
        blocks[..., 0] *= ~(mine & dropped[:, group, None])
        if group < MAX_REGIONS:
            regions[:, group, 1:5] += shift.repeat(1, 2)
            regions[:, group, 0] *= ~dropped[:, group]


def _move_pairs(samples: Samples, waiting: Tensor, generator: torch.Generator) -> Tensor:
    """Rotates robots with their blocks and paths about `pivot`, and moves the free ones to other positions.

    Returns those of the waiting ones, shape (n,), that could be placed.
    """
    states, pair, pivot = samples.states, samples.pair, samples.pivot
    blocks, count = blocks_of(states), len(states)
    angle = math.tau * torch.rand(count, generator=generator)
    elsewhere = (torch.rand((count, 2), generator=generator) * 2 - 1) * REACH
    goal = torch.where((samples.freedom == Freedom.ANYWHERE)[:, None], elsewhere, pivot)
    sin, cos = angle.sin(), angle.cos()
    turn = torch.stack([cos, sin, -sin, cos], 1).unflatten(1, (2, 2))

    def moved(positions: Tensor) -> Tensor:
        return goal[:, None] + (positions - pivot[:, None]) @ turn

    robot, path, held = moved(states[:, None, :2])[:, 0], moved(samples.path), moved(blocks[..., 1:3])
    absent = 10.0 * (pair | (blocks[..., 0] < 0.5))[:, None]

    def gap(positions: Tensor, least: float) -> Tensor:
        """The distance to the nearest other block, at most `least`."""
        return (torch.cdist(positions, blocks[..., 1:3]) + absent).amin((1, 2)).clamp(max=least)

    taken = pair.int().argmax(1)[:, None, None].expand(-1, 1, 2)
    now, then = (positions.gather(1, taken) for positions in (blocks[..., 1:3], held))
    fits = waiting & (robot.abs().amax(1) < 1.0)
    fits &= (gap(path, PATH_CLEARANCE) >= gap(samples.path, PATH_CLEARANCE)) & (gap(then, CLEAR) >= gap(now, CLEAR))
    states[:, :2] = torch.where(fits[:, None], robot, states[:, :2])
    states[:, 2] += angle * fits
    both = fits[:, None] & pair
    blocks[..., 1:3] = torch.where(both[..., None], held, blocks[..., 1:3])
    blocks[..., 3] += angle[:, None] * both
    samples.path.copy_(torch.where(fits[:, None, None], path, samples.path))
    return fits
