"""Pictures by MuJoCo and OpenGL: the flat views in exact colours, and the view "scene" in 3-D.

On software OpenGL every drawn pixel costs time. Flat pictures are cheap because of this:

- They are drawn at twice the size and averaged 2 x 2: cheaper than multisampling, and closer to the original.
- The floor, which is white, is not drawn: pixels without a geom (alpha 0) become white afterwards.
- Lights, shadows, reflections, haze and sky are off. So no shadow map is allocated, which saves 100 MB.
- The depth buffer is off, which saves a fifth of the time. Geoms are drawn in the model's order, static ones first.
  Their heights have the same order, so viewers with a depth buffer show the same picture.

OpenGL's contexts are current only while they draw a picture. Other code may rely on its own context staying current,
and may free its objects in any context that is current. So after each picture the previous context becomes current
again, which takes 10 us. In two cases, a separate thread draws instead: if a window's context keeps a context of EGL
from becoming current in its thread, and with backends other than EGL, which cannot tell which context is current.
Drawing every picture in a separate thread needs less code, but on a busy machine it takes two to three times as long:
the processor changes to another process in between, and its caches are cold afterwards.
"""

from __future__ import annotations

import atexit
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext, suppress
from copy import copy
from functools import cache, partial
from typing import Any, Final, TypeVar

import mujoco
import numpy as np

from magical_mj.rendering.backend import NO_OPENGL, STARTING, new_context, opengl
from magical_mj.rendering.picture import Picture, drawn
from magical_mj.utils.errors import RenderingError

T = TypeVar("T")
FORKED: Final = (
    "This process was forked after its parent had drawn a picture, and OpenGL does not survive a fork. "
    "Start workers with the 'spawn' or 'forkserver' method."
)
TRANSLUCENT: Final = (
    "the views ego and allo show opaque geoms only, and these are translucent: {names}. Give them an alpha of 1, or a "
    "group that these views do not show, such as group=4"
)
KEPT: Final = 8
"""The number of drawing contexts that a canvas keeps. Each takes 4 MB without shadows."""
_OFFSCREEN: Final = mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value
_STILL, _MOVING = mujoco.mjtCatBit.mjCAT_STATIC.value, mujoco.mjtCatBit.mjCAT_DYNAMIC.value
_ALL: Final = mujoco.mjtCatBit.mjCAT_ALL.value
_GEOM, _CAMERA = mujoco.mjtObj.mjOBJ_GEOM.value, mujoco.mjtObj.mjOBJ_CAMERA.value
_COPIED: Final = ("mesh_", "tex_", "hfield_", "flex_", "skin_vertnum", "skin_face", "skin_texcoord", "mat_texrepeat")
_ASSETS: Final = [name for name in dir(mujoco.MjModel) if name.startswith(_COPIED) and not name.endswith("adr")]
"""The arrays of a model that a drawing context copies. Addresses follow from the numbers of elements."""


class Canvas:
    """An OpenGL context, with MuJoCo's drawing contexts for the last few kinds of models.

    A drawing context (`MjrContext`) holds the meshes, textures and skins of a model, and draws all models with the same
    ones. Most models of this package differ only in the number of regions, so a canvas needs only a few.
    """

    def __init__(self) -> None:
        self.context = new_context(opengl().name)
        self.drawings: dict[int, mujoco.MjrContext] = {}  # the last one used at the end
        self.pixels = np.empty((0, 0, 4), np.uint8)  # of the last picture; the next one often has the same size

    def free(self) -> None:
        """Frees everything, and leaves this thread without a context."""
        self.context.make_current()
        for drawing in self.drawings.values():
            drawing.free()
        self.context.free()


class Canvases:
    """The canvases that are not in use. There are as many as threads have drawn at the same time."""

    def __init__(self) -> None:
        self._idle: list[Canvas] = []
        self._process = 0  # the process that has drawn

    def draw(self, job: Callable[[Canvas], T]) -> T:
        """Calls a function with a canvas while its context is current, and returns the result.

        Raises:
            RenderingError: if OpenGL does not work here, or this process was forked from one that has drawn.
        """
        if self._process not in (0, os.getpid()):
            raise RenderingError(FORKED)
        if problem := opengl().problem:
            raise RenderingError(NO_OPENGL.format(error=problem))
        try:
            canvas, first_use = self._idle.pop(), nullcontext()
        except IndexError:
            canvas, first_use = None, STARTING
        with first_use:
            if canvas is None:
                self._process, canvas = os.getpid(), Canvas()
            try:
                if opengl().name == "egl":
                    with suppress(_OccupiedError):
                        return _in_turn(canvas, job)
                return _painter().submit(_in_turn, canvas, job).result()
            finally:
                self._idle.append(canvas)

    def close(self) -> None:
        """Frees all contexts; the next picture makes new ones. Further calls do nothing."""
        if self._process == os.getpid():
            with suppress(Exception):  # at exit other code may have closed the display
                while self._idle:
                    self._idle.pop().free()


