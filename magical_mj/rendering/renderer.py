"""The views of one model, drawn by OpenGL or by the software renderer."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

import mujoco

from magical_mj.rendering.backend import NO_OPENGL, check_renderer, drawn_by, opengl
from magical_mj.rendering.opengl import OpenGLRenderer
from magical_mj.rendering.picture import Picture
from magical_mj.rendering.software import SoftwareRenderer
from magical_mj.scene.state_vector import SEGMENTATIONS, SOLID_VIEW
from magical_mj.utils.errors import RenderingError


class Views:
    """Draws all views of one model. The renderer of each view is made when the view is first drawn.

    Args:
        model: the model.
        renderer: "opengl" or "software" for the flat views. If None, the value of MAGICAL_MJ_RENDERER; if that is not
            set, OpenGL if it works here, or software with a warning. Only OpenGL draws what users add to a model.
        cameras: view -> the name of the model's camera, where it differs.
    """

    def __init__(
        self, model: mujoco.MjModel, renderer: str | None = None, cameras: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        self.model, self._cameras = model, cameras
        self._wanted = check_renderer(renderer)
        self._renderers: dict[str, OpenGLRenderer | SoftwareRenderer] = {}

    def draw(
        self, data: mujoco.MjData, view: str, size: int, out: Picture | None = None, uncovered: Picture | None = None
    ) -> Picture:
        """The view of the present state, top row first, fresh or in `out`: RGB, shape (size, size, 3), uint8.

        Args:
            data: the state; its positions must be current (as after `mj_forward`).
            view: "ego", "allo", "scene", or a segmentation such as "ego-segmentation", which has shape (size, size).
            size: pixels per side.
            out: the array to write it to.
            uncovered: for a flat view, the array for the number of uncovered samples, 0 to 4, of each pixel. Shape
                (size, size).

        Raises:
            RenderingError: if OpenGL is needed and does not work here.
        """
        if view == SOLID_VIEW:
            kind = view
        elif view in SEGMENTATIONS:
            kind = "segments"
        else:
            kind = "flat"
        if kind not in self._renderers:
            self._renderers[kind] = self._new_renderer(kind)
        return self._renderers[kind].draw(data, self._cameras.get(view, view), size, out, uncovered)

    def _new_renderer(self, kind: str) -> OpenGLRenderer | SoftwareRenderer:
        if kind == "segments":
            return SoftwareRenderer(self.model)
        if kind == "flat" and drawn_by(self._wanted) == "software":
            with contextlib.suppress(RenderingError):  # if users have changed the model
                renderer = SoftwareRenderer(self.model)
                if self._wanted is None:
                    _warn_of_software()
                return renderer
        return OpenGLRenderer(self.model, lit=kind == SOLID_VIEW)


@cache
def _warn_of_software() -> None:
    """Warns once that the software renderer draws the pictures."""
    warnings.warn(
        f"{NO_OPENGL.format(error=opengl().problem)} Until then the software renderer draws the flat views; "
        'renderer="software" says that you want it',
        stacklevel=5,
    )
