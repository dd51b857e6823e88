"""The canvases of this process, and in which threads they draw, so that other code finds OpenGL as it left it.

Other code may rely on its context staying current, as windows and dm_control do, and may free its objects in whatever
context is current. So a canvas is current only while it draws, which costs 10 us a picture.

- Without a display and MUJOCO_GL, mujoco and dm_control can make no contexts, and draw into the one that is current. So
  there the main thread's canvas stays current if nothing was before, and they work beside our pictures.
- Beside a window of GLX, such as those of GLFW and pygame under X11, a context of EGL cannot be current, and backends
  other than EGL cannot say what is current: there a thread of our own draws.
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

from magical_mj.rendering.backend import NO_OPENGL, opengl, wanted_backend
from magical_mj.rendering.canvas import Canvas
from magical_mj.rendering.contexts import BlockedError, has_display
from magical_mj.utils.errors import RenderingError

T = TypeVar("T")
FORKED: Final = (
    "This process was forked after its parent had drawn a picture, and OpenGL does not survive a fork. "
    "Start workers with the 'spawn' or 'forkserver' method."
)


class Canvases:
    """The canvases that draw nothing at present. There are as many as threads draw at once."""

    def __init__(self) -> None:
        self._idle: list[Canvas] = []
        self._first = threading.Lock()
        self._process = 0
        self._shares_threads = False
        self._stays = False
        self._main: Canvas | None = None  # of the main thread if it stays current

    def draw(self, job: Callable[[Canvas], T]) -> T:
        """What the job returns, which is called with a canvas while its context is current.

        Raises:
            RenderingError: if OpenGL does not work here, or this process was forked from one that has drawn.
        """
        if self._process != os.getpid():
            self._begin()
        if self._shares_threads:
            with suppress(BlockedError):
                return self._draw(job)
        return _painter().submit(self._draw, job).result()

    def _begin(self) -> None:
        with self._first:
            if self._process == os.getpid():  # since another thread was first
                return
            if self._process:
                raise RenderingError(FORKED)
            backend = opengl()
            if backend.context is None:
                raise RenderingError(NO_OPENGL.format(error=backend.problem))
            self._process, self._shares_threads = os.getpid(), backend.name == "egl"
            atexit.register(self.close)
            self._stays = self._shares_threads and not (wanted_backend() or has_display())

    def _draw(self, job: Callable[[Canvas], T]) -> T:
        if self._stays and threading.current_thread() is threading.main_thread():
            if self._main is None:
                with self._first:
                    self._main = self._new()
                    self._main.context.stays = True
                    return self._main.draw(job)
            return self._main.draw(job)
        try:
            canvas = self._idle.pop()
        except IndexError:
            with self._first:  # drivers have crashed when two threads drew their first frames at once
                return self._draw_with(self._new(), job)
        return self._draw_with(canvas, job)

    def _draw_with(self, canvas: Canvas, job: Callable[[Canvas], T]) -> T:
        try:
            return canvas.draw(job)
        finally:
            self._idle.append(canvas)

    def _new(self) -> Canvas:
        context: Any = opengl().context
        if not self._shares_threads:
            return Canvas(context())
        with ThreadPoolExecutor(1) as thread:  # mujoco's constructor leaves its thread without a context
            return Canvas(thread.submit(context).result())

    def close(self) -> None:
        """Frees the canvases; the next picture begins anew. May be called twice."""
        idle = [*self._idle, *filter(None, [self._main])]
        self._idle, self._main = [], None
        if self._process == os.getpid():
            with suppress(Exception):  # at exit other code may have closed the display
                for canvas in idle:
                    canvas.close()


CANVASES: Final = Canvases()


@cache
def _painter() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, "magical_mj OpenGL")


def opengl_name() -> str:
    """OpenGL's renderer and version."""
    return CANVASES.draw(Canvas.name)
