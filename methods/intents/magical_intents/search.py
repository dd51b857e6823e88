"""Search for a final scene that the scorer prefers: one object after the other is put where the score rises most.

An object has few options: the nearest free place to it in each cell of the arena, in each region, and next to each
block. None depends on the language of intents.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_intents.scorer import Scorer
from magical_mj.learners.networks import blocks_of, regions_of
from magical_mj.tasks.planning import REACHABLE, places_anywhere

EDGES: Final = (-0.8, -0.3, 0.3, 0.8)
"""The borders between the arena's cells, in x and y (units). Outer cells are places at walls and in corners."""
FREE: Final = 0.3
"""The least distance (units) of a place from other blocks."""
CLEAR: Final = 0.34
"""The same for the robot."""
TOUCHING: Final = 0.4
"""Places at most this far from a block are next to it."""
INSIDE: Final = 0.06
"""The least distance of a place in a region from its border."""
ROBOT_REACH: Final = 0.78
"""The largest coordinate of the robot's places."""
MOST_MOVES: Final = 5
LEAST_GAIN: Final = 0.5
"""An object is moved if the logit of the score rises by more."""
INNER: Final = np.stack(np.meshgrid(*2 * [np.linspace(0.1, 0.9, 7)]), -1).reshape(-1, 2)
"""Places in a region, as shares of its sides."""

Floats = NDArray[np.float32]


@torch.inference_mode()
def searched(scorer: Scorer, context: Tensor, initial: Tensor) -> Tensor:
    """The final states (n, names) that are found from initial states (n, names).

    Args:
        scorer: the network.
        context: the context of each episode, of demonstrations or a sentence, shape (n, CONTEXT, SIZE).
        initial: the states.
    """
    return torch.stack([_searched(scorer, *each) for each in zip(context, initial, strict=True)])


def _searched(scorer: Scorer, context: Tensor, initial: Tensor) -> Tensor:
    encoded, now = scorer.encoded(initial[None], context[None]), initial
    best = scorer.scored(encoded, now[None]).scores
    for _ in range(MOST_MOVES):
        ends = torch.stack([now, *options(now)])
        score, chosen = scorer.scored(encoded.repeated(len(ends)), ends).scores.max(0)
        if score <= best + LEAST_GAIN:
            break
        best, now = score, ends[chosen]
    return now


def options(state: Tensor) -> list[Tensor]:
    """States (names,) with one object at another place."""
    blocks, found = blocks_of(state), list[Tensor]()
    count = int(blocks[:, 0].sum())
    positions = torch.cat([blocks[:count, 1:3], state[None, :2]]).numpy()
    boxes = regions_of(state)[regions_of(state)[:, 0] > 0, 1:5].numpy()
    for number in range(count + 1):
        for place in places(positions, number, boxes):
            end = state.clone()
            target = blocks_of(end)[number, 1:3] if number < count else end[:2]
            target.copy_(torch.from_numpy(place))
            found.append(end)
    return found


def places(positions: Floats, number: int, boxes: Floats) -> list[Floats]:
    """The places of one object, with the positions of all blocks and, last, the robot, and with the regions' boxes."""
    is_robot, own = number == len(positions) - 1, positions[number]
    every = np.concatenate([_ANYWHERE, *(box[:2] + INNER * (box[2:] - box[:2]) for box in boxes)])
    others = np.delete(positions[:-1], [] if is_robot else number, axis=0)
    gaps = np.linalg.norm(every[:, None] - others, axis=2)
    free = gaps.min(axis=1, initial=math.inf) >= (CLEAR if is_robot else FREE)
    free &= np.abs(every).max(axis=1) <= (ROBOT_REACH if is_robot else REACHABLE)
    every, gaps = every[free], gaps[free]
    cells = 5 * np.searchsorted(EDGES, every[:, 0]) + np.searchsorted(EDGES, every[:, 1])
    groups = [cells == cell for cell in range(25)]
    groups += [((every > box[:2] + INSIDE) & (every < box[2:] - INSIDE)).all(axis=1) for box in boxes]
    groups += [gap <= TOUCHING for gap in gaps.T]
    away = np.linalg.norm(every - own, axis=1)
    return [every[np.where(group, away, math.inf).argmin()] for group in groups if group.any()]


_ANYWHERE: Final = np.array(places_anywhere(), np.float32)
