"""Protocol numbers: what must be the same for two results to be comparable.

Under one `PROTOCOL` number, these stay the same: the environments, the scenes of every seed, the horizons, the scores
under both sets of rules, the 18 actions, the physics settings of the model, and the observations. A change to any of
them requires the next number. Evaluations record both numbers together with the versions of this package and of MuJoCo.
"""

from __future__ import annotations

from typing import Final

__all__ = ["DEMONSTRATIONS", "MUJOCO", "PROTOCOL"]

PROTOCOL: Final = 1
"""The protocol of the current environments; a test fails if they change without a new number."""

MUJOCO: Final = ("3", "4")
"""The series of MuJoCo that compute the same: ten actions differ by rounding, and 200 demonstrations score alike."""

DEMONSTRATIONS: Final = 2
"""The number of the shipped set of demonstrations, which policies learn from."""
