"""The robot's bodies as data. A drive moves the body in the plane.

`gripper` is MAGICAL's robot. The three sticks are those of x-magical (Zakka et al. 2021, XIRL). They push with their
whole front side. All bodies have the same mass and the same drive, so their abilities differ only by their shapes.
Your own body is a `Body` in a module, given as ``"package.module:BODY"``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene import constants as c
from magical_mj.utils.errors import InvalidSceneError, short_repr, unknown_name
from magical_mj.utils.imports import is_reference, resolve

Point = tuple[float, float]


@dataclass(frozen=True)
class Body:
    """A body of the robot in its own frame: x to the right, y ahead, world units.

    Attributes:
        outline: four or more corners of a convex polygon around the origin, counter-clockwise; empty for a disc.
        radius: the radius of a disc.
        mass: the mass without the fingers.
        inertia: the moment about the origin, without the fingers.
        fingers: whether it has the gripper's two fingers.
        eye: the centre of the right eye. The left one is its mirror image.

    Raises:
        InvalidSceneError: if the outline is not such a polygon, or a number is not positive.
    """

    outline: tuple[Point, ...] = ()
    radius: float = c.ROBOT_RADIUS
    mass: float = c.ROBOT_MASS
    inertia: float = c.ROBOT_INERTIA
    fingers: bool = False
    eye: Point = c.EYE_CENTRE

    def __post_init__(self) -> None:
        """Checks the numbers and the outline."""
        sizes: tuple[Any, ...] = self.radius, self.mass, self.inertia
        if not all(isinstance(value, int | float) and 0 < value < math.inf for value in sizes):
            raise InvalidSceneError(f"radius, mass and inertia of a body must be positive: {short_repr(self)}")
        try:
            corners = self.corners
        except (TypeError, ValueError):
            corners = np.empty(0)  # rejected below
        fitting = corners.shape[1:] == (2,) and len(corners) > 3 and is_convex(corners) and surrounds_origin(corners)
        if self.outline and not fitting:
            raise InvalidSceneError(
                "the outline of a body must be the corners (x, y) of a convex polygon around the origin, four or more, "
                f"counter-clockwise, not {short_repr(self.outline)}"
            )

    @property
    def total_mass(self) -> float:
        """The mass with the fingers."""
        return self.mass + 2 * c.FINGER_MASS * self.fingers

    @property
    def reach(self) -> float:
        """The largest distance of one of its points from the origin, without the fingers."""
        return max((math.hypot(*corner) for corner in self.outline), default=self.radius)

    @property
    def corners(self) -> NDArray[np.float64]:
        """The outline as an array. Shape (n, 2)."""
        return np.array(self.outline, float)


def is_convex(corners: NDArray[np.float64]) -> bool:
    """Whether a polygon with these corners, shape (n, 2), is convex and counter-clockwise."""
    ahead = np.roll(corners, -1, axis=0) - corners
    onward = np.roll(ahead, -1, axis=0)
    turns = ahead[:, 0] * onward[:, 1] - ahead[:, 1] * onward[:, 0]
    whole = np.arctan2(turns, (ahead * onward).sum(axis=1)).sum()  # a pentagram turns twice
    return bool((turns > 0).all() and whole < 3 * np.pi)


def surrounds_origin(corners: NDArray[np.float64]) -> bool:
    """Whether the origin is inside a convex polygon with these counter-clockwise corners, shape (n, 2)."""
    ahead = np.roll(corners, -1, axis=0) - corners
    return bool((ahead[:, 1] * corners[:, 0] > ahead[:, 0] * corners[:, 1]).all())


def stick(width: float, inertia: float) -> Body:
    """A box of this width across the heading, and length 0.1."""
    x, y = width / 2, 0.05
    return Body(((x, y), (-x, y), (-x, -y), (x, -y)), inertia=inertia, eye=(0.06, 0.0))


GRIPPER: Final = "gripper"
"""The default body."""
BODIES: Final[Mapping[str, Body]] = MappingProxyType(
    {
        GRIPPER: Body(fingers=True),
        "shortstick": stick(0.3, inertia=0.1 / 12),
        "mediumstick": stick(0.6, inertia=0.37 / 12),
        "longstick": stick(1.6, inertia=2.608 / 12),  # 1.5 % above its box's, to match the original's slower rotation
    }
)


@lru_cache(32)
def body_named(name: str) -> Body:
    """The body with this name, or the object of ``"package.module:BODY"``, whose module is imported.

    Raises an `InvalidSceneError` if it does not exist.
    """
    if name in BODIES:
        return BODIES[name]
    try:
        body: Any = resolve(check_body_name(name))
    except ImportError as error:
        raise InvalidSceneError(f"the body {short_repr(name)} cannot be imported: {error}") from error
    if not isinstance(body, Body):
        raise InvalidSceneError(f"{name} must be a magical_mj.scene.bodies.Body, not {short_repr(body)}")
    return body


def check_body_name(name: object) -> str:
    """The name, if it is valid for a body; otherwise an `InvalidSceneError` is raised. Nothing is imported."""
    if isinstance(name, str) and (name in BODIES or is_reference(name)):
        return str(name)
    raise InvalidSceneError(str(unknown_name("body", name, (*BODIES, "package.module:BODY"))))
