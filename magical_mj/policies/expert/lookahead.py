"""Lookahead on a copy of the simulation, where actions have the same results, and how a person executes them."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.engine import Engine
from magical_mj.scene import Pose, Scene
from magical_mj.scene.actions import ACTIONS, Action, Drive, Gripper, Turn

SavedState = NDArray[np.float64]
"""A saved state: the array that `magical_mj.engine.simulation.Simulation.save` returns."""
Point = tuple[float, float]

DELAY_PROBABILITY: Final = 0.25  # of a delay by one action
HESITATION: Final = 4  # actions: pauses are shorter than this


class HumanExecution:
    """A model of a person at the keyboard, who pauses, and changes the pressed keys late.

    Args:
        rng: the random generator.
        delay_probability: that the last action is repeated once when another one is due.
        hesitation: pauses are shorter than this number of actions.
    """

    def __init__(
        self, rng: np.random.Generator, delay_probability: float = DELAY_PROBABILITY, hesitation: int = HESITATION
    ) -> None:
        self._rng, self._delay_probability, self._hesitation = rng, delay_probability, hesitation

    def __call__(self, last: Action | None, wanted: Action) -> Action:
        """The executed action, given the last one and the wanted one."""
        if last is None or self._rng.random() >= self._delay_probability:
            return wanted
        return last

    def pause(self) -> int:
        """The number of actions to wait before starting something new."""
        return int(self._rng.integers(self._hesitation))


class Lookahead:
    """A copy of an engine's simulation, to try actions in.

    Args:
        engine: the engine whose present state is copied; it is not changed.
    """

    def __init__(self, engine: Engine) -> None:
        self._simulation = engine.simulation.copy()
        self._simulation.restore(engine.simulation.save())
        self._world = engine.simulation.world
        self.trace: list[int] = []
        """The actions since the last `restore`."""
        self.states: list[SavedState] = []
        """The state after each of them."""
        self.execution: HumanExecution | None = None
        """Modifies the actions; None: they are executed as wanted."""
        self.count = 0
        """The total number of simulated steps."""

    def restore(self, state: SavedState) -> None:
        """Goes to a state, with an empty history."""
        self._simulation.restore(state)
        self.trace, self.states = [], []

    def act(self, gripper: Gripper, turn: Turn = Turn.NONE, drive: Drive = Drive.NONE) -> None:
        """One control step."""
        action = Action(gripper, turn, drive)
        if self.execution is not None:
            action = self.execution(ACTIONS[self.trace[-1]] if self.trace else None, action)
        self._simulation.act(action.number)
        self.trace.append(action.number)
        self.states.append(self.state)
        self.count += 1

    @property
    def state(self) -> SavedState:
        """The present state."""
        return self._simulation.save()

    @property
    def robot(self) -> Pose:
        """Where the robot is."""
        x, y, angle = self._world.poses(self._simulation.data.qpos)[0].tolist()
        return x, y, angle

    @property
    def speed(self) -> tuple[float, float]:
        """The robot's speed forwards (units/s) and its turning speed to the left (rad/s)."""
        vx, vy, spin = self._world.poses(self._simulation.data.qvel)[0].tolist()
        angle = self.robot[2]
        return -vx * math.sin(angle) + vy * math.cos(angle), spin

    def block(self, index: int) -> Point:
        """Where a block is."""
        x, y, _ = self._world.poses(self._simulation.data.qpos)[1 + index].tolist()
        return x, y

    def relative(self, point: Point) -> Point:
        """A point in the robot's frame: its distance to the right and ahead (world units)."""
        x, y, angle = self.robot
        dx, dy = point[0] - x, point[1] - y
        cosine, sine = math.cos(angle), math.sin(angle)
        return cosine * dx + sine * dy, cosine * dy - sine * dx

    def relative_block(self, index: int) -> Point:
        """A block's centre in the robot's frame: its distance to the right and ahead (world units)."""
        return self.relative(self.block(index))

    def scene(self) -> Scene:
        """The present scene."""
        return self._world.read(self._simulation.data.qpos)


def state_of(engine: Engine) -> SavedState:
    """The present state of an engine."""
    return engine.simulation.save()
