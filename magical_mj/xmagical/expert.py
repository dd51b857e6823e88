"""SweepToTop's expert. It tries sweeps in a copy of the simulation, and plays the first one that sweeps in all debris.

A sweep is a sequence of lanes. In each lane the robot drives below some of the debris, faces the top, and pushes the
debris there. The debris of each lane, the order of the lanes, and the paths between them are random in every attempt.
Actions are x-magical's continuous speeds, so that the robot can steer precisely.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.engine import Engine
from magical_mj.scene import constants as c
from magical_mj.scene.bodies import body_named
from magical_mj.xmagical.sweep_to_top import HALF_WIDTH, arrived

SWEEPS: Final = 100
"""The number of sweeps that are tried before the best one is played."""
HALF_DEBRIS: Final = 0.11  # half the side of a debris block, world units
CLEARANCE: Final = 0.04
EDGE: Final = 0.04  # least distance of debris' centre from the end of the pushing side
GRIPPER_HALF: Final = 0.13  # half width of the closed fingers' pushing side
NEAR, ALIGNED = 0.05, 0.06  # world units, rad
PATIENCE: Final = 8  # after more steps without progress, a lane is abandoned
FAST: Final = 0.8
ACCELERATION: Final = 3.2  # rad/s^2, the braking rate towards a heading: the long stick can brake with 4.7

Action = NDArray[np.float32]


Lane = tuple[tuple[int, ...], float]
"""Debris blocks that are pushed together, and the x of the robot's centre meanwhile."""


class Sweeper:
    """The expert for an engine of SweepToTop, which may be reset. `seed` determines its random choices.

    Each call returns the action for the engine's current state.
    """

    def __init__(self, env: Engine, seed: int = 0) -> None:
        self._env, self._seed = env, seed
        self._actions: list[Action] = []
        self._first = 0

    def __call__(self) -> Action:
        """The action for the current state."""
        engine = self._env
        if engine.steps == 0 or not self._actions:
            self._actions = plan(engine, np.random.default_rng(self._seed))
            self._first = engine.steps
        step = engine.steps - self._first
        size = 3 if engine.scene_model.has_fingers else 2
        return self._actions[step] if step < len(self._actions) else np.zeros(size, np.float32)


def plan(engine: Engine, rng: np.random.Generator) -> list[Action]:
    """The actions of the first sweep that brings all debris into the goal zone, or of the best of all attempts."""
    best: list[Action] = []
    most = -1.0
    for number in range(SWEEPS):
        attempt = _Attempt(engine, rng, steady=number == 0)
        if (score := attempt.sweep()) > most:
            best, most = attempt.actions, score
        if score == 1.0:
            break
    return best


