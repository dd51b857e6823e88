"""Noise on the planner's costs: it makes one expert go about a task in another way than the next."""

from __future__ import annotations

from typing import Any

import numpy as np


class Noise:
    """Draws by which costs are varied before the least is chosen.

    Args:
        rng: where the draws come from.
        strength: 0 for the plan that seems best, 1 for as much variety as an expert shows.
    """

    def __init__(self, rng: np.random.Generator, strength: float) -> None:
        self.rng, self.strength = rng, strength

    def __call__(self, spread: float, shape: tuple[int, ...] = ()) -> Any:
        """Independent uniform draws from 0 to `spread` times the strength; a float, or an array of the shape."""
        draws = spread * self.strength * self.rng.random(shape)
        return draws if shape else float(draws)
