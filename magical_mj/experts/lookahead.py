"""Lookahead on a copy of the simulation: actions lead there exactly where they would lead in the environment."""

from __future__ import annotations

import copy
import math
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.actions import Action, Drive, Gripper, Turn
from magical_mj.assets.contacts import SUBSTEPS
from magical_mj.assets.robot import control_signal
from magical_mj.environment import Environment
from magical_mj.scene import Pose, Scene

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION

State = NDArray[np.float64]
"""Where everything is and how it moves."""
Point = tuple[float, float]


class Snapshot(NamedTuple):
    """What happened since some moment, and where it led."""

    data: mujoco.MjData
    """The end. A `State` would not do: which blocks sleep is not part of it."""
    trace: tuple[int, ...]
    """The actions."""
    states: tuple[State, ...]
    """The state after each."""


class Lookahead:
    """A copy of an environment's simulation, to try actions in.

    Args:
        env: whose present state it starts from; the environment itself stays as it is.
    """

    def __init__(self, env: Environment) -> None:
        self._model = env.physics.model.ptr
        self._data = copy.copy(env.physics.data.ptr)
        self._world = env.task.world
        self.trace: list[int] = []
        """The actions since the last `restore`."""
        self.states: list[State] = []
        """The state after each of them."""
        self.count = 0
        """How many steps were simulated in all."""

    def save(self) -> Snapshot:
        """What happened since the last `restore`, and the present."""
        return Snapshot(copy.copy(self._data), tuple(self.trace), tuple(self.states))

    def restore(self, memory: Snapshot) -> None:
        """Be where something ended, with an empty trace."""
        mujoco.mj_copyData(self._data, self._model, memory.data)
        self.trace, self.states = [], []

    def remember(self, memory: Snapshot) -> None:
        """Be where something ended, with what led there."""
        self.restore(memory)
        self.trace, self.states = list(memory.trace), list(memory.states)

    def act(self, gripper: Gripper, turn: Turn = Turn.NONE, drive: Drive = Drive.NONE) -> None:
        """One control step."""
        action = Action(gripper, turn, drive).number
        self._data.ctrl[:] = control_signal(action)
        mujoco.mj_step(self._model, self._data, SUBSTEPS)
        self.trace.append(action)
        self.states.append(self.state)
        self.count += 1

    @property
    def state(self) -> State:
        """The present state."""
        return _state(self._model, self._data)

    @property
    def robot(self) -> Pose:
        """Where the robot is."""
        x, y, angle = self._world.poses(self._data.qpos)[0].tolist()
        return x, y, angle

    @property
    def speed(self) -> tuple[float, float]:
        """How fast the robot drives (forwards, units/s) and turns (to the left, rad/s)."""
        vx, vy, spin = self._world.poses(self._data.qvel)[0].tolist()
        angle = self.robot[2]
        return -vx * math.sin(angle) + vy * math.cos(angle), spin

    def block(self, index: int) -> Point:
        """Where a block is."""
        x, y, _ = self._world.poses(self._data.qpos)[1 + index].tolist()
        return x, y

    def seen(self, index: int) -> Point:
        """Where a block is in the robot's frame: to its right, ahead of it."""
        x, y, angle = self.robot
        bx, by = self.block(index)
        cosine, sine = math.cos(angle), math.sin(angle)
        return cosine * (bx - x) + sine * (by - y), cosine * (by - y) - sine * (bx - x)

    def scene(self) -> Scene:
        """The present scene."""
        return self._world.read(self._data.qpos)


def state_of(env: Environment) -> State:
    """The present state of an environment."""
    return _state(env.physics.model.ptr, env.physics.data.ptr)


def _state(model: mujoco.MjModel, data: mujoco.MjData) -> State:
    state = np.empty(mujoco.mj_stateSize(model, _STATE))
    mujoco.mj_getState(model, data, state, _STATE)
    return state
