"""The canvas: one OpenGL context per thread, shared by all models, environments and views.

All models of this package have the same meshes, and their regions are skins, which are uploaded with each frame. So one
MuJoCo drawing context (`MjrContext`), which is expensive to make, can draw them all.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import sys
import threading
import weakref
from ctypes import c_void_p, py_object, pythonapi
from dataclasses import dataclass, field
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.style import DRAWN_GROUP, TASK_GROUP
from magical_mj.assets.world import world_mjcf
from magical_mj.rendering import gl
from magical_mj.rendering.backend import REMEDY, has_display
from magical_mj.scene import GoalRegion, Robot, Scene
from magical_mj.utils.errors import RenderingError

Picture = NDArray[np.uint8]
"""Shape (height, width, channels)."""

DRAWN_GROUPS: Final = (0, DRAWN_GROUP, TASK_GROUP)
"""Geom and skin groups that the cameras ego and allo see: MuJoCo's default (for users' additions) and ours."""

KEPT_SIZES: Final = 4  # pixel buffers
KEPT_SCENES: Final = 4  # of each drawing context
GEOMS: Final = 32  # the capacity of scenes is a multiple of this, so that few scenes are enough for all models
KEPT_CONTEXTS: Final = 8  # the shared one, those of other bodies and arenas, and of models that users changed
_LIBRARY: Final = Scene(Robot(0, 0, 0), regions=(GoalRegion("red", -0.4, -0.4, 0.4, 0.4),) * 3)
"""A scene whose model has all assets that models of the benchmark can have."""
NO_OPENGL: Final = f"No picture can be drawn, since OpenGL did not start: {{error}}. {REMEDY}"
FORKED: Final = (
    "This process was forked after its parent had drawn a picture, and OpenGL does not survive a fork. "
    "Start workers with the 'spawn' or 'forkserver' method."
)


_IS_DRAWN: Final = np.isin(np.arange(mujoco.mjNGROUP), DRAWN_GROUPS)
_PLANE, _MESH = mujoco.mjtGeom.mjGEOM_PLANE.value, mujoco.mjtGeom.mjGEOM_MESH.value
_ASSETS: Final = ("mesh_vertnum", "mesh_vert", "mesh_face", "tex_data")


def drawn(groups: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Which of these geom or skin groups the cameras ego and allo see."""
    return _IS_DRAWN.take(groups, mode="clip")  # MuJoCo clips groups likewise


