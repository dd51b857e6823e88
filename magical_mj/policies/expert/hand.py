"""Imperfect execution of planned actions, like a person's: delays and pauses, which steering corrects."""

from __future__ import annotations

from typing import Final

import numpy as np

from magical_mj.scene.actions import Action

LATE: Final = 0.25  # the probability of a delay by one action
HESITATION: Final = 4  # actions: pauses are shorter than this


class Hand:
    """A model of a person at the keyboard, who pauses, and changes the pressed keys late.

    Args:
        rng: the random generator.
        lateness: the probability that the last action is repeated once when another one is due.
        hesitation: pauses are shorter than this number of actions.
    """

    def __init__(self, rng: np.random.Generator, lateness: float = LATE, hesitation: int = HESITATION) -> None:
        self._rng, self._lateness, self._hesitation = rng, lateness, hesitation

    def __call__(self, last: Action | None, wanted: Action) -> Action:
        """The executed action, given the last one and the wanted one."""
        if last is None or self._rng.random() >= self._lateness:
            return wanted
        return last

    def pause(self) -> int:
        """The number of actions to wait before starting something new."""
        return int(self._rng.integers(self._hesitation))
