"""The dynamics axis: random force caps for the robot's motors and for the blocks' friction with the ground."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from magical_mj.scene import Dynamics

RANGES: Final[Mapping[str, tuple[float, float]]] = MappingProxyType(
    {
        "drive_force": (2.2, 3.5),
        "turn_torque": (0.7, 1.5),
        "finger_torque": (2.5, 4.5),
        "block_friction_force": (1.0, 1.8),
        "block_friction_torque": (0.07, 0.15),
    }
)
"""Force or torque cap -> the range from which it is drawn, independently and uniformly, as in the released code."""


def draw_dynamics(rng: np.random.Generator) -> Dynamics:
    """Five independent uniform draws; the values for blocks hold for all blocks."""
    return Dynamics(**{name: low + (high - low) * rng.random() for name, (low, high) in RANGES.items()})