@dataclass(eq=False)
class Context:
    """MuJoCo's drawing context, with the model whose meshes and skins it holds.

    A lit one has a depth buffer and shadows, and draws its own model only.
    """

    mjr: mujoco.MjrContext
    model: mujoco.MjModel
    lit: bool = False
    size: tuple[int, int] = (0, 0)  # of the offscreen buffer: (width, height), pixels
    scenes: dict[tuple[int, bytes], mujoco.MjvScene] = field(default_factory=dict)  # by geoms and skins

    def __post_init__(self) -> None:
        """Copies the assets with which the lists of other models must begin to be drawn here."""
        self.assets = {name: getattr(self.model, name).copy() for name in _ASSETS}

    def draws(self, model: mujoco.MjModel) -> bool:
        """Whether this model can be drawn here: it shows only meshes and skins that this context holds."""
        mine = self.model
        if self.lit:
            return model is mine
        if (
            model.nmesh < mine.nmesh
            or model.nskin > mine.nskin
            or model.nhfield
            or model.nflex
            or model.ntex != mine.ntex
        ):
            return False
        shown = drawn(model.geom_group)
        kinds, meshes = model.geom_type[shown], model.geom_dataid[shown]
        return (
            not (kinds == _PLANE).any()
            and meshes[kinds == _MESH].max(initial=-1) < mine.nmesh
            and all(
                getattr(model, name)[: len(array)].tobytes() == array.tobytes() for name, array in self.assets.items()
            )
            and model.skin_vertnum.tobytes() == mine.skin_vertnum[: model.nskin].tobytes()
            and model.skin_face.tobytes() == mine.skin_face[: model.nskinface].tobytes()
        )

    def scene_for(self, model: mujoco.MjModel) -> mujoco.MjvScene:
        """A scene (`MjvScene`) large enough for this model. It is shared: its content lasts until the next drawing.

        Models with the same skins share one, since making and freeing it takes 160 kB and 0.25 ms.
        """
        count = (model.ngeom if self.lit else int(drawn(model.geom_group).sum())) + model.nskin + 1
        key = -(-count // GEOMS) * GEOMS, model.skin_vertnum.tobytes()
        if key not in self.scenes:
            if len(self.scenes) >= KEPT_SCENES:
                self.scenes.clear()
            self.scenes[key] = mujoco.MjvScene(model, key[0])
            if not self.lit:
                self.scenes[key].flags[:] = 0  # no shadows, reflections, haze or sky
        return self.scenes[key]


@dataclass
class Canvas(threading.local):
    """The OpenGL context of this thread, which is made at the first frame."""

    opengl: mujoco.GLContext | None = None
    process: int = 0
    contexts: list[Context] = field(default_factory=list)
    active: Context | None = None
    first: bool = False  # within the block of the first frame
    ours: gl.Handles | None = None  # with EGL
    others: gl.Handles | None = None  # the context of other code that was current before
    pixels: dict[tuple[int, int], tuple[Picture, c_void_p]] = field(default_factory=dict)
    """A pixel buffer and its address for each of the last few sizes."""

    def __enter__(self) -> None:
        """Makes the OpenGL context current within a `with` block; the first time, it is created.

        First blocks come one after another: drivers have crashed when two threads drew their first frames at once.
        """
        if self.opengl is None:
            self._first_enter()
            return
        if self.process != os.getpid():
            raise RenderingError(FORKED)
        if gl.is_current(self.ours):
            self.others = None
            return
        self.others = gl.current()
        gl.release(self.others)
        if self.ours is None:
            self.opengl.make_current()
        else:
            gl.make_current(self.ours)

    def __exit__(self, *error: object) -> None:
        """Makes the context of other code current again that was before; with backends other than EGL, ours stays.

        If there was none, ours stays too, unless there may be windows: X11 ends a process that starts OpenGL for one
        while a context of EGL is current.
        """
        if self.others is not None:
            gl.make_current(self.others)
        elif has_display():
            gl.leave()
        if self.first:
            self.first = False
            _FIRST_FRAME.release()

    def _first_enter(self) -> None:
        _FIRST_FRAME.acquire()
        try:
            self.others = gl.current()
            gl.release(self.others)
            self._start()
        except BaseException:
            if self.others is not None:
                gl.make_current(self.others)
            _FIRST_FRAME.release()
            raise
        self.first = True

    def _start(self) -> None:
        library = mujoco.MjModel.from_xml_string(world_mjcf(_LIBRARY))
        try:
            made = gl.new_context()
            made.make_current()
            context = _drawing_context(library)
        except Exception as error:  # each backend has its own exceptions
            raise RenderingError(NO_OPENGL.format(error=" ".join(str(error).split()).rstrip("."))) from error
        self.opengl, self.process, self.contexts = made, os.getpid(), [Context(context, library)]
        self.ours = gl.current()
        _OPEN.add(made)
        atexit.unregister(_free_all)
        atexit.register(_free_all)  # now, so that it runs before the display is closed

    def context_for(self, model: mujoco.MjModel, *, lit: bool = False) -> Context:
        """The shared context if it can draw the model, as it can all models of this package; else a separate one."""
        for context in self.contexts:
            if context.lit == lit and context.draws(model):
                return context
        if len(self.contexts) >= KEPT_CONTEXTS:
            self.contexts.pop(1).mjr.free()  # renderers that used it will get a new one
        self.contexts.append(Context(_drawing_context(model, lit=lit), model, lit))
        return self.contexts[-1]

    def draw(self, context: Context, scene: mujoco.MjvScene, height: int, width: int) -> Picture:
        """Red, green, blue, alpha; bottom row first. The next call overwrites them. Shape (height, width, 4)."""
        if self.active is not context or context.size != (width, height):
            mujoco.mjr_resizeOffscreen(width, height, context.mjr)  # the whole buffer: clearing a part of it is slow
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context.mjr)
            if not context.lit:
                without_depth = gl.FRAMEBUFFER, gl.DEPTH_STENCIL_ATTACHMENT, gl.RENDERBUFFER, 0
                gl.functions().framebuffer_renderbuffer(*without_depth)
            self.active, context.size = context, (width, height)
        if (height, width) not in self.pixels:
            if len(self.pixels) >= KEPT_SIZES:
                self.pixels.clear()
            buffer = np.empty((height, width, 4), np.uint8)
            self.pixels[height, width] = buffer, buffer.ctypes.data_as(c_void_p)
        pixels, place = self.pixels[height, width]
        mujoco.mjr_render(mujoco.MjrRect(0, 0, width, height), scene, context.mjr)
        # mjr_readPixels is slower
        gl.functions().read_pixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, place)
        return pixels

    def restart(self) -> None:
        """Makes a new context, within a `with` block. Needed if other code deleted our OpenGL objects by mistake.

        That happens if it frees its own objects, which have the same numbers, while our context is current.
        """
        others = self.others
        self.close()
        self._start()
        self.others = others

    def close(self) -> None:
        """Free everything; may be called twice."""
        if self.opengl is not None and self.process == os.getpid():
            with self:
                for context in self.contexts:
                    context.mjr.free()
                self.opengl.free()
        self.opengl, self.ours, self.active, self.contexts = None, None, None, []
        self.pixels.clear()


CANVAS = Canvas()
_FIRST_FRAME = threading.RLock()
_OPEN: weakref.WeakSet[mujoco.GLContext] = weakref.WeakSet()  # of all threads


def _free_all() -> None:
    """At exit: frees the OpenGL contexts silently, in whatever order modules are torn down."""
    contexts = list(_OPEN)
    with contextlib.suppress(Exception):
        CANVAS.close()
    for context in contexts:
        with contextlib.suppress(Exception):
            context.free()
        context._context = None  # else its finaliser would try again and print an error


def _forget() -> None:
    """In the child of a fork: OpenGL objects belong to the parent, and freeing them here would hang."""
    global _FIRST_FRAME  # noqa: PLW0603 - another thread may have held it, which does not exist here
    _FIRST_FRAME = threading.RLock()
    for context in list(_OPEN):
        context._context = None
    for context in CANVAS.contexts:
        pythonapi.Py_IncRef(py_object(context.mjr))  # so that it is never freed
    if "OpenGL.EGL" in sys.modules:
        atexit.unregister(sys.modules["OpenGL.EGL"].eglTerminate)  # which mujoco registers


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_forget)


def _drawing_context(model: mujoco.MjModel, *, lit: bool = False) -> mujoco.MjrContext:
    """A drawing context without multisampling and, unless lit, without a shadow map (saves 30 ms and 100 MB)."""
    quality = model.vis.quality
    kept = quality.shadowsize, quality.offsamples
    quality.offsamples = 0
    if not lit:
        quality.shadowsize = 0
    try:
        return mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
    finally:
        quality.shadowsize, quality.offsamples = kept


def opengl_name() -> str:
    """OpenGL's renderer and version."""
    with CANVAS:
        return " / ".join(gl.functions().get_string(name).decode() for name in (gl.RENDERER, gl.VERSION))