class _Attempt:
    """An attempt in a copy of the simulation."""

    def __init__(self, engine: Engine, rng: np.random.Generator, *, steady: bool) -> None:
        self._simulation = engine.physics_copy()
        self._left = (engine.horizon or 100) - engine.steps
        self._rng, self._steady = rng, steady
        body = body_named(engine.setup.body)
        self._fingers, self._front = body.fingers, 0.38 if body.fingers else 0.05  # the front's distance ahead
        self._half = GRIPPER_HALF if body.fingers or not body.outline else float(body.corners[:, 0].max())
        self.actions: list[Action] = []
        often = not steady and rng.random() < (0.8 if self._half > 0.5 else 0.4)
        self._wiggle, self._period = float(rng.uniform(0.15, 0.9)) if often else 0.0, int(rng.integers(3, 10))

    def sweep(self) -> float:
        """Drives one lane after another, while steps and debris are left. Returns the share in the goal zone."""
        while self._left > 0:
            lanes = self._lanes()
            if not lanes:
                break
            self._drive_lane(*lanes[0])
        return float(arrived(self._simulation.scene).mean())

    def _lanes(self) -> list[Lane]:
        """The lanes for debris outside the goal zone, in driving order."""
        scene = self._simulation.scene
        home = arrived(scene)
        todo = sorted((block.x, index) for index, block in enumerate(scene.blocks) if not home[index])
        lanes: list[Lane] = []
        while todo:
            group = [todo.pop(0)]
            room = 2 * (self._half - EDGE)
            share = self._steady or self._rng.random() < 0.7
            while todo and share and todo[0][0] - group[0][0] <= room:
                group.append(todo.pop(0))
            low, high = group[-1][0] - self._half + EDGE, group[0][0] + self._half - EDGE
            limit = HALF_WIDTH - self._half - 0.02
            wanted = scene.robot.x if self._half > 0.5 else (group[0][0] + group[-1][0]) / 2
            x = min(max(min(max(wanted, low), high), -limit), limit)
            lanes.append((tuple(index for _, index in group), x))
        robot = scene.robot
        noise = 0.0 if self._steady else 0.8
        lanes.sort(key=lambda lane: abs(lane[1] - robot.x) + noise * self._rng.random())
        return lanes

    def _drive_lane(self, debris: tuple[int, ...], lane: float) -> None:
        """Drives below a lane's debris, and then to the top. `lane` is its x."""
        scene = self._simulation.scene
        lowest = min(scene.blocks[index].y for index in debris)
        below = lowest - HALF_DEBRIS - CLEARANCE - self._front
        x, y, angle = scene.robot.pose
        in_front = y < below + 0.02 and abs(x - lane) < 0.25 + 0.4 * max(0.0, below - y)
        if not in_front or abs(math.remainder(angle, 2 * math.pi)) > 0.6:
            side = self._half if self._half < 0.5 else 0.0
            lower = min((block.y for block in scene.blocks if block.y < 0.7), default=lowest)
            aside = (lower if self._half < 0.5 else lowest) - HALF_DEBRIS - CLEARANCE - side
            depth = max(-HALF_WIDTH + max(0.2, self._front), min(below, aside))
            if y > depth + 0.05 and abs(x - lane) > 0.1 and (self._steady or self._rng.random() < 0.5):
                self._go(x, depth, reverse=True)  # back out of the debris before going aside
            self._go(lane, depth, reverse=self._simulation.scene.robot.y > depth + 0.1)
        self._face(0.0)
        self._push(debris, lane)

    def _push(self, debris: tuple[int, ...], lane: float) -> None:
        """Drives to the top along a lane."""
        best, waited = -math.inf, 0
        for step in range(self._left):
            scene = self._simulation.scene
            home = arrived(scene)
            if all(home[index] for index in debris):
                return
            progress = sum(min(scene.blocks[index].y, 0.95) for index in debris) + 0.3 * scene.robot.y
            waited = 0 if progress > best + 0.01 else waited + 1
            best = max(best, progress)
            if waited > (PATIENCE if not self._wiggle else 3 * PATIENCE):
                self._act(-FAST, 0.0)
                return
            robot = scene.robot
            aside = 1.6 * (robot.x - lane)
            heading = min(max(aside, -0.35), 0.35)
            if self._wiggle and waited > 2:
                heading = self._wiggle * (1 if (step // self._period) % 2 else -1)
            self._act(FAST, self._turn(heading))

    def _face(self, heading: float) -> None:
        for _ in range(self._left):
            if abs(math.remainder(heading - self._simulation.scene.robot.angle, 2 * math.pi)) < ALIGNED:
                return
            self._act(0.0, self._turn(heading))

    def _go(self, x: float, y: float, *, reverse: bool) -> None:
        """Drives to a point, forwards or backwards."""
        for _ in range(min(self._left, 40)):
            robot = self._simulation.scene.robot
            dx, dy = x - robot.x, y - robot.y
            distance = math.hypot(dx, dy)
            if distance < NEAR:
                return
            heading = math.atan2(-dx, dy) + (math.pi if reverse else 0.0)
            error = math.remainder(heading - robot.angle, 2 * math.pi)
            along = math.cos(error) * distance
            if abs(error) > 1.3 and distance < 0.15:
                return
            speed = min(FAST, 6 * abs(along)) if abs(error) < 0.5 else 0.0
            self._act(-speed if reverse else speed, self._turn(heading))

    def _turn(self, heading: float) -> float:
        """The turn speed of an action that approaches a heading (rad) without overshooting."""
        simulation = self._simulation
        error = math.remainder(heading - simulation.scene.robot.angle, 2 * math.pi)
        rate = min(7 * abs(error), math.sqrt(2 * ACCELERATION * abs(error)), c.SPEED_TURN)
        if self._half < 0.5:
            rate = min(8 * abs(error), c.SPEED_TURN)
        return math.copysign(rate, error) / 40

    def _act(self, speed: float, turn: float) -> None:
        if self._left <= 0:
            return
        action = np.array([speed, turn, 1.0][: 3 if self._fingers else 2], np.float32)
        self._simulation.act(action)
        self.actions.append(action)
        self._left -= 1
