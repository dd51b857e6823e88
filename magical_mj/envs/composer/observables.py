"""The observables of composer's environments: those that `load` is asked for, and those of the entities.

The former are the task's, and enabled. Those of the arena, the robot and the blocks are off until they are enabled. All
read the present positions and velocities, and change nothing. Units are world units, radians and seconds; angles are
counter-clockwise.
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
from magical_mj.envs.presets import PRESETS, Images, Stacks
from magical_mj.scene.state_vector import MAX_BLOCKS, MAX_REGIONS, STATE_NAMES, StateEncoder
from magical_mj.utils.errors import InvalidSceneError

STACKS: Final = {"ego_stack": "LoRes4E", "allo_stack": "LoRes4A"}
"""The names of stacks of frames -> the presets of the Gymnasium environments that observe the same."""

Draw = Callable[[Any, str, int, Images], object]
"""Draws a view of the present state of physics: its name, its size in pixels, and the array to draw it in."""


class CurrentObservable(observable.Generic):
    """An observable with a known spec, so that reading the spec draws nothing. It is enabled by default."""

    def __init__(self, function: Callable[[Any], Any], spec: specs.Array) -> None:
        super().__init__(function)
        self._own_spec = spec
        self.enabled = True

    @property
    def array_spec(self) -> specs.Array:
        """Shape and type."""
        return self._own_spec


class LatestFrames(CurrentObservable):
    """The frames of a view after the last four actions, oldest first. Shape (size, size, 12).

    The first frame of an episode fills the stack. A frame is taken after each action, when it is first needed, and at
    the latest before the next action. So a stack is complete, whenever and however often composer evaluates it.

    Args:
        draw: draws a view of the present state.
        name: of the observation, one of `STACKS`.
        size: side of the frames in pixels.
    """

    def __init__(self, draw: Draw, name: str, size: int) -> None:
        self._draw, self._size = draw, size
        self._stacks = Stacks(PRESETS[STACKS[name]], size)
        self._frames: Mapping[str, Images] = {}
        self._observed = self._due = False  # in this episode; since the last action
        (shape,) = self._stacks.shapes.values()
        spec = specs.BoundedArray(shape, np.uint8, 0, 255, name)
        super().__init__(self._observe, spec)

    def begin(self, frames: Mapping[str, Images]) -> None:
        """Begins an episode, with the frames of a state if they fit."""
        self._frames, self._observed = frames, False

    def catch_up(self, physics: Any) -> None:
        """Takes the frame after the last action if that is due, which composer may not have asked for."""
        if self._observed:
            self._take(physics)

    def after_action(self) -> None:
        """Another frame is to be taken: not at once, since hooks may change the state."""
        self._due = True

    def save(self, physics: Any) -> dict[str, Images]:
        """A copy of the stack, by the name that it has in states; nothing if it is not observed in this episode."""
        self.catch_up(physics)
        return self._stacks.save() if self._observed else {}

    def _observe(self, physics: Any) -> Images:
        self._take(physics)
        (stack,) = self._stacks.latest.values()
        return stack.copy()

    def _take(self, physics: Any) -> None:
        def draw(view: str, place: Images) -> None:
            self._draw(physics, view, self._size, place)

        if not self._observed:
            self._stacks.start(draw, self._frames)
        elif self._due:
            self._stacks.push(draw)
        self._observed, self._due = True, False


class Bound(observable.Observable):
    """An observable that looks elements up once in an episode, since that takes longer than to read them.

    Args:
        bind: returns, of a physics, the function that observes.
    """

    def __init__(self, bind: Callable[[Any], Callable[[], Any]]) -> None:
        super().__init__(1, None, None, None, None)
        self._bind = bind

    def _callable(self, physics: Any) -> Callable[[], Any]:
        return self._bind(physics)


class PlanarObservables(composer.Observables):
    """Of a body that moves in the plane."""

    @composer.observable
    def pose(self) -> Bound:
        """x, y, angle: world coordinates; the angle is not wrapped. Shape (3,)."""
        return Bound(lambda physics: _values(physics, "qpos", self._entity.joints))

    @composer.observable
    def velocity(self) -> Bound:
        """Velocities of x, y and the angle, in world coordinates. Shape (3,)."""
        return Bound(lambda physics: _values(physics, "qvel", self._entity.joints))


class BlockObservables(PlanarObservables):
    """Of a block. They exist in episodes in which the block does."""

    @composer.observable
    def egocentric_pose(self) -> Bound:
        """The pose in the robot's frame: to its right, ahead of it, and the angle in [-pi, pi]. Shape (3,)."""

        def bind(physics: Any) -> Callable[[], Rows]:
            relative = _in_frame(physics, self._entity.parent.robot, [self._entity])
            return lambda: relative()[0]

        return Bound(bind)

    @composer.observable
    def contact(self) -> Bound:
        """1 where the robot touches the block, else 0. Shape ()."""

        def bind(physics: Any) -> Callable[[], Rows]:
            touching = _touching(physics, self._entity.parent.robot, [self._entity])
            return lambda: touching()[0]

        return Bound(bind)


