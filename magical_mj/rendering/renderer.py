"""What draws the views of one model: OpenGL, or the software renderer."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from magical_mj.rendering.backend import check_renderer
from magical_mj.rendering.canvas import Picture
from magical_mj.rendering.canvases import FORKED
from magical_mj.rendering.flat import FlatRenderer
from magical_mj.rendering.solid import SolidRenderer
from magical_mj.scene.state_vector import SEGMENTATIONS, SOLID_VIEW
from magical_mj.utils.errors import RenderingError, SettingsError, as_integer, short_repr

if TYPE_CHECKING:
    from magical_mj.rendering.software import SoftwareRenderer

LARGEST: Final = 2048
"""Side of the largest picture, in pixels."""


def check_size(value: Any, name: str = "image_size") -> int:
    """The side of a picture as an int.

    Raises:
        SettingsError: unless it is an integer in 1..LARGEST; the error calls it `name`.
    """
    size = as_integer(value, 1, LARGEST)
    if size is None:
        raise SettingsError(f"{name} must be an integer in 1..{LARGEST} (pixels per side), not {short_repr(value)}")
    return size


def check_out(out: Any, size: int, channels: tuple[int, ...] = (3,)) -> None:
    """Raises a `SettingsError` unless a picture of this size can be written to the array, if there is one."""
    if out is None:
        return
    shape = (size, size, *channels)
    if not isinstance(out, np.ndarray):
        raise SettingsError(f"out must be an array of shape {shape}, uint8, not {short_repr(out)}")
    if out.shape != shape or out.dtype != np.uint8:
        raise SettingsError(f"out must be of shape {shape}, uint8, not {out.shape}, {out.dtype}")
    if not out.flags.writeable:
        raise SettingsError("out is a read-only array; give one that can be written to, or a copy")


class Views:
    """Draws all views of one model; what each needs is made when it is first drawn.

    Args:
        model: the model.
        renderer: "opengl" or "software" for the flat views. None: as MAGICAL_MJ_RENDERER says, else OpenGL if it works
            here, else software with a warning. What users have added to a model is drawn by OpenGL alone.
        cameras: the names of the model's cameras where they are not those of the views.
    """

    def __init__(
        self, model: mujoco.MjModel, renderer: str | None = None, cameras: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        self.model, self._cameras = model, cameras
        self._wanted = check_renderer(renderer)
        self._flat: FlatRenderer | SoftwareRenderer | None = None
        self._segments: SoftwareRenderer | None = None
        self._solid: SolidRenderer | None = None

    def draw(
        self, data: mujoco.MjData, view: str, size: int, out: Picture | None = None, bare: Picture | None = None
    ) -> Picture:
        """The view of the present state, top row first, fresh or in `out`: RGB, shape (size, size, 3), uint8.

        Args:
            data: the state; its positions must be current (as after `mj_forward`).
            view: "ego", "allo", "scene", or a segmentation such as "ego-segmentation", which has shape (size, size).
            size: pixels per side.
            out: where to write it.
            bare: where to write how many of the four samples of each pixel of a flat view nothing covers, shape
                (size, size); None: nowhere.

        Raises:
            RenderingError: if OpenGL is needed and does not work here; it says what to do.
            SettingsError: if `out` cannot hold it.
        """
        if view in SEGMENTATIONS:
            check_out(out, size, ())
            self._segments = self._segments or _software(self.model)
            return self._segments.draw(data, view, size, out)
        check_out(out, size)
        if view == SOLID_VIEW:
            self._solid = self._solid or SolidRenderer(self.model)
            return self._solid.draw(data, size, out)
        self._flat = self._flat or self._choose()
        return self._flat.draw(data, self._cameras.get(view, view), size, out, bare)

    def _choose(self) -> FlatRenderer | SoftwareRenderer:
        if self._wanted == "software":
            with contextlib.suppress(RenderingError):  # of a model that users have changed
                return _software(self.model)
            return FlatRenderer(self.model)
        try:
            renderer = FlatRenderer(self.model)
            renderer.start()
            return renderer
        except RenderingError as error:
            if self._wanted != "opengl" and str(error) != FORKED:
                with contextlib.suppress(RenderingError):
                    renderer = _software(self.model)
                    _warn(str(error))
                    return renderer
            raise


def _software(model: mujoco.MjModel) -> SoftwareRenderer:
    from magical_mj.rendering.software import SoftwareRenderer  # imported late: it compiles

    return SoftwareRenderer(model)


@cache
def _warn(error: str) -> None:
    """Says once that pictures come from the software renderer."""
    text = f'{error} Until then the software renderer draws the flat views; renderer="software" says that you want it'
    warnings.warn(text, stacklevel=5)
