"""Brings objects to their places with the skill, one after the other."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_intents.guide import LOST, Guide
from magical_intents.scenes import ROBOT, positions_of
from magical_intents.skill import Skill
from magical_mj.actions import NOOP, Action, Drive
from magical_mj.policies.models import torch_settings
from magical_mj.tasks.planning import APART

SHARPNESS: Final = 1.5
"""Actions are drawn from the skill's probabilities with this exponent."""
STUCK: Final = 6
"""The robot is stuck if its pose changed by less than `MOTION` in this number of steps."""
MOTION: Final = 0.1
"""In units or rad."""
BACKING: Final = (Action(drive=Drive.BACK).number, 4)
"""A robot that is stuck opens its fingers and drives back: the action, and for how many steps."""
ARRIVED: Final = 0.05
"""An object arrives at this distance from its place (units)."""
LEFT: Final = 0.09
"""An object is brought if it is farther from its place (units)."""
PATIENCE: Final = 60
"""After this number of steps, another object is brought."""
NOTHING: Final = -1
"""The object when none is left."""


class Carrier:
    """Acts until all objects are at their places.

    Args:
        skill: the network.
        rng: draws actions from its probabilities.
        places: the places of blocks and, last, the robot, shape (ROBOT + 1, 2). Missing and free ones are NaN.

    Attributes:
        brought: the number of the object that is being brought, or `NOTHING`.
    """

    def __init__(self, skill: Skill, rng: np.random.Generator, places: Tensor) -> None:
        self._skill, self._rng, self._places = skill, rng, places
        self.brought, self._steps = NOTHING, 0
        self._tried = np.zeros(ROBOT + 1)
        self._poses: deque[Tensor] = deque(maxlen=STUCK)
        self._backs = 0

    def __call__(self, state: Tensor) -> int:
        """The action for a state (names,)."""
        positions = positions_of(state)
        gaps = (positions - self._places).norm(dim=1).nan_to_num(0.0)
        if not self._continues(positions, gaps):
            self.brought, self._steps = self._next(positions, gaps), 0
            if self.brought == NOTHING:
                return NOOP
            self._tried[self.brought] += 1
            self._poses.clear()
            x, y = self._places[self.brought].tolist()
            self._guide = Guide(self.brought, (x, y))
        via = torch.tensor([self._guide(state.numpy())])
        self._steps += 1
        if len(self._poses) == STUCK and bool(((self._poses[0] - state[:3]).abs() < MOTION).all()):
            self._backs = BACKING[1]
        self._poses.append(state[:3])
        if self._backs:
            self._backs -= 1
            self._poses.clear()
            return BACKING[0]
        with torch_settings(1), torch.inference_mode():
            logits = self._skill(state[None], torch.tensor([self.brought]), self._places[[self.brought]], via)[0]
        return drawn_action(logits * SHARPNESS, self._rng)

    def _continues(self, positions: Tensor, gaps: Tensor) -> bool:
        """Whether the object is not at its place, or still held there."""
        number = self.brought
        if number == NOTHING or self._steps >= PATIENCE:
            return False
        held = number < ROBOT and bool((positions[number] - positions[ROBOT]).norm() < LOST)
        return bool(gaps[number] > ARRIVED) or held

    def _next(self, positions: Tensor, gaps: Tensor) -> int:
        """The nearest block that was tried least and whose place is free; or one whose place is not; or the robot."""
        away = [k for k in range(ROBOT) if gaps[k] > LEFT]
        if not away:
            return ROBOT if gaps[ROBOT] > LEFT else NOTHING

        def order(number: int) -> tuple[bool, float, float]:
            others = (positions[:ROBOT] - self._places[number]).norm(dim=1)
            others[number] = math.inf
            near = (positions[number] - positions[ROBOT]).norm()
            return bool(others.nan_to_num(math.inf).min() < 0.8 * APART), self._tried[number], float(near)

        return min(away, key=order)


def drawn_action(logits: Tensor, rng: np.random.Generator) -> int:
    """An action, drawn from logits (18,)."""
    shares: NDArray[np.float64] = logits.double().softmax(dim=0).cumsum(dim=0).numpy()
    return int(min((shares < rng.random()).sum(), len(shares) - 1))
