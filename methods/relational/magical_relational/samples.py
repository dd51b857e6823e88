"""The samples of `relational`, and its assumptions about a task. Assumptions change samples, or add some.

- egocentric: positions in the arena do not matter, only positions in the robot's frame. (It changes no sample: the
  network does not receive positions in the arena.)
- mirror: the task is the same in a mirrored arena.
- rename: colours and shapes are only labels, and the task depends only on which objects share them. False for a task
  that names a colour.
- hindsight: the demonstrations aim to grip a block and to release it. Any other path to these poses is as good, unless
  it is much longer than necessary. Such paths are played in the simulation of the demo scene
  (`magical_relational.hindsight`).
- grips: any manoeuvre that grips this block is as good, from any pose of the robot next to it, and after it was
  pushed. Such manoeuvres are found by random search in the same simulation (`magical_relational.grips`).
- displace: objects that a demonstration does not involve may have any position, or be missing. While the robot
  approaches a block, all other objects may be at other positions, including blocks that it moves later. If `egocentric`
  was kept, the robot may have any pose together with this block. While it brings a block to a region, both may be
  rotated about the region. False if the absolute position of an object matters.
- delivery: a demonstration is a series of deliveries. A block that is only bumped is not involved
  (`magical_relational.replay`). Releases of blocks are additional samples. Fingers that hold nothing may be closed.
  False if a bump, or an empty hand, matters.
- contrast: a block that no demonstration moves may have another shape and colour. With the regions, and with the blocks
  in regions, it must share its shape or colour as an unmoved block of the demo scene does. Some of these blocks are put
  in front of the robot. A robot that holds such a block releases it. False if an unmoved block matters in another way.

Each is false in some tasks. `magical_relational.method` keeps an assumption only if the demo score does not fall much.
"""

from __future__ import annotations

import math
from typing import Final

import torch
from torch import Tensor

from magical_mj.actions import ACTIONS, NOOP, Turn
from magical_mj.learners.networks import COLOURS, SHAPES, blocks_of, regions_of
from magical_mj.observations import FINGERS, MAX_BLOCKS, MAX_REGIONS, STATE_NAMES
from magical_relational.replay import CLOSING, Freedom, Samples

CLEAR: Final = 0.3
"""The smallest distance (units) between the centres of a displaced object and of others."""
REACH: Final = 0.75
"""The largest coordinate (units) of a displaced object."""
PATH_CLEARANCE: Final = 0.36
"""The smallest distance (units) of a displaced block from the paths of the robot and of its held block."""
FACING: Final = (0.4, 1.3, 0.4)
"""Blocks in front of the robot: the smallest and the largest distance (units), and the bearing's deviation (rad)."""
EMPTY: Final = 0.5
"""The fingers are empty if all blocks are farther (units) than this from the robot's centre."""
CLOSED: Final = 0.3
"""The share of closed fingers among samples with empty fingers whose action opens them."""
OPENED: Final = torch.tensor([math.pi / 8, -math.pi / 8])
"""The angles (rad) of open fingers."""
ATTEMPTS: Final = 6
"""The number of attempts to find a free pose for a robot and its block."""
_SIGNED: Final = ("x", "angle", "x_velocity", "angle_velocity")
"""The entries whose sign changes in a mirror."""
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
    """Displaces some groups in place, and removes some of the groups that may be missing.

    With `pairs`, the robot and its current block are first rotated and moved together. So the robot's pose in the arena
    changes, but the block's pose in the robot's frame does not.
    """
    waiting = (samples.freedom > Freedom.NONE) & (torch.rand(len(samples.freedom), generator=generator) < 0.8)
    for _ in range(ATTEMPTS if pairs else 0):
        waiting &= ~_move_pairs(samples, waiting, generator)
    states, movable, droppable = samples.states, samples.movable, samples.droppable
    shape = movable.shape
    moving = movable & (torch.rand(shape, generator=generator) < torch.where(droppable, 0.85, 0.5))
    dropped = moving & droppable & (torch.rand(shape, generator=generator) < 0.35)
    blocks, regions = blocks_of(states), regions_of(states)
    # Their old headings would identify the blocks, and reveal the arena's rotation.
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


