"""The frames of bodies and cameras in a batch: x, y, cosine and sine of the angle, for `scanlines.paint`.

Numba compiles these functions for processors and for accelerators, see `rendering.scanlines`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from magical_mj.observations import VIEWS
from magical_mj.rendering.scanlines import compiled, inlined, product
from magical_mj.scene import constants as c

WORLD, ROBOT, LEFT_FINGER, RIGHT_FINGER, FIRST_BLOCK = range(5)
"""The numbers of bodies. Block i is FIRST_BLOCK + i, and the last frame is the camera's."""
X, Y, COSINE, SINE, VISIBLE = range(5)
"""The columns of a table of cameras: the pose in the frame of its body, and the side of the visible square."""

_EGO = VIEWS.index("ego")
_ROOT_X, _ROOT_Y = c.FINGER_ROOT


@inlined
def moved(body: Any, x: float, y: float) -> Any:
    """The point x, y of a body's frame in the world frame."""
    return (
        body[0] + (product(body[2], x) - product(body[3], y)),
        body[1] + (product(body[3], x) + product(body[2], y)),
    )


@inlined
def body_frame(body: int, poses: Any, fingers: Any) -> Any:
    """The frame of a body, see `write_frame`."""
    if body == WORLD:
        return 0.0, 0.0, 1.0, 0.0
    row = max(body - RIGHT_FINGER, 0)
    x, y, angle = np.float64(poses[row, 0]), np.float64(poses[row, 1]), np.float64(poses[row, 2])
    if LEFT_FINGER <= body <= RIGHT_FINGER:
        root = -_ROOT_X if body == LEFT_FINGER else _ROOT_X
        x, y = moved((x, y, math.cos(angle), math.sin(angle)), root, _ROOT_Y)
        angle += np.float64(fingers[body - LEFT_FINGER])
    return x, y, math.cos(angle), math.sin(angle)


@inlined
def write_frame(number: int, view: int, camera: Any, poses: Any, fingers: Any, frames: Any) -> None:
    """Writes one of an environment's frames.

    Args:
        number: which one.
        view: the camera's view, an index into `VIEWS`. The camera of "ego" is on the robot, "allo" in the world.
        camera: its row of the table of cameras.
        poses: x, y, angle of the robot and of each block. Shape (1 + blocks, 3).
        fingers: angles of the left and the right finger. Shape (2,).
        frames: where to write it, shape (frames, 4).
    """
    if number < len(frames) - 1:
        x, y, cosine, sine = body_frame(number, poses, fingers)
    else:
        body = body_frame(ROBOT if view == _EGO else WORLD, poses, fingers)
        x, y = moved(body, camera[X], camera[Y])
        cosine = product(body[2], camera[COSINE]) - product(body[3], camera[SINE])
        sine = product(body[3], camera[COSINE]) + product(body[2], camera[SINE])
    frames[number, 0], frames[number, 1], frames[number, 2], frames[number, 3] = x, y, cosine, sine


@compiled("void(i8, f8[::1], f8[:, ::1], f8[::1], f8[:, ::1])")
def write_frames(view: int, camera: Any, poses: Any, fingers: Any, frames: Any) -> None:
    """Writes all frames of an environment."""
    for number in range(len(frames)):
        write_frame(number, view, camera, poses, fingers, frames)
