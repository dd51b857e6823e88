"""The OpenGL contexts of this process. Each is current only while it draws a picture.

Other code may rely on its own context staying current, and may free its objects in any context that is current. So
after each picture the previous context becomes current again, which takes 10 us. There are two exceptions, in which a
separate thread draws the pictures: a window's context can keep a context of EGL from becoming current in its thread,
and backends other than EGL cannot tell which context is current.

Drawing every picture in a separate thread needs less code, but on a busy machine it takes two to three times as long:
the processor changes to another process in between, and its caches are cold afterwards.
"""

from __future__ import annotations

import atexit
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache, partial
from typing import Any, Final, TypeVar

import mujoco
import numpy as np

from magical_mj.rendering.backend import NO_OPENGL, STARTING, new_context, opengl
from magical_mj.utils.errors import RenderingError

T = TypeVar("T")
PAINTER: Final = "magical_mj OpenGL"
"""The thread that draws where contexts cannot take turns."""
FORKED: Final = (
    "This process was forked after its parent had drawn a picture, and OpenGL does not survive a fork. "
    "Start workers with the 'spawn' or 'forkserver' method."
)


class Canvas:
    """An OpenGL context, with MuJoCo's drawing contexts for the last few kinds of models."""

    def __init__(self) -> None:
        self.context = new_context(opengl().name)
        self.drawings: dict[int, mujoco.MjrContext] = {}  # the last one used at the end
        self.pixels = np.empty((0, 0, 4), np.uint8)

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
        self._process = 0  # that has drawn

    def draw(self, job: Callable[[Canvas], T]) -> T:
        """Calls a function with a canvas while its context is current, and returns the result.

        Raises:
            RenderingError: if OpenGL does not work here, or this process was forked from one that has drawn.
        """
        if self._process not in (0, os.getpid()):
            raise RenderingError(FORKED)
        if problem := opengl().problem:
            raise RenderingError(NO_OPENGL.format(error=problem))
        if opengl().name != "egl":
            return _painter().submit(self._draw, job).result()
        return self._draw(job)

    def _draw(self, job: Callable[[Canvas], T]) -> T:
        try:
            canvas = self._idle.pop()
        except IndexError:
            with STARTING:
                self._process = os.getpid()
                return self._draw_with(Canvas(), job)
        return self._draw_with(canvas, job)

    def _draw_with(self, canvas: Canvas, job: Callable[[Canvas], T]) -> T:
        restore = _restorer() if opengl().name == "egl" else lambda: None
        try:
            canvas.context.make_current()
        except Exception:
            if threading.current_thread().name.startswith(PAINTER):
                raise
            self._idle.append(canvas)
            return _painter().submit(self._draw, job).result()
        try:
            return job(canvas)
        finally:
            restore()
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
    return ThreadPoolExecutor(1, PAINTER)


def _restorer() -> Callable[[], Any]:
    """A function that makes this thread's present context of EGL current again, or none if there is none."""
    from mujoco.egl import EGL, EGL_DISPLAY

    if not (context := EGL.eglGetCurrentContext()):
        return partial(EGL.eglMakeCurrent, EGL_DISPLAY, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT)
    surfaces = EGL.eglGetCurrentSurface(EGL.EGL_DRAW), EGL.eglGetCurrentSurface(EGL.EGL_READ)
    return partial(EGL.eglMakeCurrent, EGL.eglGetCurrentDisplay(), *surfaces, context)


def opengl_name() -> str:
    """OpenGL's renderer and version."""
    return CANVASES.draw(lambda _: _name_of_current())


def _name_of_current() -> str:
    from OpenGL.GL import GL_RENDERER, GL_VERSION, glGetString  # not before a context exists: it chooses the platform

    return " / ".join(glGetString(key).decode() for key in (GL_RENDERER, GL_VERSION))
