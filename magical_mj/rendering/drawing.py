"""Pictures of models by MuJoCo: a scene (`MjvScene`) of the model, drawn by a drawing context (`MjrContext`).

A drawing context holds the meshes, textures and skins of a model, and draws all models that have the same ones. Most
models of this package differ only in the number of regions, so each canvas needs only a few drawing contexts.
"""

from __future__ import annotations

from copy import copy
from hashlib import blake2b
from typing import Final

import mujoco
import numpy as np

from magical_mj.rendering.backend import NO_OPENGL
from magical_mj.rendering.canvas import Canvas
from magical_mj.rendering.picture import IS_DRAWN, Picture, drawn
from magical_mj.utils.errors import RenderingError

KEPT: Final = 8
"""Drawing contexts of a canvas, of 4 MB each without shadows."""
_OFFSCREEN: Final = mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value
_STILL, _MOVING = mujoco.mjtCatBit.mjCAT_STATIC.value, mujoco.mjtCatBit.mjCAT_DYNAMIC.value
_ALL: Final = mujoco.mjtCatBit.mjCAT_ALL.value
_PLANE: Final = mujoco.mjtGeom.mjGEOM_PLANE.value
_WHITE, _DARK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
_ASSETS: Final = (
    *("mesh_vertnum", "mesh_facenum", "mesh_vert", "mesh_normal", "mesh_face", "mesh_facenormal", "mesh_graph"),
    *("mesh_texcoord", "mesh_facetexcoord", "tex_type", "tex_height", "tex_width", "tex_nchannel", "tex_data"),
    *("hfield_nrow", "hfield_ncol", "hfield_size", "hfield_data", "skin_vertnum", "skin_face", "skin_texcoord"),
    *("flex_dim", "flex_vertnum", "flex_edge", "flex_elem", "flex_shell", "flex_texcoord"),
)
"""What a drawing context copies from a model."""


TRANSLUCENT: Final = (
    "the views ego and allo show opaque geoms only, and these are translucent: {names}. Give them an alpha of 1, or a "
    "group that these views do not show, such as group=4"
)


def translucent(model: mujoco.MjModel) -> list[str]:
    """The names or numbers of the geoms in groups of the flat views that are neither opaque nor invisible."""
    own = (model.geom_rgba != (0.5, 0.5, 0.5, 1.0)).any(axis=1) | (model.geom_matid < 0)
    alpha = np.where(own, model.geom_rgba[:, 3], 1.0)
    by_material = np.flatnonzero(~own)
    alpha[by_material] = model.mat_rgba[model.geom_matid[by_material], 3]
    numbers = np.flatnonzero((alpha > 0) & (alpha < 1) & drawn(model.geom_group))
    return [model.geom(number).name or f"geom {number}" for number in numbers.tolist()]


class Drawing:
    """Draws one model, with everything that MuJoCo's viewers show, or flat.

    Flat pictures show only the geoms and skins that the cameras ego and allo see, in exact colours: without lights,
    shadows, reflections, haze and sky, and without a shadow map, which takes 100 MB. They need no depth buffer, which
    takes a fifth of the time: geoms are drawn in the order in which the model lists them, static ones first. Their
    heights have the same order, so other MuJoCo viewers, which use a depth buffer, show the same picture.
    """

    def __init__(self, model: mujoco.MjModel, *, lit: bool) -> None:
        self._model, self._lit, self._kind = model, lit, b""
        self._option, self._perturbation = mujoco.MjvOption(), mujoco.MjvPerturb()
        room = 2 * (model.ngeom + model.nsite + model.nskin + model.nflex + model.nwrap + model.nsensor)
        self._scene = mujoco.MjvScene(model, room)
        self._translucent = translucent(model)
        if not lit:
            self._option.geomgroup[:] = self._option.skingroup[:] = IS_DRAWN
            self._option.sitegroup[:] = self._option.tendongroup[:] = 0
            self._scene.flags[:] = 0

    def draw(self, canvas: Canvas, data: mujoco.MjData, camera: mujoco.MjvCamera, side: int) -> Picture:
        """A picture from a camera: red, green, blue, alpha; bottom row first. Shape (side, side, 4).

        Alpha is 0, like the colours, where nothing was drawn. The canvas's next picture overwrites the array.
        """
        from OpenGL.raw.GL.VERSION import GL_1_0, GL_3_0  # the whole `OpenGL.GL` takes 85 ms and 6 MB

        if self._translucent and not self._lit:
            raise RenderingError(TRANSLUCENT.format(names=", ".join(self._translucent)))
        context = self.context(canvas)
        scene, option, perturbation = self._scene, self._option, self._perturbation
        shown = _ALL if self._lit else _STILL
        mujoco.mjv_updateScene(self._model, data, option, perturbation, camera, shown, scene)
        if not self._lit:
            mujoco.mjv_addGeoms(self._model, data, option, perturbation, _MOVING, scene)
            scene.nlight, light = 1, scene.lights[0]
            light.ambient, light.diffuse, light.specular = _WHITE, _DARK, _DARK
        resized = context.offWidth != side
        if resized:  # the whole buffer, which is cleared for each picture
            mujoco.mjr_resizeOffscreen(side, side, context)
        mujoco.mjr_setBuffer(_OFFSCREEN, context)
        if resized and not self._lit:
            depth = GL_3_0.GL_DEPTH_STENCIL_ATTACHMENT, GL_3_0.GL_RENDERBUFFER, 0
            GL_3_0.glFramebufferRenderbuffer(GL_3_0.GL_FRAMEBUFFER, *depth)
        mujoco.mjr_render(mujoco.MjrRect(0, 0, side, side), scene, context)
        if len(canvas.pixels) != side:
            canvas.pixels = np.empty((side, side, 4), np.uint8)
        # MuJoCo's own mjr_readPixels has no alpha, and is slower.
        GL_1_0.glReadPixels(0, 0, side, side, GL_1_0.GL_RGBA, GL_1_0.GL_UNSIGNED_BYTE, canvas.pixels)
        if self._translucent:
            alpha = canvas.pixels[..., 3]
            alpha[alpha > 0] = 255
        return canvas.pixels

    def context(self, canvas: Canvas) -> mujoco.MjrContext:
        """The canvas's drawing context for models of this kind."""
        self._kind = self._kind or self._kind_of()
        context = canvas.drawings.pop(self._kind, None)
        if context is None:
            if len(canvas.drawings) >= KEPT:
                canvas.drawings.pop(next(iter(canvas.drawings))).free()
            context = self._new_context()
        canvas.drawings[self._kind] = context
        return context

    def _new_context(self) -> mujoco.MjrContext:
        model = copy(self._model)
        model.vis.quality.offsamples = 0
        model.vis.global_.offwidth = model.vis.global_.offheight = 1  # the first picture gives it its size
        if not self._lit:
            model.vis.quality.shadowsize = 0
        try:
            return mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
        except Exception as error:
            raise RenderingError(NO_OPENGL.format(error=error)) from error

    def _kind_of(self) -> bytes:
        """A digest that is the same for all models that one drawing context can draw."""
        model = self._model
        planes = model.geom_type == _PLANE
        if not self._lit:
            planes &= drawn(model.geom_group)
        materials = model.geom_matid[planes]
        arrays = (
            *(getattr(model, name) for name in _ASSETS),
            *(model.geom_size[planes], materials, model.mat_texrepeat[materials[materials >= 0]]),
        )
        digest = blake2b(bytes([self._lit]), digest_size=16)
        for array in arrays:
            digest.update(f"{array.shape}".encode())
            digest.update(array.tobytes())
        return digest.digest()
