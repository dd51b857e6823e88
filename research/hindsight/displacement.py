"""Displacement in which the robot is moved, too, with the block that it is about to take or holds."""

from __future__ import annotations

import math
from typing import Final

import torch
from torch import Tensor

from magical_mj.learners.assumptions import CLEAR, REACH
from magical_mj.learners.relational_network import blocks_of, regions_of
from magical_mj.scene.state_vector import MAX_REGIONS
from research.hindsight.samples import Freedom, FreeSamples

ON_THE_WAY: Final = 0.36
"""Units that a displaced block keeps from the way of the robot and of what it holds."""
TRIES: Final = 6
"""Places in which a robot with its block is tried."""


def displace(samples: FreeSamples, generator: torch.Generator) -> None:
    """Moves some things elsewhere, and removes some of those that may be missing, in place.

    First the robot and the block that it is about to take, or holds, are turned and moved against all else.
    """
    waiting = (samples.freedom > Freedom.NONE) & (torch.rand(len(samples.freedom), generator=generator) < 0.8)
    for _ in range(TRIES):
        waiting &= ~_move_pairs(samples, waiting, generator)
    shown = samples.shown
    states, movable, droppable = shown.states, shown.movable, shown.droppable
    shape = movable.shape
    moving = movable & (torch.rand(shape, generator=generator) < torch.where(droppable, 0.85, 0.5))
    dropped = moving & droppable & (torch.rand(shape, generator=generator) < 0.35)
    blocks, regions = blocks_of(states), regions_of(states)
    # Headings would tell which block is which, and how the arena is turned.
    turned = moving.any(1)[:, None] & ~samples.pair
    blocks[..., 3] += math.tau * torch.rand(turned.shape, generator=generator) * turned
    places = (torch.rand((*shape, 2), generator=generator) * 2 - 1) * REACH
    for group in movable.any(0).nonzero()[:, 0].tolist():
        mine = shown.groups == group
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


def _move_pairs(samples: FreeSamples, waiting: Tensor, generator: torch.Generator) -> Tensor:
    """Turns robots with their blocks and their ways ahead, about `pivot`, and takes the free ones elsewhere.

    Returns:
        Those of the waiting ones, of shape (n,), for which there was room.
    """
    states, pair, pivot = samples.shown.states, samples.pair, samples.pivot
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