CANVASES: Final = Canvases()
atexit.register(CANVASES.close)


@cache
def _painter() -> ThreadPoolExecutor:
    """The thread that draws where contexts cannot take turns."""
    return ThreadPoolExecutor(1, "magical_mj OpenGL")


class _OccupiedError(RenderingError):
    """A canvas's context cannot become current in this thread."""


def _in_turn(canvas: Canvas, job: Callable[[Canvas], T]) -> T:
    """Calls a function while a canvas's context is current. Then the previous one, if any, becomes current again."""
    restore: Callable[[], Any] = lambda: None  # noqa: E731
    if opengl().name == "egl":
        from mujoco.egl import EGL, EGL_DISPLAY

        before = EGL_DISPLAY, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT
        if context := EGL.eglGetCurrentContext():
            surfaces = EGL.eglGetCurrentSurface(EGL.EGL_DRAW), EGL.eglGetCurrentSurface(EGL.EGL_READ)
            before = EGL.eglGetCurrentDisplay(), *surfaces, context
        restore = partial(EGL.eglMakeCurrent, *before)
    try:
        canvas.context.make_current()
    except Exception as error:
        raise _OccupiedError(NO_OPENGL.format(error=error)) from error
    try:
        return job(canvas)
    finally:
        restore()


def opengl_name() -> str:
    """OpenGL's renderer and version."""

    def name(_: Canvas) -> str:
        from OpenGL.GL import GL_RENDERER, GL_VERSION, glGetString  # it chooses the platform, from the current context

        return " / ".join(glGetString(key).decode() for key in (GL_RENDERER, GL_VERSION))

    return CANVASES.draw(name)


