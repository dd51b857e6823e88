"""The hand that carries out what is planned. It makes small mistakes, which steering mends."""

from __future__ import annotations

from typing import Final

import numpy as np

from magical_mj.actions import Action

LATE: Final = 0.25  # the chance that a hand is late by one action
HESITATION: Final = 4  # actions, fewer than which a pause takes


class Hand:
    """The hand of a person at the keys: it hesitates, and it is late to change what it does.

    Args:
        rng: where the draws come from.
        lateness: the chance that it goes on with what it did for one action more when something else is due.
    """

    def __init__(self, rng: np.random.Generator, lateness: float = LATE) -> None:
        self._rng, self._lateness = rng, lateness

    def __call__(self, last: Action | None, wanted: Action) -> Action:
        """What is done instead of what is wanted, after the last action."""
        if last is None or self._rng.random() >= self._lateness:
            return wanted
        return last

    def pause(self) -> int:
        """For how many actions it waits before it begins something."""
        return int(self._rng.integers(HESITATION))