class RobotObservables(PlanarObservables):
    """Of the robot. What it observes of blocks has the same shape in every episode, with zeros for absent blocks."""

    @composer.observable
    def egocentric_blocks(self) -> Bound:
        """All blocks in the robot's frame. Shape (10, 4): 1 if the block exists, and its `egocentric_pose`."""

        def bind(physics: Any) -> Callable[[], Rows]:
            blocks = _check_count(self._entity.parent.blocks)
            relative = _in_frame(physics, self._entity, blocks)
            return lambda: _padded(np.insert(relative(), 0, 1, axis=1))

        return Bound(bind)

    @composer.observable
    def contacts(self) -> Bound:
        """1 for each block that the robot touches, else 0. Shape (10,)."""

        def bind(physics: Any) -> Callable[[], Rows]:
            touching = _touching(physics, self._entity, _check_count(self._entity.parent.blocks))
            return lambda: _padded(touching())

        return Bound(bind)

    @composer.observable
    def egocentric_camera(self) -> observable.MJCFCamera:
        """What `physics.render` draws with the robot's camera: the lit model, not the benchmark's flat view."""
        return observable.MJCFCamera(self._entity.mjcf_model.find("camera", "ego"), height=96, width=96)


class GripperObservables(RobotObservables):
    """Of a robot with fingers."""

    @composer.observable
    def fingers(self) -> Bound:
        """The angles of the left and the right finger. Shape (2,)."""
        return Bound(lambda physics: _values(physics, "qpos", self._entity.fingers))

    @composer.observable
    def finger_velocities(self) -> Bound:
        """The velocities of these angles. Shape (2,)."""
        return Bound(lambda physics: _values(physics, "qvel", self._entity.fingers))


class ArenaObservables(composer.Observables):
    """Of the arena, which the goal regions are part of."""

    @composer.observable
    def regions(self) -> observable.Generic:
        """The goal regions, as in the state vector. Shape (3, 9), float32.

        A row is 1 if the region exists, x_min, y_min, x_max, y_max, and its colour as one-hot: red, green, blue or
        yellow. Rows of absent regions are 0.
        """
        first = STATE_NAMES.index("region0.present")
        return observable.Generic(lambda _: StateEncoder(self._entity.scene).fixed[first:].reshape(MAX_REGIONS, -1))

    @composer.observable
    def top_camera(self) -> observable.MJCFCamera:
        """What `physics.render` draws with the camera "allo": the lit model, not the benchmark's flat view."""
        return observable.MJCFCamera(self._entity.mjcf_model.find("camera", "allo"), height=96, width=96)


def _values(physics: Any, kind: str, joints: Sequence[Any]) -> Callable[[], Rows]:
    """Reads the coordinates ("qpos") or velocities ("qvel") of joints, into a fresh array. Shape (joints,)."""
    bound = physics.bind(joints)
    return lambda: np.array(getattr(bound, kind))


def _in_frame(physics: Any, robot: PlanarEntity, blocks: Sequence[PlanarEntity]) -> Callable[[], Rows]:
    """Reads the poses of blocks in the robot's frame. Shape (blocks, 3)."""
    values = _values(physics, "qpos", [joint for it in (robot, *blocks) for joint in it.joints])

    def read() -> Rows:
        robot, *poses = values().reshape(-1, 3)
        x, y, angle = (np.reshape(poses, (-1, 3)) - robot).T
        cosine, sine = math.cos(robot[2]), math.sin(robot[2])
        turned = np.arctan2(np.sin(angle), np.cos(angle))
        return np.stack((cosine * x + sine * y, cosine * y - sine * x, turned), axis=1)

    return read


def _touching(physics: Any, robot: PlanarEntity, blocks: Sequence[PlanarEntity]) -> Callable[[], Rows]:
    """Reads which blocks touch the robot: 1, else 0. Shape (blocks,).

    Contacts are those of the present state. Their forces are not: MuJoCo has solved for those of the step before.
    """
    model, data = physics.model.ptr, physics.data.ptr
    ours, *theirs = physics.bind([it.frame for it in (robot, *blocks)]).element_id
    root_of_geom = model.body_rootid[model.geom_bodyid]

    def read() -> Rows:
        contact = data.contact
        roots = root_of_geom[contact.geom[(contact.exclude == 0) & (contact.geom >= 0).all(axis=1)]]
        touched = roots[:, ::-1][roots == ours]  # what is at the other side of each contact of the robot
        return np.isin(theirs, touched).astype(np.float64)

    return read


def _padded(rows: Rows) -> Rows:
    """Rows of blocks, with zeros for those that do not exist. Shape (10, ...)."""
    return np.concatenate((rows, np.zeros((MAX_BLOCKS - len(rows), *rows.shape[1:]))))


def _check_count(blocks: Sequence[PlanarEntity]) -> Sequence[PlanarEntity]:
    """The blocks, if there are rows for all.

    Raises:
        InvalidSceneError: if there are not.
    """
    if len(blocks) > MAX_BLOCKS:
        raise InvalidSceneError(
            f"observables of all blocks hold {MAX_BLOCKS}, this scene has {len(blocks)}; enable those of single blocks"
        )
    return blocks