class OpenGLRenderer:
    """Draws one model. Cheap to make; OpenGL starts at the first picture.

    Args:
        model: the model.
        lit: whether it draws the view "scene", with everything that MuJoCo's viewers show at first, or flat views,
            with the geoms and skins that the cameras ego and allo see.
    """

    def __init__(self, model: mujoco.MjModel, *, lit: bool = False) -> None:
        self._model, self._lit, self._kind = model, lit, _kind(model, lit)
        self._option, self._perturbation, self._camera = mujoco.MjvOption(), mujoco.MjvPerturb(), mujoco.MjvCamera()
        room = 2 * (model.ngeom + model.nsite + model.nskin + model.nflex + model.nwrap + model.nsensor)
        self._scene = mujoco.MjvScene(model, room)
        if lit:
            mujoco.mjv_defaultFreeCamera(model, self._camera)
            return
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._option.geomgroup[:] = self._option.skingroup[:] = drawn(np.arange(mujoco.mjNGROUP))
        self._option.sitegroup[:] = self._option.tendongroup[:] = 0
        self._scene.flags[:] = 0

    def draw(
        self, data: mujoco.MjData, camera: str, size: int, out: Picture | None = None, uncovered: Picture | None = None
    ) -> Picture:
        """A picture from a camera of the model or of the view "scene", as `rendering.renderer.Views.draw`."""
        self._update(data, camera)
        picture = np.empty((size, size, 3), np.uint8) if out is None else out
        CANVASES.draw(partial(self._draw_on, picture, uncovered))
        return picture

    def _draw_on(self, picture: Picture, uncovered: Picture | None, canvas: Canvas) -> None:
        """Draws at a larger size on a canvas, and averages the pixels."""
        size = len(picture)
        pixels = self._pixels(canvas, 4 * size if self._lit else 2 * size)
        if self._lit:  # averaged twice, for smooth slanted edges
            pixels[..., 3][pixels[..., 3] > 0] = 255  # it is lower where geoms are translucent
            twice = np.empty((2 * size, 2 * size, 3), np.uint8)
            on_white(pixels, twice)
            picture[:] = (twice.reshape(size, 2, size, 2, 3).sum(axis=(1, 3), dtype=np.uint16) + 2) >> 2
            return
        on_white(pixels, picture)
        if uncovered is not None:
            empty = pixels[::-1, :, 3] == 0
            empty.reshape(size, 2, size, 2).sum(axis=(1, 3), dtype=np.uint8, out=uncovered)

    def _update(self, data: mujoco.MjData, name: str) -> None:
        """Writes what a camera sees into the scene."""
        model, scene, settings = self._model, self._scene, (self._option, self._perturbation)
        first = scene.ngeom == 0
        self._camera.fixedcamid = mujoco.mj_name2id(model, _CAMERA, name)  # which the view "scene" ignores
        if self._lit:  # the headlight is at the camera of the scene, which `mjv_updateScene` sets after the lights
            mujoco.mjv_updateCamera(model, data, self._camera, scene)
        mujoco.mjv_updateScene(model, data, *settings, self._camera, _ALL if self._lit else _STILL, scene)
        if self._lit:
            return
        mujoco.mjv_addGeoms(model, data, *settings, _MOVING, scene)
        scene.nlight, light = 1, scene.lights[0]
        light.ambient, light.diffuse, light.specular = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if first:
            geoms = [geom for geom in scene.geoms[: scene.ngeom] if geom.rgba[3] < 1 and geom.objtype == _GEOM]
            if names := ", ".join(model.geom(geom.objid).name or f"geom {geom.objid}" for geom in geoms):
                scene.ngeom = 0
                raise RenderingError(TRANSLUCENT.format(names=names))

    def _pixels(self, canvas: Canvas, side: int) -> Picture:
        """Draws, and reads red, green, blue and alpha, bottom row first. All are 0 where nothing was drawn."""
        from OpenGL.raw.GL.VERSION import GL_1_0, GL_3_0  # the whole `OpenGL.GL` takes 85 ms and 6 MB

        context = self._context(canvas)
        resized = context.offWidth != side
        if resized:  # the whole buffer, which is cleared for each picture
            mujoco.mjr_resizeOffscreen(side, side, context)
        mujoco.mjr_setBuffer(_OFFSCREEN, context)
        if resized and not self._lit:
            depth = GL_3_0.GL_DEPTH_STENCIL_ATTACHMENT, GL_3_0.GL_RENDERBUFFER, 0
            GL_3_0.glFramebufferRenderbuffer(GL_3_0.GL_FRAMEBUFFER, *depth)
        mujoco.mjr_render(mujoco.MjrRect(0, 0, side, side), self._scene, context)
        # MuJoCo's own mjr_readPixels has no alpha, and is slower.
        if len(canvas.pixels) != side:
            canvas.pixels = np.empty((side, side, 4), np.uint8)
        GL_1_0.glReadPixels(0, 0, side, side, GL_1_0.GL_RGBA, GL_1_0.GL_UNSIGNED_BYTE, canvas.pixels)
        return canvas.pixels

    def _context(self, canvas: Canvas) -> mujoco.MjrContext:
        """The canvas's drawing context for models of this kind."""
        context = canvas.drawings.pop(self._kind, None)
        if context is None:
            if len(canvas.drawings) == KEPT:
                canvas.drawings.pop(next(iter(canvas.drawings))).free()
            model = copy(self._model)
            model.vis.quality.offsamples = 0
            model.vis.global_.offwidth = model.vis.global_.offheight = 1  # the first picture gives it its size
            if not self._lit:
                model.vis.quality.shadowsize = 0
            try:
                context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
            except mujoco.FatalError as error:  # the driver lacks what MuJoCo needs
                raise RenderingError(NO_OPENGL.format(error=error)) from error
        canvas.drawings[self._kind] = context
        return context


def _kind(model: mujoco.MjModel, lit: bool) -> int:
    """A number that is the same for all models that one drawing context can draw."""
    planes = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE.value
    if not lit:
        planes &= drawn(model.geom_group)
    arrays = *(getattr(model, name) for name in _ASSETS), model.geom_size[planes], model.geom_matid[planes]
    return hash((lit, *(array.tobytes() for array in arrays)))


def on_white(pixels: Picture, out: Picture) -> None:
    """Finishes a picture: averages its pixels 2 x 2, on a white background, and turns it top row first.

    The four numbers of a pixel are added as one 64-bit word: each has 16 bits, which the sum of four cannot exceed.

    Args:
        pixels: red, green, blue (all 0 where nothing was drawn) and alpha (0 there, else 255), bottom row first.
            Shape (2 * height, 2 * width, 4).
        out: where to write it, shape (height, width, 3).
    """
    rows = np.add(pixels[::2], pixels[1::2], dtype=np.uint16).view(np.uint64)[..., 0]
    words = rows[:, ::2] + rows[:, 1::2]
    del rows  # freed together with the rest, it would go back to the system, which slows down large pictures
    levels = words.view(np.uint16).reshape(*words.shape, 4)
    levels += 2  # to round
    levels >>= 2
    words += (255 - (words >> 48)) * 0x0001_0001_0001  # white where alpha is 0; colour + 255 - alpha is at most 255
    for channel in range(3):  # three strided copies are faster than one of triples
        out[::-1, :, channel] = levels[..., channel]
