"""The observables of composer environments: the observations of `load`, and the observables of the entities.

The observations of `load` belong to the task and are enabled. The observables of arena, robot and blocks are disabled
by default. All read current positions and velocities, and change nothing. Units are world units, radians and seconds;
angles are counter-clockwise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from dm_control import composer
from dm_control.composer.observation import observable
from dm_env import specs

from magical_mj.envs.composer.planar import PlanarEntity, Rows
from magical_mj.envs.presets import PRESETS, Draw, Images, frame_stacks
from magical_mj.observations import MAX_BLOCKS, MAX_REGIONS, STATE_NAMES, StateEncoder
from magical_mj.utils.errors import InvalidSceneError

STACKS: Final = {"ego_stack": "LoRes4E", "allo_stack": "LoRes4A"}
"""Observation with stacked frames -> the preset of the Gymnasium environments with equal observations."""


class CurrentObservable(observable.Generic):
    """An observable with a given spec: reading its spec needs no picture. It is enabled by default."""

    def __init__(self, function: Callable[[Any], Any], spec: specs.Array) -> None:
        super().__init__(function)
        self._own_spec = spec
        self.enabled = True

    @property
    def array_spec(self) -> specs.Array:
        """The spec."""
        return self._own_spec


class LatestFrames(CurrentObservable):
    """The frames of a view after the last four actions, oldest first. Shape (size, size, 12).

    The first frame of an episode fills the stack. After each action, a frame is drawn when it is first needed, at the
    latest before the next action. So the stack is complete no matter when and how often composer evaluates it.
    """

    def __init__(self, drawer: Callable[[Any], Draw], name: str, size: int) -> None:
        self._drawer = drawer
        ((self._name, self._stack),) = frame_stacks(PRESETS[STACKS[name]], size).items()
        self._frames: Mapping[str, Images] = {}
        self._observed = False  # whether the stack has been observed in this episode
        self._due = False  # whether the frame after the last action is still missing
        spec = specs.BoundedArray(self._stack.shape, np.uint8, 0, 255, name)
        super().__init__(self._observe, spec)

    def begin(self, frames: Mapping[str, Images]) -> None:
        """Starts an episode, with the frames of a state if they fit."""
        self._frames, self._observed = frames, False

    def catch_up(self, physics: Any) -> None:
        """Draws the frame after the last action if it is missing, because composer has not evaluated the stack."""
        if self._observed:
            self._take(physics)

    def after_action(self) -> None:
        """Requests the next frame. It is drawn later, since hooks may still change the state."""
        self._due = True

    def save(self, physics: Any) -> dict[str, Images]:
        """A copy of the stack, by its name in states; empty if it has not been observed in this episode."""
        self.catch_up(physics)
        return {self._name: self._stack.latest.copy()} if self._observed else {}

    def _observe(self, physics: Any) -> Images:
        self._take(physics)
        return self._stack.latest.copy()

    def _take(self, physics: Any) -> None:
        if not self._observed:
            self._stack.start(self._drawer(physics), self._frames.get(self._name))
        elif self._due:
            self._stack.push(self._drawer(physics))
        self._observed, self._due = True, False


class Bound(observable.Observable):
    """An observable that looks up elements once per episode: looking them up takes longer than reading them.

    Args:
        bind: a function that takes the physics and returns the function that reads values.
        change: a function that converts the values to the observation.
    """

    def __init__(
        self, bind: Callable[[Any], Callable[[], Rows]], change: Callable[[Rows], Rows] = lambda values: values
    ) -> None:
        super().__init__(1, None, None, None, None)
        self._bind, self._change = bind, change

    def _callable(self, physics: Any) -> Callable[[], Rows]:
        read = self._bind(physics)
        return lambda: self._change(read())


class PlanarObservables(composer.Observables):
    """Observables of a body that moves in the plane."""

    @composer.observable
    def pose(self) -> Bound:
        """x, y and angle in world coordinates. The angle is not wrapped. Shape (3,)."""
        return Bound(lambda physics: _values(physics, "qpos", self._entity.joints))

    @composer.observable
    def velocity(self) -> Bound:
        """Velocities of x, y and the angle, in world coordinates. Shape (3,)."""
        return Bound(lambda physics: _values(physics, "qvel", self._entity.joints))


class BlockObservables(PlanarObservables):
    """Observables of a block. They exist only in episodes with this block."""

    @composer.observable
    def egocentric_pose(self) -> Bound:
        """The pose in the robot's frame: x to its right, y ahead, and the angle in [-pi, pi]. Shape (3,)."""
        entity = self._entity
        return Bound(lambda physics: _in_frame(physics, entity.parent.robot, [entity]), lambda rows: rows[0])

    @composer.observable
    def contact(self) -> Bound:
        """1 if the robot touches the block, else 0. Shape ()."""
        entity = self._entity
        return Bound(lambda physics: _touching(physics, entity.parent.robot, [entity]), lambda values: values[0])


