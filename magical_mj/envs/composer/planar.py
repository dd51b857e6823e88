"""Entities that move in the plane: their attachment frame has joints x, y and angle instead of a free joint."""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from dm_control import composer
from numpy.typing import NDArray

from magical_mj.utils.errors import SettingsError

Rows = NDArray[np.float64]

_FLAT: Final = 1e-9
"""Tolerance for poses that are outside the plane by rounding."""


class PlanarEntity(composer.Entity):
    """A body with joints x, y and angle, whose values are world coordinates.

    Attributes:
        name: the name of its tree, and the prefix of its joints' names.
    """

    name: str

    @property
    @abc.abstractmethod
    def frame(self) -> Any:
        """The attachment frame: `root_body`, without an update of the tree."""

    @property
    def joints(self) -> list[Any]:
        """Its joints x, y and angle."""
        joints = {joint.name: joint for joint in self.frame.find_all("joint", immediate_children_only=True)}
        return [joints[f"{self.name}_{coordinate}"] for coordinate in ("x", "y", "angle")]

    def get_pose(self, physics: Any) -> tuple[Rows, Rows]:
        """Current position, shape (3,), and orientation as a quaternion, shape (4,), in the world frame."""
        x, y, angle = physics.bind(self.joints).qpos
        return np.array((x, y, 0.0)), np.array((math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)))

    def set_pose(
        self, physics: Any, position: Sequence[float] | None = None, quaternion: Sequence[float] | None = None
    ) -> None:
        """Sets position and orientation. The next step or `physics.forward()` updates all dependent values.

        Args:
            physics: the physics.
            position: (x, y, 0) in the world frame.
            quaternion: a rotation about z, (w, 0, 0, z).

        Raises:
            SettingsError: if the pose is not in the plane.
        """
        joints = physics.bind(self.joints)
        if position is not None:
            x, y = self._in_plane(position, 2, "a position is (x, y, 0)")
            joints.qpos[:2] = x, y
        if quaternion is not None:
            w, _, _, z = np.asarray(quaternion, np.float64)
            self._in_plane((quaternion[1], quaternion[2]), 0, "an orientation is a rotation about z, (w, 0, 0, z)")
            joints.qpos[2] = 2 * math.atan2(z, w)

    def get_velocity(self, physics: Any) -> tuple[Rows, Rows]:
        """Linear and angular velocity, in units/s and rad/s. Shapes (3,)."""
        x, y, angle = physics.bind(self.joints).qvel
        return np.array((x, y, 0.0)), np.array((0.0, 0.0, angle))

    def set_velocity(
        self, physics: Any, velocity: Sequence[float] | None = None, angular_velocity: Sequence[float] | None = None
    ) -> None:
        """Sets linear and angular velocity.

        Args:
            physics: the physics.
            velocity: (x, y, 0), units/s.
            angular_velocity: (0, 0, z), rad/s.

        Raises:
            SettingsError: if the velocity is not in the plane.
        """
        joints = physics.bind(self.joints)
        if velocity is not None:
            joints.qvel[:2] = self._in_plane(velocity, 2, "a velocity is (x, y, 0)")
        if angular_velocity is not None:
            self._in_plane(angular_velocity[:2], 0, "an angular velocity is (0, 0, z)")
            joints.qvel[2] = angular_velocity[2]

    def _in_plane(self, values: Sequence[float], count: int, form: str) -> Sequence[float]:
        """The first `count` values. The others must be 0."""
        if any(abs(value) > _FLAT for value in values[count:]):
            raise SettingsError(f"{self.name} moves in the plane, so {form}, not {tuple(map(float, values))}")
        return values[:count]
