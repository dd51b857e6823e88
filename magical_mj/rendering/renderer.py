"""The choice of a renderer for each kind of picture: OpenGL, or the software renderer."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Final, Literal

import mujoco

from magical_mj.observations import SEGMENTATIONS, SOLID_VIEW, VIEWS
from magical_mj.rendering.backend import NO_OPENGL, check_renderer, drawn_by, opengl
from magical_mj.rendering.opengl import OpenGLRenderer
from magical_mj.rendering.software import SoftwareRenderer
from magical_mj.utils.errors import RenderingError

Kind = Literal["flat", "segments", "lit"]
KINDS: Final[Mapping[str, Kind]] = MappingProxyType(
    {**dict.fromkeys(VIEWS, "flat"), **dict.fromkeys(SEGMENTATIONS, "segments"), SOLID_VIEW: "lit"}
)
"""View -> the kind of its pictures. One renderer draws all pictures of a kind."""
Renderer = OpenGLRenderer | SoftwareRenderer


def new_renderer(model: mujoco.MjModel, kind: Kind, wanted: str | None = None) -> Renderer:
    """A renderer for pictures of one kind.

    Args:
        model: the model that it draws.
        kind: "flat" for the colour views ego and allo, "segments" for their segmentations, or "lit" for the 3-D view.
        wanted: "opengl" or "software" for flat pictures. If None, the value of MAGICAL_MJ_RENDERER; if that is not
            set, OpenGL if it works here, or software with a warning. Only OpenGL draws what users add to a model.
    """
    if kind == "segments":
        return SoftwareRenderer(model)
    if kind == "flat" and drawn_by(wanted) == "software":
        with contextlib.suppress(RenderingError):  # if users have changed the model
            renderer = SoftwareRenderer(model)
            if check_renderer(wanted) is None:
                _warn_of_software()
            return renderer
    return OpenGLRenderer(model, lit=kind == "lit")


@cache
def _warn_of_software() -> None:
    """Warns once that the software renderer draws the pictures."""
    warnings.warn(
        f"{NO_OPENGL.format(error=opengl().problem)} Until then the software renderer draws the flat views; "
        'renderer="software" says that you want it',
        stacklevel=4,
    )
