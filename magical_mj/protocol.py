"""Protocol numbers. Two results are comparable only if their protocol numbers are equal.

Under one `PROTOCOL` number, these stay the same: the environments, the scenes of every seed, the horizons, the scores
under both sets of rules, the 18 actions, the physics settings of the model, and the observations. A change to any of
them requires the next number. Evaluations record both numbers together with the versions of this package and of MuJoCo.
"""

from __future__ import annotations

from typing import Final

__all__ = ["DEMONSTRATIONS", "INTENTS", "MUJOCO", "PROTOCOL", "SEEDS", "SHIFT_SEEDS", "SOLVED"]

PROTOCOL: Final = 1
"""The protocol of the current environments. A test fails if they change without a new number."""

SEEDS: Final = 100
"""The number of episodes in each environment."""

SHIFT_SEEDS: Final = 50
"""The number of episodes under each shift of the leaderboard's track."""

SOLVED: Final = frozenset({("MakeLine", "CountPlus", 13), ("MakeLine", "All", 13)})
"""The test scenes that start with score 1: task, variant, seed."""

MUJOCO: Final = ("3", "4")
"""The equivalent series of MuJoCo: ten actions differ by rounding, and 200 demonstrations have the same scores."""

DEMONSTRATIONS: Final = 2
"""The number of the shipped set of demonstrations for training policies."""

INTENTS: Final = 2
"""The number of the sets of intents, and of the scenes and horizons of intents."""
