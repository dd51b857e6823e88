"""Canvases: OpenGL contexts, each with MuJoCo's drawing contexts (`MjrContext`) for the last few kinds of models.

A drawing context holds the meshes, textures and skins of a model, and draws all models that have the same ones. Most
models of this package differ only in the number of regions, so a few drawing contexts are enough.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import partial
from hashlib import blake2b
from typing import Any, Final, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.style import DRAWN_GROUP, TASK_GROUP
from magical_mj.rendering.backend import NO_OPENGL
from magical_mj.utils.errors import RenderingError

T = TypeVar("T")
Picture = NDArray[np.uint8]
"""Shape (height, width, channels)."""

DRAWN_GROUPS: Final = (0, DRAWN_GROUP, TASK_GROUP)
"""Geom and skin groups that the cameras ego and allo see: MuJoCo's default (for users' additions) and ours."""
KEPT: Final = 8
"""Drawing contexts of a canvas, of 4 MB each without shadows."""
GEOMS: Final = 1000
"""A scene has room for so many geoms, and for more if a model has more."""

_IS_DRAWN: Final = np.isin(np.arange(mujoco.mjNGROUP), DRAWN_GROUPS)
_OFFSCREEN: Final = mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value
_PLANE: Final = mujoco.mjtGeom.mjGEOM_PLANE.value
_ASSETS: Final = (
    *("mesh_vertnum", "mesh_facenum", "mesh_vert", "mesh_normal", "mesh_face", "mesh_facenormal", "mesh_graph"),
    *("mesh_texcoord", "mesh_facetexcoord", "tex_type", "tex_height", "tex_width", "tex_nchannel", "tex_data"),
    *("hfield_nrow", "hfield_ncol", "hfield_size", "hfield_data", "skin_vertnum", "skin_face", "skin_texcoord"),
    *("flex_dim", "flex_vertnum", "flex_edge", "flex_elem", "flex_shell", "flex_texcoord"),
)
"""What a drawing context copies from a model, or a scene makes room for."""


def drawn(groups: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Which of these geom or skin groups the cameras ego and allo see."""
    return _IS_DRAWN.take(groups, mode="clip")  # MuJoCo clips groups likewise


def kind_of(model: mujoco.MjModel, *, lit: bool) -> bytes:
    """A digest that is the same for all models that one drawing context can draw, with lights and shadows or flat."""
    planes = model.geom_type == _PLANE
    if not lit:
        planes &= drawn(model.geom_group)
    materials = model.geom_matid[planes]
    arrays = (
        *(getattr(model, name) for name in _ASSETS),
        *(model.geom_size[planes], materials, model.mat_texrepeat[materials[materials >= 0]]),
    )
    digest = blake2b(bytes([lit]), digest_size=16)
    for array in arrays:
        digest.update(f"{array.shape}".encode())
        digest.update(array.tobytes())
    return digest.digest()


class Drawing:
    """A drawing context and a scene (`MjvScene`) for models of one kind. What the scene holds is valid for one picture.

    Without lights it has no shadow map, which takes 100 MB, no shadows, reflections, haze or sky, and no depth: later
    geoms are drawn over earlier ones.
    """

    def __init__(self, model: mujoco.MjModel, *, lit: bool) -> None:
        from OpenGL.raw.GL.VERSION import GL_1_0, GL_3_0  # the whole `OpenGL.GL` takes 85 ms and 6 MB

        self._read = partial(GL_1_0.glReadPixels, 0, 0)
        self._format = GL_1_0.GL_RGBA, GL_1_0.GL_UNSIGNED_BYTE
        depth = GL_3_0.GL_FRAMEBUFFER, GL_3_0.GL_DEPTH_STENCIL_ATTACHMENT, GL_3_0.GL_RENDERBUFFER, 0
        self._drop_depth = partial(GL_3_0.glFramebufferRenderbuffer, *depth)
        self._lit, self._pixels = lit, np.empty((0, 0, 4), np.uint8)
        model = copy(model)
        model.vis.quality.offsamples = 0
        if not lit:
            model.vis.quality.shadowsize = 0
        self.context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
        self._scene = self._new_scene(model, GEOMS)

    def _new_scene(self, model: mujoco.MjModel, geoms: int) -> mujoco.MjvScene:
        scene = mujoco.MjvScene(model, geoms)
        if not self._lit:
            scene.flags[:] = 0
            scene.flags[mujoco.mjtRndFlag.mjRND_CULL_FACE] = 1  # the undersides, which cost time
        return scene

    def scene(self, model: mujoco.MjModel) -> mujoco.MjvScene:
        """The scene, with room for this model."""
        geoms = 2 * (model.ngeom + model.nsite + model.nskin + model.nflex + model.nwrap + model.nsensor)
        if geoms > self._scene.maxgeom:
            self._scene = self._new_scene(model, geoms)
        return self._scene

    def draw(self, side: int) -> Picture:
        """The picture of the scene: red, green, blue, alpha; bottom row first. Shape (side, side, 4).

        Alpha is 0, like the colours, where nothing was drawn. The next call overwrites the array.
        """
        context = self.context
        resized = len(self._pixels) != side
        if resized:  # the whole buffer: clearing a part of it is slow
            mujoco.mjr_resizeOffscreen(side, side, context)
            self._pixels = np.empty((side, side, 4), np.uint8)
        mujoco.mjr_setBuffer(_OFFSCREEN, context)
        if resized and not self._lit:
            self._drop_depth()
        mujoco.mjr_render(mujoco.MjrRect(0, 0, side, side), self._scene, context)
        self._read(side, side, *self._format, self._pixels)  # mjr_readPixels has no alpha, and is slower
        return self._pixels


class Canvas:
    """An OpenGL context with its drawings."""

    def __init__(self, context: Any) -> None:
        self.context = context
        self.drawings: dict[bytes, Drawing] = {}  # the last one used at the end

    @property
    def is_fresh(self) -> bool:
        """Whether nothing was drawn with it."""
        return not self.drawings

    def draw(self, job: Callable[[Canvas], T]) -> T:
        """What the job returns, called with this canvas while its context is current in this thread.

        Raises:
            BlockedError: if it cannot be current in this thread.
        """
        before = self.context.begin()
        try:
            return job(self)
        finally:
            self.context.end(before)

    def drawing(self, model: mujoco.MjModel, kind: bytes, *, lit: bool) -> Drawing:
        """The drawing for a model of this kind."""
        drawing = self.drawings.pop(kind, None)
        if drawing is None:
            if len(self.drawings) >= KEPT:
                self.drawings.pop(next(iter(self.drawings))).context.free()
            try:
                drawing = Drawing(model, lit=lit)
            except Exception as error:
                raise RenderingError(NO_OPENGL.format(error=error)) from error
        self.drawings[kind] = drawing
        return drawing

    def close(self) -> None:
        """Frees everything, and leaves this thread without a context."""
        self.context.begin()
        for drawing in self.drawings.values():
            drawing.context.free()
        self.context.free()

    def name(self) -> str:
        """OpenGL's renderer and version."""
        from OpenGL.GL import GL_RENDERER, GL_VERSION, glGetString

        return " / ".join(glGetString(name).decode() for name in (GL_RENDERER, GL_VERSION))
