"""Pictures: their type, their size, and what the cameras ego and allo see of a model."""

from __future__ import annotations

from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.style import DRAWN_GROUP, TASK_GROUP
from magical_mj.observations import CAMERAS, SEGMENTATIONS
from magical_mj.utils.errors import SettingsError, as_integer, check_name, short_repr

Picture = NDArray[np.uint8]
"""Shape (height, width, channels)."""
LARGEST: Final = 2048
"""Side of the largest picture, in pixels."""
DRAWN_GROUPS: Final = (0, DRAWN_GROUP, TASK_GROUP)
"""Geom and skin groups that the cameras ego and allo see: MuJoCo's default (for users' additions) and ours."""


def drawn(groups: NDArray[np.integer]) -> NDArray[np.bool_]:
    """For each of these geom or skin groups, whether the cameras ego and allo see it."""
    return np.isin(np.clip(groups, 0, mujoco.mjNGROUP - 1), DRAWN_GROUPS)  # clipped as by MuJoCo


def check_size(value: Any, name: str = "image_size") -> int:
    """The side of a picture as an int.

    Raises:
        SettingsError: unless it is an integer in 1..LARGEST; the error calls it `name`.
    """
    size = as_integer(value, 1, LARGEST)
    if size is None:
        raise SettingsError(f"{name} must be an integer in 1..{LARGEST} (pixels per side), not {short_repr(value)}")
    return size


def check_picture(view: str, size: Any, out: Any = None) -> int:
    """The side of a picture as an int, after a check of what it shows and of the array to write it to, if any.

    Raises:
        UnknownNameError: if the view is unknown.
        SettingsError: unless the size is allowed and the array fits it.
    """
    check_name("view", view, (*CAMERAS, *SEGMENTATIONS))
    size = check_size(size, "size")
    if out is None:
        return size
    shape = (size, size) if view in SEGMENTATIONS else (size, size, 3)
    if not isinstance(out, np.ndarray):
        raise SettingsError(f"out must be an array of shape {shape}, uint8, not {short_repr(out)}")
    if out.shape != shape or out.dtype != np.uint8 or not out.flags.writeable:
        given = f"{'an' if out.flags.writeable else 'a read-only'} array of shape {out.shape}, {out.dtype}"
        raise SettingsError(f"out must be a writable array of shape {shape}, uint8, not {given}")
    return size
