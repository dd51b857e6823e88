"""What `relational` may assume about a task beyond its demonstrations: each assumption changes samples, or adds some.

- egocentric: where in the arena something happens does not matter, only how it looks from the robot. (It changes no
  sample: the network is not told where in the arena it is.)
- mirror: the task is the same in a mirror.
- rename: colours and shapes are names: what matters is which things share them. False for a task that names a colour.
- hindsight: what the demonstrations pursue is to take a block, and to leave it: any way there that is not much too long
  is as good as theirs. Such ways are played in the simulation of the demo scene (`magical_mj.learners.hindsight`).
- displace: what a demonstration never involves does not matter: not where it is, nor whether it is there. On the way to
  a block, everything else may be elsewhere, and so may blocks that come later; where `egocentric` was kept, the robot
  may be anywhere with that block, and turned with a block that it brings to a region. False where the mere place of a
  thing counts.

Each is false somewhere. `magical_mj.learners.relational` keeps those with which the demo scene does not suffer.
"""

from __future__ import annotations

import math
from typing import Final

import torch
from torch import Tensor

from magical_mj.learners.relational_network import COLOURS, SHAPES, blocks_of, regions_of
from magical_mj.learners.relational_samples import Freedom, Samples
from magical_mj.scene.actions import ACTIONS, Turn
from magical_mj.scene.state_vector import FINGERS, MAX_REGIONS

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

    Returns:
        Those of the waiting ones, of shape (n,), for which there was room.
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
