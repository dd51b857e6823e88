"""The canvas: one OpenGL context per process, shared by all models, environments and views.

Every model of ours has the same meshes, and its regions are skins, which travel with each frame. So MuJoCo's drawing
context, the expensive part, is made once and serves them all.
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
from magical_mj.errors import RenderingError
from magical_mj.rendering import gl
from magical_mj.rendering.backend import REMEDY, new_gl_context
from magical_mj.scene import GoalRegion, Robot, Scene

Picture = NDArray[np.uint8]
"""Shape (height, width, channels)."""

DRAWN_GROUPS: Final = (0, DRAWN_GROUP, TASK_GROUP)
"""Geom and skin groups that the task cameras see: MuJoCo's default, for what users add, and ours."""

KEPT_SIZES: Final = 4  # pixel buffers
KEPT_SCENES: Final = 4  # of each drawing context
GEOMS: Final = 32  # scenes have room for a multiple of so many, so that few of them serve all models
KEPT_CONTEXTS: Final = 4  # the library's, and those of models that users changed
_LIBRARY: Final = Scene(Robot(0, 0, 0), regions=(GoalRegion("red", -0.4, -0.4, 0.4, 0.4),) * 3)
"""A scene whose model has every asset that those of the benchmark have."""
NO_OPENGL: Final = f"No picture can be drawn: OpenGL did not start (MUJOCO_GL={{backend}}: {{error}}). {REMEDY}"
FORKED: Final = (
    "This process was forked after its parent had drawn a picture, and OpenGL does not survive a fork. "
    "Start workers with the 'spawn' or 'forkserver' method."
)


_IS_DRAWN: Final = np.isin(np.arange(mujoco.mjNGROUP), DRAWN_GROUPS)
_PLANE, _MESH = mujoco.mjtGeom.mjGEOM_PLANE.value, mujoco.mjtGeom.mjGEOM_MESH.value
_ASSETS: Final = ("mesh_vertnum", "mesh_vert", "mesh_face", "tex_data")


def drawn(groups: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Which of these geom or skin groups the task cameras see."""
    return _IS_DRAWN.take(groups, mode="clip")  # MuJoCo, too, clips groups


@dataclass(eq=False)
class Context:
    """MuJoCo's drawing context, with the model whose meshes and skins it holds.

    One with lights has a depth buffer and shadows, and serves its own model only.
    """

    mjr: mujoco.MjrContext
    model: mujoco.MjModel
    lit: bool = False
    size: tuple[int, int] = (0, 0)  # of the offscreen buffer: (width, height), pixels
    scenes: dict[tuple[int, bytes], mujoco.MjvScene] = field(default_factory=dict)  # by geoms and skins

    def __post_init__(self) -> None:
        """Keeps what models that are drawn here must begin with."""
        self.assets = {name: getattr(self.model, name).copy() for name in _ASSETS}

    def draws(self, model: mujoco.MjModel) -> bool:
        """Whether a scene of this model can be drawn here: it shows nothing but the library's meshes and skins."""
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
        """A scene with room for all that is drawn of this model; whoever draws next may fill it with another's.

        One serves all models of the same skins: it takes 160 KB, and a quarter of a millisecond to make and to free.
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
    """The OpenGL context of this thread, made at its first frame."""

    opengl: mujoco.GLContext | None = None
    process: int = 0
    contexts: list[Context] = field(default_factory=list)
    active: Context | None = None
    ours: gl.Handles | None = None  # with EGL
    others: gl.Handles | None = None  # what of others was current before
    pixels: dict[tuple[int, int], tuple[Picture, c_void_p]] = field(default_factory=dict)
    """A buffer for each of the last few sizes, and where it lies."""

    def __enter__(self) -> None:
        """Make the OpenGL context current for a block; it is started if need be."""
        if self.opengl is not None and self.process != os.getpid():
            raise RenderingError(FORKED)
        if gl.is_current(self.ours):
            self.others = None
            return
        self.others = gl.current()
        if self.opengl is None:
            self._start()
            self.ours = gl.current()
        elif self.ours is None:
            self.opengl.make_current()
        else:
            gl.make_current(self.ours)

    def __exit__(self, *error: object) -> None:
        """Make current whatever of others was before; with other backends than EGL, ours stays."""
        if self.others is not None:
            gl.make_current(self.others)

    def _start(self) -> None:
        os.environ.setdefault("LP_NUM_THREADS", "0")
        library = mujoco.MjModel.from_xml_string(world_mjcf(_LIBRARY))
        try:
            made = new_gl_context()
            made.make_current()
            context = _drawing_context(library)
        except Exception as error:  # each backend has its own kinds
            raise RenderingError(NO_OPENGL.format(backend=os.environ.get("MUJOCO_GL", "unset"), error=error)) from error
        self.opengl, self.process, self.contexts = made, os.getpid(), [Context(context, library)]
        _OPEN.add(made)
        atexit.unregister(_free_all)
        atexit.register(_free_all)  # now, so that it runs before the display is closed

    def context_for(self, model: mujoco.MjModel, *, lit: bool = False) -> Context:
        """The shared context where the model has the library's assets, as all of ours have; else one of its own."""
        for context in self.contexts:
            if context.lit == lit and context.draws(model):
                return context
        if len(self.contexts) >= KEPT_CONTEXTS:
            self.contexts.pop(1).mjr.free()  # whoever used it gets another
        self.contexts.append(Context(_drawing_context(model, lit=lit), model, lit))
        return self.contexts[-1]

    def draw(self, context: Context, scene: mujoco.MjvScene, height: int, width: int) -> Picture:
        """Red, green, blue and alpha, bottom row first; overwritten by the next. Shape (height, width, 4)."""
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
        """Begin afresh, in a block: somebody freed in our context what they had in theirs, under the same numbers."""
        others = self.others
        self.close()
        self._start()
        self.ours, self.others = gl.current(), others

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
_OPEN: weakref.WeakSet[mujoco.GLContext] = weakref.WeakSet()  # of all threads


def _free_all() -> None:
    """At exit: free the OpenGL contexts without a word, whatever else was taken down before."""
    contexts = list(_OPEN)
    with contextlib.suppress(Exception):
        CANVAS.close()
    for context in contexts:
        with contextlib.suppress(Exception):
            context.free()
        context._context = None  # or its finaliser would try again, and complain


def _forget() -> None:
    """In the child of a fork: OpenGL's things are the parent's, and trying to free them would wait for ever."""
    for context in list(_OPEN):
        context._context = None
    for context in CANVAS.contexts:
        pythonapi.Py_IncRef(py_object(context.mjr))  # so that it is never freed
    if "OpenGL.EGL" in sys.modules:
        atexit.unregister(sys.modules["OpenGL.EGL"].eglTerminate)  # which mujoco registers


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_forget)


def _drawing_context(model: mujoco.MjModel, *, lit: bool = False) -> mujoco.MjrContext:
    """A drawing context without multisampling, and unless lit without shadow map (30 ms and 100 MB less)."""
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
    """Who draws: OpenGL's renderer and version."""
    with CANVAS:
        from OpenGL import GL

        return " / ".join(GL.glGetString(name).decode() for name in (GL.GL_RENDERER, GL.GL_VERSION))
