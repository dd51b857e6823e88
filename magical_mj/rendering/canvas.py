"""The OpenGL contexts of this process. Each is current only while it draws a picture.

Other code may rely on its own context staying current, and may free its objects in any context that is current. So
after each picture the previous context becomes current again, which takes 10 us. There are two exceptions, in which a
separate thread draws the pictures: a window's context can keep a context of EGL from becoming current in its thread,
and backends other than EGL cannot tell which context is current.
"""

from __future__ import annotations

import atexit
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from typing import Any, Final, TypeVar

import mujoco
import numpy as np

from magical_mj.rendering.backend import NO_OPENGL, has_display, new_context, opengl, wanted_backend
from magical_mj.utils.errors import RenderingError

T = TypeVar("T")
FORKED: Final = (
    "This process was forked after its parent had drawn a picture, and OpenGL does not survive a fork. "
    "Start workers with the 'spawn' or 'forkserver' method."
)


class BlockedError(Exception):
    """A window's context keeps a context of EGL from becoming current in this thread."""


class Canvas:
    """An OpenGL context, with MuJoCo's drawing contexts for the last few kinds of models."""

    def __init__(self) -> None:
        self._context = new_context()
        self.drawings: dict[bytes, mujoco.MjrContext] = {}  # the last one used at the end
        self.pixels = np.empty((0, 0, 4), np.uint8)

    def use(self, job: Callable[[Canvas], T], spare: tuple[Any, ...] | None) -> T:
        """Calls a function with this canvas while its context is current in this thread, and returns the result.

        Args:
            job: the function.
            spare: as for `_current`.

        Raises:
            BlockedError: if it cannot become current in this thread.
        """
        if opengl().name != "egl":
            self._context.make_current()
            return job(self)
        from OpenGL import EGL

        before = _current(spare)
        try:
            self._context.make_current()
        except Exception as error:
            raise BlockedError from error
        try:
            return job(self)
        finally:
            EGL.eglMakeCurrent(*before)

    def free(self) -> None:
        """Frees everything, and leaves this thread without a context."""
        self._context.make_current()
        for drawing in self.drawings.values():
            drawing.free()
        self._context.free()


def _current(spare: tuple[Any, ...] | None) -> tuple[Any, ...]:
    """EGL's current state in this thread: display, surfaces to draw into and to read from, context.

    Args:
        spare: the state with the spare context, if there is one. It is recognised by its context alone, to save time.
    """
    from mujoco import egl
    from OpenGL import EGL

    context = EGL.eglGetCurrentContext()
    if not context:
        return egl.EGL_DISPLAY, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT
    if spare and context.address == spare[-1].address:
        return spare
    surfaces = EGL.eglGetCurrentSurface(EGL.EGL_DRAW), EGL.eglGetCurrentSurface(EGL.EGL_READ)
    return EGL.eglGetCurrentDisplay(), *surfaces, context


class Canvases:
    """The canvases that are not in use. There are as many as threads have drawn at the same time."""

    def __init__(self) -> None:
        self._idle: list[Canvas] = []
        self._first = threading.Lock()
        self._process = 0
        self._main: Any = None
        self._spare: tuple[Any, ...] | None = None

    def draw(self, job: Callable[[Canvas], T]) -> T:
        """Calls a function with a canvas while its context is current, and returns the result.

        Raises:
            RenderingError: if OpenGL does not work here, or this process was forked from one that has drawn.
        """
        if self._process != os.getpid():
            if self._process:
                raise RenderingError(FORKED)
            with self._first:
                self._start()
        if opengl().name == "egl":
            with suppress(BlockedError):
                return self._draw(job)
        return _painter().submit(self._draw, job).result()

    def _start(self) -> None:
        if self._process:  # another thread was first
            return
        if opengl().problem:
            raise RenderingError(NO_OPENGL.format(error=opengl().problem))
        atexit.register(self.close)
        in_main = threading.current_thread() is threading.main_thread()
        if in_main and opengl().name == "egl" and not (wanted_backend() or has_display() or _current(None)[-1]):
            # mujoco and dm_control cannot make contexts here, and draw into the current one.
            self._main = new_context()
            self._main.make_current()
            self._spare = _current(None)
        self._process = os.getpid()

    def _draw(self, job: Callable[[Canvas], T]) -> T:
        try:
            canvas = self._idle.pop()
        except IndexError:
            with self._first:  # drivers have crashed when two threads drew their first frames at once
                return self._draw_with(Canvas(), job)
        return self._draw_with(canvas, job)

    def _draw_with(self, canvas: Canvas, job: Callable[[Canvas], T]) -> T:
        try:
            return canvas.use(job, self._spare)
        finally:
            self._idle.append(canvas)

    def close(self) -> None:
        """Frees all contexts; the next picture makes new ones. Further calls do nothing."""
        if self._process != os.getpid():
            return
        with suppress(Exception):  # at exit other code may have closed the display
            for canvas in self._idle:
                canvas.free()
            if self._main:
                self._main.free()
        self.__init__()


CANVASES: Final = Canvases()


@cache
def _painter() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, "magical_mj OpenGL")


def opengl_name() -> str:
    """OpenGL's renderer and version."""

    def name(_: Canvas) -> str:
        from OpenGL.GL import GL_RENDERER, GL_VERSION, glGetString

        return " / ".join(glGetString(key).decode() for key in (GL_RENDERER, GL_VERSION))

    return CANVASES.draw(name)
