"""Noise on the planner's costs: with it, different experts solve a task in different ways."""

from __future__ import annotations

from typing import Any

import numpy as np


class Noise:
    """Random amounts that are added to costs before the least is chosen.

    Args:
        rng: the random generator.
        strength: 0 for the plan that seems best, 1 for the variety of an expert.
    """

    def __init__(self, rng: np.random.Generator, strength: float) -> None:
        self.rng, self.strength = rng, strength

    def __call__(self, spread: float, shape: tuple[int, ...] = ()) -> Any:
        """Independent uniform draws between 0 and `spread` times the strength; a float, or an array of this shape."""
        draws = spread * self.strength * self.rng.random(shape)
        return draws if shape else float(draws)
