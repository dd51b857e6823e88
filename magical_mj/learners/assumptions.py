"""What `relational` may assume about a task beyond its demonstrations: each assumption makes more samples of them.

- egocentric: where in the arena something happens does not matter, only how it looks from the robot. (No samples: the
  network is not told where in the arena it is.)
- mirror: the task is the same in a mirror.
- rename: colours and shapes are names: what matters is which things share them. False for a task that names a colour.
- displace: what a demonstration never involves does not matter: not where it is, nor whether it is there. On the way to
  a block, everything else may be elsewhere, and so may blocks that come later. False where the mere place of a thing
  counts.
- detours: whoever has left a demonstration's way does well to come back to it. The robot drives away from the
  demonstration in the simulation of the demo scene, and the reverse of what it did is what a sample shows.

Each is false somewhere. `magical_mj.learners.relational` keeps those with which the demo scene does not suffer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_mj.demos import Demonstration
from magical_mj.engine import Engine
from magical_mj.learners.relational_network import COLOURS, SHAPES, blocks_of, regions_of
from magical_mj.scene.actions import ACTIONS, NOOP, Drive, Gripper, Turn
from magical_mj.scene.state_vector import FINGERS, MAX_BLOCKS, MAX_REGIONS
from magical_mj.utils.errors import PhysicsError

MOVED: Final = 0.03
"""Units that a block must move to count as moved."""
GRIPPING: Final = 3
"""Steps before a block moves, in which the robot counts as being there."""
CLEAR: Final = 0.3
"""Units between the middles of a displaced thing and of others."""
REACH: Final = 0.75
"""The greatest coordinate of a displaced thing."""
BACK: Final = (0.2, 0.6, 0.08)
"""How far at most the robot (units, rad) and the blocks (units) may be from where a detour began, at its end."""
PIECES: Final = 3
"""The greatest number of actions in a detour, each for up to LASTING steps."""
LASTING: Final = 8
_NEGATED: Final = {0: 0, 1: 2, 2: 1}
_MIRRORED: Final = torch.tensor([a._replace(turn=Turn(_NEGATED[a.turn])).number for a in ACTIONS])


class Samples(NamedTuple):
    """States and what was done in them."""

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

    def of(self, rows: Tensor) -> Samples:
        """Some of them."""
        return Samples(*(values[rows] for values in self))


def demonstrated(demonstrations: Sequence[Demonstration], excursions: int, seed: int) -> tuple[Samples, Samples]:
    """The samples of demonstrations without no-ops, and those of detours from them, which are played."""
    rng = np.random.default_rng(seed)
    with closing(Engine.of_scene(demonstrations[0].scene)) as engine:
        ways = [Replay(engine, demonstration) for demonstration in demonstrations]
        steps = [np.flatnonzero(way.actions != NOOP) for way in ways]
        parts = [way.samples(number) for way, number in zip(ways, steps, strict=True)]
        detours = []
        for _ in range(excursions):
            way = ways[rng.integers(len(ways))]
            step = int(rng.integers(np.flatnonzero(way.actions != NOOP)[-1] + 1))
            detours.append(_detour(engine, way, step, rng))
    return _joined(parts), _joined([part for part in detours if part is not None] or parts)


class Replay:
    """A demonstration, replayed: its states before and after each action, and who moved when."""

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
        places = blocks_of(tensor)[..., 1:3].numpy()
        steps, never = len(places), len(places)
        far = np.linalg.norm(places - places[:1], axis=2) > MOVED
        self.begins = np.where(far.any(0), far.argmax(0), never)
        """Step at which each block begins to move; `never` if it does not."""
        changes = np.linalg.norm(np.diff(places, axis=0), axis=2) > MOVED / 10
        changes = np.concatenate([changes, np.zeros_like(changes[:1])])
        later = np.where(changes, np.arange(steps)[:, None], never)
        self.next = np.minimum.accumulate(later[::-1], 0)[::-1]
        """Step at which each block moves next, from each step on, shape (steps, MAX_BLOCKS)."""
        regions, robot = regions_of(tensor[:1])[0].numpy(), self.states[:, :2]
        within = np.stack([_inside(region, places) & (places[..., 0] != 0) for region in regions])
        visited = np.stack([_inside(region, robot) for region in regions])
        self.used = (within[:, -1] != within[:, 0]).any(1) | (visited[:, -1] != visited[:, 0])
        """Which regions a block or the robot enters or leaves, shape (MAX_REGIONS,)."""
        self.never = never

    def samples(self, steps: NDArray[np.int64]) -> Samples:
        """The states before some of its actions, with these actions."""
        return Samples(torch.from_numpy(self.states[steps]), torch.from_numpy(self.actions[steps]), *self.loose(steps))

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


def _joined(parts: Sequence[Samples]) -> Samples:
    return Samples(*(torch.cat(values) for values in zip(*parts, strict=True)))


def _detour(engine: Engine, way: Replay, step: int, rng: np.random.Generator) -> Samples | None:
    """The way back from a random excursion that begins at a step; None if it does not lead back."""
    engine.set_state(way.saved[step])
    start = way.states[step]
    gripper = ACTIONS[int(way.actions[max(step - 1, 0)])].gripper if step else Gripper.OPEN
    away: list[int] = []
    for _ in range(rng.integers(1, PIECES + 1)):
        drive, turn = Drive(int(rng.choice([2, 2, 2, 0, 1]))), Turn(int(rng.integers(3)))
        if drive or turn:
            away += [9 * gripper + 3 * turn + drive] * int(rng.integers(2, LASTING + 1))
    played: list[int] = []
    try:
        for action in away:
            before = engine.get_state()
            engine.step(action)
            if gripper == Gripper.OPEN and _shifted(engine.state_vector(), start) > BACK[2] / 4:
                engine.set_state(before)  # a free robot moves nothing on its way
                break
            played.append(action)
        if len(played) < 2:
            return None
        engine.step(9 * gripper)  # it comes to rest
        back, states = [_reversed(action) for action in reversed(played)], []
        for action in back:
            states.append(engine.state_vector())
            engine.step(action)
    except PhysicsError:
        return None
    end = engine.state_vector()
    turned = abs(math.remainder(float(end[2] - start[2]), math.tau))
    if np.linalg.norm(end[:2] - start[:2]) > BACK[0] or turned > BACK[1] or _shifted(end, start) > BACK[2]:
        return None
    loose = (part.expand(len(back), -1) for part in way.loose(np.array([step])))
    return Samples(torch.from_numpy(np.array(states)), torch.tensor(back), *loose)


def _shifted(state: NDArray[np.float32], start: NDArray[np.float32]) -> float:
    """How far the block that moved farthest is from where it was."""
    now, before = (blocks_of(torch.from_numpy(values[None]))[0, :, 1:3] for values in (state, start))
    return float((now - before).abs().max())


def _reversed(action: int) -> int:
    """The action that undoes another one."""
    parts = ACTIONS[action]
    return parts._replace(turn=Turn(_NEGATED[parts.turn]), drive=Drive(_NEGATED[parts.drive])).number


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


def displace(samples: Samples, generator: torch.Generator) -> None:
    """Moves some things elsewhere, and removes some of those that may be missing, in place."""
    states, movable, droppable = samples.states, samples.movable, samples.droppable
    shape = movable.shape
    moving = movable & (torch.rand(shape, generator=generator) < torch.where(droppable, 0.85, 0.5))
    dropped = moving & droppable & (torch.rand(shape, generator=generator) < 0.35)
    blocks, regions = blocks_of(states), regions_of(states)
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
        shift = (new - old) * free[:, None]
        blocks[..., 1:3] += shift[:, None] * mine[..., None]
        blocks[..., 0] *= ~(mine & dropped[:, group, None])
        if group < MAX_REGIONS:
            regions[:, group, 1:5] += shift.repeat(1, 2)
            regions[:, group, 0] *= ~dropped[:, group]