class RobotObservables(PlanarObservables):
    """Observables of the robot. Those about blocks have a fixed shape, with zeros for absent blocks."""

    @composer.observable
    def egocentric_blocks(self) -> Bound:
        """All blocks in the robot's frame. Shape (10, 4). A row is 1 if the block exists, and its `egocentric_pose`."""
        return Bound(
            lambda physics: _in_frame(physics, self._entity, _check_count(self._entity.parent.blocks)),
            lambda rows: _padded(np.insert(rows, 0, 1, axis=1)),
        )

    @composer.observable
    def contacts(self) -> Bound:
        """1 for each block that the robot touches, else 0. Shape (10,)."""
        entity = self._entity
        return Bound(lambda physics: _touching(physics, entity, _check_count(entity.parent.blocks)), _padded)

    @composer.observable
    def egocentric_camera(self) -> observable.MJCFCamera:
        """The picture of `physics.render` with the robot's camera: the lit model, not the benchmark's flat view."""
        return observable.MJCFCamera(self._entity.mjcf_model.find("camera", "ego"), height=96, width=96)


class GripperObservables(RobotObservables):
    """Observables of a robot with fingers."""

    @composer.observable
    def fingers(self) -> Bound:
        """Angles of the left and the right finger. Shape (2,)."""
        return Bound(lambda physics: _values(physics, "qpos", self._entity.fingers))

    @composer.observable
    def finger_velocities(self) -> Bound:
        """Angular velocities of the left and the right finger. Shape (2,)."""
        return Bound(lambda physics: _values(physics, "qvel", self._entity.fingers))


class ArenaObservables(composer.Observables):
    """Observables of the arena, which includes the goal regions."""

    @composer.observable
    def regions(self) -> observable.Generic:
        """The goal regions, as in the state vector. Shape (3, 9), float32.

        A row is 1 if the region exists, then x_min, y_min, x_max, y_max, then its colour as one-hot: red, green, blue
        or yellow. Rows of absent regions are 0.
        """
        first = STATE_NAMES.index("region0.present")
        return observable.Generic(lambda _: StateEncoder(self._entity.scene).fixed[first:].reshape(MAX_REGIONS, -1))

    @composer.observable
    def top_camera(self) -> observable.MJCFCamera:
        """The picture of `physics.render` with the camera "allo": the lit model, not the benchmark's flat view."""
        return observable.MJCFCamera(self._entity.mjcf_model.find("camera", "allo"), height=96, width=96)


def _values(physics: Any, kind: str, joints: Sequence[Any]) -> Callable[[], Rows]:
    """A function that reads coordinates ("qpos") or velocities ("qvel") of joints. Shape (joints,)."""
    bound = physics.bind(joints)
    return lambda: np.array(getattr(bound, kind))


def _in_frame(physics: Any, robot: PlanarEntity, blocks: Sequence[PlanarEntity]) -> Callable[[], Rows]:
    """A function that reads the poses of blocks in the robot's frame. Shape (blocks, 3)."""
    values = _values(physics, "qpos", [joint for it in (robot, *blocks) for joint in it.joints])

    def read() -> Rows:
        robot, *poses = values().reshape(-1, 3)
        x, y, angle = (np.reshape(poses, (-1, 3)) - robot).T
        cosine, sine = math.cos(robot[2]), math.sin(robot[2])
        turned = np.arctan2(np.sin(angle), np.cos(angle))
        return np.stack((cosine * x + sine * y, cosine * y - sine * x, turned), axis=1)

    return read


def _touching(physics: Any, robot: PlanarEntity, blocks: Sequence[PlanarEntity]) -> Callable[[], Rows]:
    """A function that reads for each block whether it touches the robot: 1, else 0. Shape (blocks,).

    Contacts belong to the current state. Contact forces would belong to the previous step, so they are not used.
    """
    model, data = physics.model.ptr, physics.data.ptr
    ours, *theirs = physics.bind([it.frame for it in (robot, *blocks)]).element_id
    root_of_geom = model.body_rootid[model.geom_bodyid]

    def read() -> Rows:
        contact = data.contact
        roots = root_of_geom[contact.geom[(contact.exclude == 0) & (contact.geom >= 0).all(axis=1)]]
        touched = roots[:, ::-1][roots == ours]  # the other body of each contact of the robot
        return np.isin(theirs, touched).astype(np.float64)

    return read


def _padded(rows: Rows) -> Rows:
    """Rows of blocks, padded with zeros for absent blocks. Shape (10, ...)."""
    return np.concatenate((rows, np.zeros((MAX_BLOCKS - len(rows), *rows.shape[1:]))))


def _check_count(blocks: Sequence[PlanarEntity]) -> Sequence[PlanarEntity]:
    """The blocks. Raises an `InvalidSceneError` if there are more of them than rows."""
    if len(blocks) > MAX_BLOCKS:
        raise InvalidSceneError(
            f"observables of all blocks have {MAX_BLOCKS} rows, and this scene has {len(blocks)} blocks: enable the "
            "observables of single blocks instead"
        )
    return blocks
