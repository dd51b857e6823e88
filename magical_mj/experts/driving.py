"""Driving like a person with a keyboard, in an exact copy of the simulation.

Actions have the same results in the copy, even with shifts that replace or delay actions: their effects are known,
like the rest of the true state.

The robot turns towards a point, drives there, and corrects its heading on the way. The actions depend mostly on the
point's position in the robot's frame, so that a learner can infer the rule.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical_mj.actions import ACTIONS, NOOP, Action, Drive, Gripper, Turn
from magical_mj.engine import Engine
from magical_mj.scene import Pose, Scene
from magical_mj.scene.bodies import body_named
from magical_mj.shifts.episode import EpisodeShifts

Point = tuple[float, float]

DELAY_PROBABILITY: Final = 0.25  # probability of a delay by one action
HESITATION: Final = 4  # actions: pauses are shorter than this
AIM: Final = 0.19  # rad; one action turns by 0.31, so that smaller errors cannot be corrected
FACE: Final = 0.6  # rad; with a larger error the robot turns without driving
BEHIND: Final = 1.1  # rad; with a larger error a robot that carries a block drives back while it turns
BRAKING: Final = 2.4  # units/s^2
VIA: Final = 0.12  # world units: intermediate points this close count as reached
EITHER: Final = 0.6  # rad: to points this close to straight behind, the robot always turns right
NEAR: Final = 0.3  # world units: to points this close behind it, the robot drives back instead of turning around
STUCK, FREED = 3, 7  # from 3 actions without progress the robot drives back, from 7 it tries again
PATIENCE: Final = 12  # with more actions without progress it gives up
PROGRESS: Final = 0.01  # world units or radians


class HumanExecution:
    """A model of a person at the keyboard, who pauses for less than `hesitation` actions, and changes keys late.

    With the probability `delay_probability`, the last action is repeated once before another one.
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
        """The number of actions to wait before a new manoeuvre."""
        return int(self._rng.integers(self._hesitation))


class SavedState(NamedTuple):
    """A state of the lookahead.

    Attributes:
        simulation: a value of `magical_mj.engine.simulation.Simulation.save`.
        shifts: the shifts of the episode, at the same step.
        commands: the command of each step since the lookahead was created. None: it is still open.
        scenes: the initial scene. If the score depends on the scenes of all steps, they follow.
    """

    simulation: NDArray[np.float64]
    shifts: EpisodeShifts
    commands: tuple[int | None, ...]
    scenes: tuple[Scene, ...]


class Lookahead:
    """A copy of an engine's simulation in its current state, for trying actions. The engine is not changed.

    With delayed actions, each action is commanded the corresponding number of steps earlier. If another action was
    already commanded then, that one is executed. The lookahead starts at the first step whose command is still open.
    """

    def __init__(self, engine: Engine) -> None:
        self._simulation, self._scene_model = engine.physics_copy(), engine.scene_model
        self._keeps_trajectory = engine.setup.spec.trajectory
        scenes = engine.scored_scenes if self._keeps_trajectory else (engine.initial_scene,)
        self._here = SavedState(self._simulation.save(), engine.episode_shifts.copy(), (), tuple(scenes))
        self._root = self._simulated = self._here
        self._known: dict[tuple[int, int], tuple[SavedState, SavedState]] = {}
        self.body = body_named(self._scene_model.scene.robot.body)
        """The robot's body. Without fingers, it cannot grip blocks and pushes them."""
        self.trace: list[int] = []
        """The actions since the last `restore`."""
        self.states: list[SavedState] = []
        """The state after each of these actions."""
        self.execution: HumanExecution | None = None
        """Modifies the actions; None: they are executed as wanted."""
        self.count = 0
        """The total number of actions."""
        self.pending = [self.state]
        """The states from the engine's state to the lookahead's first one. Their commands are already given."""
        while self._here.shifts.delay > len(self._here.commands):
            self._take(NOOP)
            self.pending.append(self.state)

    def restore(self, state: SavedState) -> None:
        """Restores a state, with an empty history.

        The results of actions are kept until another state is restored, since manoeuvres from one state begin alike.
        """
        if state is not self._root:
            self._root, self._known = state, {}
        self._here = state
        self.trace, self.states = [], []

    def act(self, gripper: Gripper, turn: Turn = Turn.NONE, drive: Drive = Drive.NONE) -> None:
        """One control step."""
        action = Action(gripper, turn, drive)
        if self.execution is not None:
            action = self.execution(ACTIONS[self.trace[-1]] if self.trace else None, action)
        self._take(action.number)
        self.trace.append(action.number)
        self.states.append(self.state)
        self.count += 1

    def _take(self, wanted: int) -> None:
        """Executes an action, or the action that was already commanded for this step."""
        key = id(self._here), wanted
        if key not in self._known:
            self._known[key] = self._here, self._after(wanted)  # with the first state, so that its id stays its own
        self._here = self._known[key][1]

    def _after(self, wanted: int) -> SavedState:
        """The state after an action, by simulation."""
        if self._simulated is not self._here:
            self._simulation.restore(self._here.simulation)
        shifts, commands, scenes = self._here.shifts.copy(), [*self._here.commands, None], self._here.scenes
        delay = shifts.delay
        at = len(commands) - 1 - delay
        if at >= 0 and commands[at] is None:
            commands[at] = wanted
            if delay:
                shifts.revise(delay, wanted)
        self._simulation.act(shifts.action(NOOP if delay else wanted))
        if self._keeps_trajectory:
            scenes = (*scenes, self._scene_model.read(self._simulation.data.qpos))
        self._simulated = SavedState(self._simulation.save(), shifts, tuple(commands), scenes)
        return self._simulated

    @property
    def state(self) -> SavedState:
        """The current state."""
        return self._here

    @property
    def commands(self) -> list[int]:
        """The commands that lead from the engine's current state to the lookahead's current state."""
        return [NOOP if command is None else command for command in self._here.commands]

    @property
    def robot(self) -> Pose:
        """The robot's pose."""
        x, y, angle = self._scene_model.poses(self._positions)[0].tolist()
        return x, y, angle

    @property
    def speed(self) -> tuple[float, float]:
        """The robot's speed forwards (units/s) and its turning speed to the left (rad/s)."""
        velocities = self._simulation.coordinates(self._here.simulation)[1]
        vx, vy, spin = self._scene_model.velocities(velocities)[0].tolist()
        angle = self.robot[2]
        return -vx * math.sin(angle) + vy * math.cos(angle), spin

    @property
    def _positions(self) -> NDArray[np.float64]:
        return self._simulation.coordinates(self._here.simulation)[0]

    def block(self, index: int) -> Point:
        """A block's position."""
        x, y, _ = self._scene_model.poses(self._positions)[1 + index].tolist()
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
        """The current scene."""
        return self._scene_model.read(self._positions)

    def scenes_to(self, scene: Scene) -> tuple[Scene, ...]:
        """The scenes that determine the score of `scene`, which is the current one or follows it."""
        before = self._here.scenes
        return before if scene == before[-1] else (*before, scene)


