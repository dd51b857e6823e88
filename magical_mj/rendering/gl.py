"""The few functions of OpenGL and EGL that are called directly.

OpenGL functions come from PyOpenGL's raw modules, with the usual error checks: importing `OpenGL.GL` would take 85 ms
and 6 MB, and its functions take twice as long.

EGL functions read and set the current context. Other code in the same process, such as dm_control's `physics.render`
and `mujoco.Renderer`, relies on its own context staying current. So after our drawing it is made current again. If
there was none, ours stays current, since switching takes 5 % of a step.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Final, NamedTuple

from magical_mj.rendering.backend import wanted_backend

RGBA: Final = 0x1908
UNSIGNED_BYTE: Final = 0x1401
FRAMEBUFFER: Final = 0x8D40
RENDERBUFFER: Final = 0x8D41
DEPTH_STENCIL_ATTACHMENT: Final = 0x821A
DRAW_SURFACE: Final = 0x3059  # EGL_DRAW
READ_SURFACE: Final = 0x305A  # EGL_READ

Handles = tuple[int | None, int | None, int | None, int | None]
"""EGL's display, surfaces to draw to and to read from, and context."""


class Functions(NamedTuple):
    """OpenGL functions by their names without the prefix "gl", and the exception that they raise."""

    read_pixels: Callable[[int, int, int, int, int, int, ctypes.c_void_p], None]
    framebuffer_renderbuffer: Callable[[int, int, int, int], None]
    error: type[Exception]


@cache
def functions() -> Functions:
    """The functions. An OpenGL context must exist before: PyOpenGL chooses its platform when it is imported."""
    from OpenGL.error import GLError
    from OpenGL.raw.GL.VERSION import GL_1_0, GL_3_0

    return Functions(GL_1_0.glReadPixels, GL_3_0.glFramebufferRenderbuffer, GLError)


def is_current(handles: Handles | None) -> bool:
    """Whether the context of `handles` is current (fast)."""
    egl = _egl()
    return egl is not None and handles is not None and egl.eglGetCurrentContext() == handles[-1]


def current() -> Handles | None:
    """The current context of this thread; None if there is none, or if the backend is not EGL."""
    egl = _egl()
    if egl is None or not (context := egl.eglGetCurrentContext()):
        return None
    surfaces = egl.eglGetCurrentSurface(DRAW_SURFACE), egl.eglGetCurrentSurface(READ_SURFACE)
    return egl.eglGetCurrentDisplay(), *surfaces, context


def make_current(handles: Handles) -> None:
    """Makes a context current that `current` returned earlier."""
    if (egl := _egl()) is not None:
        egl.eglMakeCurrent(*handles)


@cache
def _egl() -> ctypes.CDLL | None:
    """The EGL library; calls through PyOpenGL would take several times as long. None if the backend is not EGL."""
    if wanted_backend() != "egl":
        return None
    egl = ctypes.CDLL("libEGL.so.1")
    for getter in (egl.eglGetCurrentDisplay, egl.eglGetCurrentSurface, egl.eglGetCurrentContext):
        getter.restype = ctypes.c_void_p
    egl.eglMakeCurrent.argtypes = [ctypes.c_void_p] * 4
    return egl
