"""OpenGL contexts without a window: mujoco's classes, made fit for small pictures and for a quiet end."""

from __future__ import annotations

import atexit
import contextlib
import importlib
import os
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from magical_mj.utils.errors import RenderingError

HEADLESS: Final = ("egl", "osmesa")
"""The backends that need no display, in the order in which they are tried."""
VARIABLES: Final = ("LP_NUM_THREADS", "PYOPENGL_PLATFORM")
SIDE: Final = 64
"""Of a context's own picture, in pixels. We draw into buffers of other sizes."""


def has_display() -> bool:
    """Whether a window could be opened, as far as the environment says."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


class BlockedError(RenderingError):
    """The context of a window keeps ours from being current in this thread."""


def context_class(backend: str) -> type[Any]:
    """The class of a backend's contexts; whatever its module raises if the backend is missing.

    Objects are made without arguments. `begin` makes one current, and `end` takes what that returned, and makes current
    what was before, or nothing; an object that `stays` is left current if there was nothing. Freeing one never fails,
    since other code may have closed the display before.
    """
    with _same_environment():
        base: Any = importlib.import_module(f"mujoco.{backend}" if backend in HEADLESS else "mujoco").GLContext

    class Context(base):
        def __init__(self) -> None:
            with _same_environment():
                super().__init__(SIDE, SIDE)

        def begin(self) -> Any:
            self.make_current()

        def end(self, before: Any) -> None:
            """What is current before cannot be known: these contexts are for a thread of their own."""

        def free(self) -> None:
            with contextlib.suppress(Exception):
                super().free()

    return _egl(Context) if backend == "egl" else Context


def _egl(base: Any) -> type[Any]:
    from mujoco import egl
    from OpenGL import EGL
    from OpenGL.raw.GL.VERSION import GL_1_0, GL_3_0

    def nothing() -> tuple[Any, ...]:
        return egl.EGL_DISPLAY, EGL.EGL_NO_SURFACE, EGL.EGL_NO_SURFACE, EGL.EGL_NO_CONTEXT

    class EglContext(base):
        def __init__(self) -> None:
            super().__init__()
            self.stays, self._address, self._buffer = False, 0, np.zeros(1, np.int32)
            # mujoco ends EGL at exit: before dm_control frees its contexts, and for ever in the child of a fork.
            atexit.unregister(EGL.eglTerminate)

        def begin(self) -> Any:
            context = EGL.eglGetCurrentContext()
            if context and not (self.stays and context.address == self._address):
                surfaces = EGL.eglGetCurrentSurface(EGL.EGL_DRAW), EGL.eglGetCurrentSurface(EGL.EGL_READ)
                before = EGL.eglGetCurrentDisplay(), *surfaces, context
                self._make_current()
                return before
            if not context:
                self._make_current()
                if not self.stays:
                    return nothing()
                self._address = EGL.eglGetCurrentContext().address
            GL_1_0.glGetIntegerv(GL_3_0.GL_FRAMEBUFFER_BINDING, self._buffer)  # of mujoco's own renderer, if any
            return None

        def _make_current(self) -> None:
            try:
                self.make_current()
            except Exception as error:
                raise BlockedError(f"OpenGL's context cannot become current: {error}") from error

        def end(self, before: Any) -> None:
            if before is not None:
                EGL.eglMakeCurrent(*before)
            else:
                GL_3_0.glBindFramebuffer(GL_3_0.GL_FRAMEBUFFER, int(self._buffer[0]))

    return EglContext


@contextlib.contextmanager
def _same_environment() -> Iterator[None]:
    """Mesa's software OpenGL, if it starts within the block, works without threads: faster for small pictures.

    Afterwards the environment is as before, since processes that we start may choose otherwise.
    """
    before = {name: os.environ.get(name) for name in VARIABLES}
    os.environ.setdefault("LP_NUM_THREADS", "0")
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