def contrast(samples: Samples, generator: torch.Generator) -> None:
    """Gives unmoved blocks outside of regions other shapes and colours, and puts some in front of robots, in place."""
    states, here = samples.states, torch.arange(len(samples.states))
    blocks, unmoved = blocks_of(states), samples.droppable[:, MAX_REGIONS:] & samples.looks.any(1, keepdim=True)
    changed = unmoved & (torch.rand(unmoved.shape, generator=generator) < 0.5)
    looks = torch.multinomial(samples.looks + 1e-9, MAX_BLOCKS, replacement=True, generator=generator)
    for columns, numbers in ((SHAPES, looks // 4), (COLOURS, looks % 4)):
        new = torch.nn.functional.one_hot(numbers, 4).float()
        blocks[..., columns] = torch.where(changed[..., None], new, blocks[..., columns])
    chosen = (torch.rand(unmoved.shape, generator=generator) * (unmoved & (blocks[..., 0] > 0.5))).argmax(1)
    angle = states[:, 2] + FACING[2] * torch.randn(len(here), generator=generator)
    distance = FACING[0] + (FACING[1] - FACING[0]) * torch.rand(len(here), generator=generator)
    position = states[:, :2] + distance[:, None] * torch.stack([-angle.sin(), angle.cos()], 1)
    apart = (blocks[..., 1:3] - position[:, None]).norm(dim=2) + 10.0 * (blocks[..., 0] < 0.5)
    apart[here, chosen] = 10.0
    fits = unmoved[here, chosen] & (position.abs().amax(1) < REACH) & (apart.amin(1) > CLEAR)
    fits &= (samples.path - position[:, None]).norm(dim=2).amin(1) > PATH_CLEARANCE
    fits &= torch.rand(len(here), generator=generator) < 0.7
    blocks[here, chosen, 1:3] = torch.where(fits[:, None], position, blocks[here, chosen, 1:3])


def exchange(samples: Samples, chance: Tensor, generator: torch.Generator) -> None:
    """Exchanges the looks of current blocks and unmoved ones, in place. The robot releases such a block anywhere.

    `chance`, shape (n,), is the probability of an exchange. The robot must hold the block, or have released it.
    """
    blocks, rows = blocks_of(samples.states), torch.arange(len(samples.states))
    unmoved = samples.droppable[:, MAX_REGIONS:] & (blocks[..., 0] > 0.5)
    other = (torch.rand(unmoved.shape, generator=generator) * unmoved).argmax(1)
    mine = samples.pair.int().argmax(1)
    fits = samples.pair.any(1) & unmoved[rows, other] & (torch.rand(len(rows), generator=generator) < chance)
    rows, other, mine = rows[fits], other[fits], mine[fits]
    looks = blocks[..., SHAPES.start : COLOURS.stop]
    looks[rows, mine], looks[rows, other] = looks[rows, other], looks[rows, mine]
    samples.groups[rows, mine] = MAX_REGIONS + mine
    samples.freedom[rows] = Freedom.ANYWHERE
    samples.actions[rows] = torch.where(samples.actions[rows] < CLOSING, samples.actions[rows], NOOP)


def close(samples: Samples, generator: torch.Generator) -> None:
    """Closes the fingers of some robots that are far from all blocks and open their fingers, in place."""
    states, blocks = samples.states, blocks_of(samples.states)
    apart = (blocks[..., 1:3] - states[:, None, :2]).norm(dim=2) + 10.0 * (blocks[..., 0] < 0.5)
    chosen = (samples.actions < CLOSING) & (apart.amin(1) > EMPTY)
    chosen &= torch.rand(len(states), generator=generator) < CLOSED
    share = (2 * torch.rand((len(states), 1), generator=generator) - 1).clamp(min=0)
    states[:, FINGERS] = torch.where(chosen[:, None], share * OPENED, states[:, FINGERS])


def _move_pairs(samples: Samples, waiting: Tensor, generator: torch.Generator) -> Tensor:
    """Rotates waiting robots with their blocks and paths about `pivot`. With `Freedom.ANYWHERE`, also moves them.

    A robot stays as it was if the new poses are not free. Returns which robots have changed, shape (n,).
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
        """The distance to the nearest other block, but at most `least`."""
        return (torch.cdist(positions, blocks[..., 1:3]) + absent).amin((1, 2)).clamp(max=least)

    taken = pair.int().argmax(1)[:, None, None].expand(-1, 1, 2)
    now, then = (positions.gather(1, taken) for positions in (blocks[..., 1:3], held))
    fits = waiting & (robot.abs().amax(1) < 1.0)
    fits &= (gap(path, PATH_CLEARANCE) >= gap(samples.path, PATH_CLEARANCE)) & (gap(then, CLEAR) >= gap(now, CLEAR))
    fits &= (samples.freedom != Freedom.REMOVES) | ~_inside(samples, path[:, -1])
    states[:, :2] = torch.where(fits[:, None], robot, states[:, :2])
    states[:, 2] += angle * fits
    both = fits[:, None] & pair
    blocks[..., 1:3] = torch.where(both[..., None], held, blocks[..., 1:3])
    blocks[..., 3] += angle[:, None] * both
    samples.path.copy_(torch.where(fits[:, None, None], path, samples.path))
    return fits


def _inside(samples: Samples, positions: Tensor) -> Tensor:
    """Whether positions (n, 2) are in a region, shape (n,)."""
    regions = regions_of(samples.states)
    depth = torch.minimum(positions[:, None] - regions[..., 1:3], regions[..., 3:5] - positions[:, None]).amin(2)
    return ((regions[..., 0] > 0.5) & (depth > 0.0)).any(1)
