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


class PlanarObservables(composer.Observables):
    """Of a body that moves in the plane."""

    @composer.observable
    def pose(self) -> observable.Generic:
        """x, y, angle: world coordinates; the angle is not wrapped. Shape (3,)."""
        return observable.Generic(lambda physics: _coordinates(physics, "qpos", self._entity)[0])

    @composer.observable
    def velocity(self) -> observable.Generic:
        """Velocities of x, y and the angle, in world coordinates. Shape (3,)."""
        return observable.Generic(lambda physics: _coordinates(physics, "qvel", self._entity)[0])


class BlockObservables(PlanarObservables):
    """Of a block. They exist in episodes in which the block does."""

    @composer.observable
    def egocentric_pose(self) -> observable.Generic:
        """The pose in the robot's frame: to its right, ahead of it, and the angle in [-pi, pi]. Shape (3,)."""

        def relative(physics: Any) -> Rows:
            robot, block = _coordinates(physics, "qpos", self._entity.parent.robot, self._entity)
            return _in_frame(robot, block[None])[0]

        return observable.Generic(relative)

    @composer.observable
    def contact(self) -> observable.Generic:
        """1 where the robot touches the block, else 0. Shape ()."""
        return observable.Generic(lambda physics: _touching(physics, self._entity.parent.robot, [self._entity])[0])


class RobotObservables(PlanarObservables):
    """Of the robot. What it observes of blocks has the same shape in every episode, with zeros for absent blocks."""

    @composer.observable
    def egocentric_blocks(self) -> observable.Generic:
        """All blocks in the robot's frame. Shape (10, 4): 1 if the block exists, and its `egocentric_pose`."""

        def relative(physics: Any) -> Rows:
            blocks = _check_count(self._entity.parent.blocks)
            robot, *others = _coordinates(physics, "qpos", self._entity, *blocks)
            rows = np.zeros((MAX_BLOCKS, 4))
            rows[: len(blocks), 0] = 1
            rows[: len(blocks), 1:] = _in_frame(robot, np.reshape(others, (-1, 3)))
            return rows

        return observable.Generic(relative)

    @composer.observable
    def contacts(self) -> observable.Generic:
        """1 for each block that the robot touches, else 0. Shape (10,)."""

        def touching(physics: Any) -> Rows:
            blocks = _check_count(self._entity.parent.blocks)
            return np.pad(_touching(physics, self._entity, blocks), (0, MAX_BLOCKS - len(blocks)))

        return observable.Generic(touching)

    @composer.observable
    def egocentric_camera(self) -> observable.MJCFCamera:
        """What `physics.render` draws with the robot's camera: the lit model, not the benchmark's flat view."""
        return observable.MJCFCamera(self._entity.mjcf_model.find("camera", "ego"), height=96, width=96)


class GripperObservables(RobotObservables):
    """Of a robot with fingers."""

    @composer.observable
    def fingers(self) -> observable.Generic:
        """The angles of the left and the right finger. Shape (2,)."""
        return observable.Generic(lambda physics: np.array(physics.bind(self._entity.fingers).qpos))

    @composer.observable
    def finger_velocities(self) -> observable.Generic:
        """The velocities of these angles. Shape (2,)."""
        return observable.Generic(lambda physics: np.array(physics.bind(self._entity.fingers).qvel))


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


def _coordinates(physics: Any, kind: str, *things: PlanarEntity) -> Rows:
    """The coordinates ("qpos") or velocities ("qvel") of planar bodies. Shape (things, 3), fresh."""
    joints = [joint for thing in things for joint in thing.joints]
    return np.array(getattr(physics.bind(joints), kind)).reshape(-1, 3)


def _in_frame(robot: Rows, poses: Rows) -> Rows:
    """Poses in the robot's frame. Shape (n, 3)."""
    x, y, angle = (poses - robot).T
    cosine, sine = math.cos(robot[2]), math.sin(robot[2])
    return np.stack((cosine * x + sine * y, cosine * y - sine * x, np.arctan2(np.sin(angle), np.cos(angle))), axis=1)


def _touching(physics: Any, robot: PlanarEntity, blocks: Sequence[PlanarEntity]) -> Rows:
    """1 for each block that touches the robot, else 0. Shape (blocks,).

    Contacts are those of the present state. Their forces are not: MuJoCo has solved for those of the step before.
    """
    model, contact = physics.model.ptr, physics.data.ptr.contact
    geoms = contact.geom[(contact.exclude == 0) & (contact.geom >= 0).all(axis=1)]
    roots = model.body_rootid[model.geom_bodyid[geoms]]
    ours, *theirs = np.atleast_1d(physics.bind([it.frame for it in (robot, *blocks)]).element_id)
    touched = roots[:, ::-1][roots == ours]  # what is at the other side of each contact of the robot
    return np.isin(theirs, touched).astype(np.float64)


def _check_count(blocks: Sequence[PlanarEntity]) -> Sequence[PlanarEntity]:
    """The blocks, if rows have a place for all.

    Raises:
        InvalidSceneError: if they have not.
    """
    if len(blocks) > MAX_BLOCKS:
        raise InvalidSceneError(
            f"observables of all blocks hold {MAX_BLOCKS}, this scene has {len(blocks)}; enable those of single blocks"
        )
    return blocks
