"""Lookahead on a copy of the simulation, in which actions have exactly the same results as in the environment."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from magical_mj.engine import Engine
from magical_mj.policies.expert.hand import Hand
from magical_mj.scene import Pose, Scene
from magical_mj.scene.actions import ACTIONS, Action, Drive, Gripper, Turn

SavedState = NDArray[np.float64]
"""A saved state: the array that `magical_mj.engine.simulation.Simulation.save` returns."""
Point = tuple[float, float]


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
        self.hand: Hand | None = None
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
        if self.hand is not None:
            action = self.hand(ACTIONS[self.trace[-1]] if self.trace else None, action)
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

    def seen(self, index: int) -> Point:
        """A block's centre in the robot's frame: its distance to the right and ahead (world units)."""
        return self.relative(self.block(index))

    def scene(self) -> Scene:
        """The present scene."""
        return self._world.read(self._simulation.data.qpos)


def state_of(engine: Engine) -> SavedState:
    """The present state of an engine."""
    return engine.simulation.save()
