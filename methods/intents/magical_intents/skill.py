"""The skill: a network that brings an object to a place, and the loss that it learns by."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn

from magical_intents.practice import Steps
from magical_intents.scenes import ROBOT
from magical_intents.symmetries import MIRRORED, changed, drawn, moved
from magical_mj.learners.networks import ONE_HOT, SHAPES, blocks_of, maxima
from magical_mj.observations import FINGERS

AROUND: Final = 64
HIDDEN: Final = 256
BATCH: Final = 256
"""The number of steps in a batch."""
NOISE: Final = 0.012
"""The standard deviation of noise on positions and angles (units, rad)."""
FINGER_NOISE: Final = 0.04
"""The same for the fingers (rad)."""
PLACE_NOISE: Final = 0.015


class Skill(nn.Module):
    """Acts to bring an object to a place. It observes positions in the robot's frame, and no angles of blocks."""

    def __init__(self) -> None:
        super().__init__()
        self.other = nn.Sequential(nn.Linear(5 + 2 + 2 + 4, AROUND), nn.ReLU(), nn.Linear(AROUND, AROUND))
        self.act = nn.Sequential(
            nn.Linear(AROUND + 2 + 4 + 4 + 1 + 4 + 5 + 5 + 5 + 5, HIDDEN),
            nn.ReLU(),
            nn.Linear(HIDDEN, HIDDEN),
            nn.ReLU(),
            nn.Linear(HIDDEN, HIDDEN),
            nn.ReLU(),
            nn.Linear(HIDDEN, ONE_HOT),
        )

    def forward(self, now: Tensor, objects: Tensor, places: Tensor, vias: Tensor) -> Tensor:
        """Logits (n, 18) for states (n, names), objects (n,), their places (n, 2), and points on the way (n, 2)."""
        position, angle = now[:, None, :2], now[:, 2:3]
        sin, cos = angle.sin(), angle.cos()
        frame = torch.stack([cos, sin, -sin, cos], 2).unflatten(2, (2, 2))[:, 0].transpose(1, 2)
        blocks = blocks_of(now)
        blocks = blocks[:, : int(blocks[..., 0].sum(1).max())]
        drives = (objects >= ROBOT)[:, None].float()
        own = nn.functional.one_hot(objects, ROBOT + 1)[:, : blocks.shape[1], None].to(now.dtype)
        seen = (blocks[..., 1:3] - position) @ frame
        goal, via = (((points[:, None] - position) @ frame)[:, 0] for points in (places, vias))
        block, hand = (own * blocks).sum(1), (own * seen).sum(1)
        others = [_near(seen), seen - hand[:, None], seen - goal[:, None], blocks[..., SHAPES]]
        around = maxima(self.other(torch.cat(others, 2)), (blocks[..., 0] > 0) & (own[..., 0] < 0.5))
        robot = [now[:, FINGERS], now[:, :2], sin, cos, block[:, 1:3], places, drives]
        parts = [
            around,
            *robot,
            block[:, SHAPES],
            _near(hand),
            _near(goal),
            _near(via),
            _near((goal - hand) * (1 - drives)),
        ]
        return self.act(torch.cat(parts, 1))


def _near(seen: Tensor) -> Tensor:
    """Features (..., 5) of positions (..., 2) in the robot's frame: the position, its direction, and the nearness."""
    distance = seen.norm(dim=-1, keepdim=True)
    return torch.cat([seen, seen / (distance + 1e-3), 0.3 / (0.2 + distance)], -1)


def skill_loss(network: Skill, data: Sequence[Steps], rng: np.random.Generator) -> Tensor:
    """-E log pi(a | s, object, place) in random steps."""
    chosen = []
    for number in rng.integers(len(data), size=BATCH // 4):
        rows = rng.integers(len(data[number].actions), size=4)
        chosen.append([values[rows] for values in data[number]])
    states, right, objects, places, vias = (
        torch.from_numpy(np.concatenate(part)) for part in zip(*chosen, strict=True)
    )
    by = drawn(BATCH, rng)

    def noise(scale: float, *shape: int) -> Tensor:
        return scale * torch.from_numpy(rng.standard_normal((BATCH, *shape), np.float32))

    states[:, :3] += noise(NOISE, 3)
    states[:, FINGERS] += noise(FINGER_NOISE, 2)
    blocks = blocks_of(states)
    blocks[..., 1:3] += noise(NOISE, blocks.shape[1], 2)
    points = (moved(part + noise(PLACE_NOISE, 2), by) for part in (places, vias))
    logits = network(changed(states[:, None], by)[:, 0], objects, *points)
    return nn.functional.cross_entropy(logits, torch.where(by.mirrored, MIRRORED[right], right))
