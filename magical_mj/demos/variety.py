"""The diversity of demonstrations: strategies and paths."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.world import World
from magical_mj.demos.demonstration import Demonstration

TOUCHED: Final = 0.05  # world units; a block that moved less does not count as moved
SIDES: Final = 8  # from which a block can be taken
SAMPLES: Final = 50  # points of a path


class Diversity(NamedTuple):
    """What differs in a set of demonstrations."""

    orders: int
    """Different orders in which blocks were moved."""
    strategies: int
    """Different orders, with the side from which each block was moved."""
    ways: float
    """Mean distance (world units) between two paths of the robot, at equal fractions of their lengths."""


def diversity(demos: Iterable[Demonstration]) -> Diversity:
    """Compares demonstrations of one environment."""
    demos = list(demos)
    plans = [strategy(demo) for demo in demos]
    orders = {tuple(block for block, _ in plan) for plan in plans}
    ways = [_way(demo) for demo in demos]
    gaps = [float(np.hypot(*(one - other).T).mean()) for one, other in itertools.combinations(ways, 2)]
    return Diversity(len(orders), len(set(plans)), sum(gaps) / len(gaps) if gaps else 0.0)


def strategy(demo: Demonstration) -> tuple[tuple[int, int], ...]:
    """The blocks that were moved, in order, each with the side (0..7, by compass) from which the robot came."""
    poses = np.array([World(demo.scene).poses(qpos) for qpos in demo.qpos])  # (time, robot and blocks, 3)
    found = []
    for block in range(1, poses.shape[1]):
        moved = np.hypot(*(poses[:, block, :2] - poses[0, block, :2]).T) > TOUCHED
        if moved.any():
            when = int(moved.argmax())
            dx, dy = poses[when, 0, :2] - poses[when, block, :2]
            side = round(math.atan2(dy, dx) * SIDES / (2 * math.pi)) % SIDES
            found.append((when, block - 1, side))
    return tuple((block, side) for _, block, side in sorted(found))


def _way(demo: Demonstration) -> NDArray[np.float64]:
    """Points at equal distances along the robot's path. Shape (SAMPLES, 2)."""
    places = np.array([World(demo.scene).poses(qpos)[0, :2] for qpos in demo.qpos])
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
    at = np.linspace(0, length[-1], SAMPLES)
    return np.stack([np.interp(at, length, places[:, axis]) for axis in (0, 1)], axis=1)