def steer(
    lookahead: Lookahead, point: Point, ahead: float, gripper: Gripper, *, reverse: bool
) -> tuple[Gripper, Turn, Drive]:
    """The next action for bringing a point (world units) to the distance `ahead` of the robot's centre.

    With `reverse`, the robot turns while driving back if the point is far to the side.
    """
    right, forward = lookahead.relative(point)
    bearing = math.atan2(-right, forward)
    turn = Turn.LEFT if 0 < bearing < math.pi - EITHER else Turn.RIGHT
    if abs(bearing) <= AIM:
        turn = Turn.NONE
    if abs(bearing) > BEHIND and reverse:
        return gripper, turn, Drive.BACK
    if abs(bearing) > math.pi - FACE and math.hypot(right, forward) < NEAR:
        return gripper, Turn.NONE, Drive.BACK
    if abs(bearing) > FACE:
        return gripper, turn, Drive.NONE
    if forward > ahead:
        return gripper, turn, Drive.FORWARD
    return gripper, turn, Drive.NONE if turn else Drive.BACK


def drive(
    lookahead: Lookahead,
    route: Sequence[Point],
    gripper: Gripper,
    limit: int,
    *,
    ahead: float = 0.0,
    within: float,
    reverse: bool = False,
) -> bool:
    """Drives along a route (world units) until its last point is straight `ahead`. Returns whether it succeeded.

    At the end, the robot is at rest, and the point is `within` a tolerance (world units). It gives up after `limit`
    actions. `reverse` is described in `steer`.
    """
    for point in route:
        patience, tolerance = Patience(), within if point is route[-1] else VIA
        while True:
            right, forward = lookahead.relative(point)
            speed = lookahead.speed[0]
            gap = math.hypot(right, forward - ahead - speed * abs(speed) / (2 * BRAKING))
            if gap < tolerance:
                break
            bearing = math.atan2(-right, forward)
            if patience.ends(gap + 0.3 * abs(bearing)) or len(lookahead.trace) >= limit:
                return False
            if patience.stuck:
                lookahead.act(gripper, Turn.NONE, Drive.BACK)
            else:
                lookahead.act(*steer(lookahead, point, ahead, gripper, reverse=reverse))
    return True


class Patience:
    """Counts the actions without progress. After a few, the robot should free itself; after more, it should give up."""

    def __init__(self) -> None:
        self._least, self._waited = math.inf, 0

    def ends(self, left: float) -> bool:
        """Whether to give up; `left` is the remaining distance."""
        self._waited = 0 if left < self._least - PROGRESS else self._waited + 1
        self._least = min(self._least, left)
        return self._waited > PATIENCE

    @property
    def stuck(self) -> bool:
        """Whether to back up."""
        return STUCK <= self._waited < FREED
