"""The few functions of OpenGL and EGL that we call ourselves.

OpenGL's are PyOpenGL's raw ones, checked for errors like all: its module `OpenGL.GL` takes 85 ms and 6 MB to import,
and its functions take twice as long.

EGL's say whose context is current. Others draw in the same process, such as dm_control's `physics.render` and
`mujoco.Renderer`, and rely on theirs staying current. So after our drawing theirs is again; where none was, ours
stays, for switching takes 5 % of a step.
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
    """As OpenGL names them, without its prefix, and the error that they raise."""

    read_pixels: Callable[[int, int, int, int, int, int, ctypes.c_void_p], None]
    framebuffer_renderbuffer: Callable[[int, int, int, int], None]
    error: type[Exception]


@cache
def functions() -> Functions:
    """Of the platform that PyOpenGL settles on when it is first imported: only once an OpenGL context exists."""
    from OpenGL.error import GLError
    from OpenGL.raw.GL.VERSION import GL_1_0, GL_3_0

    return Functions(GL_1_0.glReadPixels, GL_3_0.glFramebufferRenderbuffer, GLError)


def is_current(handles: Handles | None) -> bool:
    """Whether this is current, at little cost."""
    egl = _egl()
    return egl is not None and handles is not None and egl.eglGetCurrentContext() == handles[-1]


def current() -> Handles | None:
    """What is current on this thread; None if nothing is, or if EGL is not what we draw with."""
    egl = _egl()
    if egl is None or not (context := egl.eglGetCurrentContext()):
        return None
    surfaces = egl.eglGetCurrentSurface(DRAW_SURFACE), egl.eglGetCurrentSurface(READ_SURFACE)
    return egl.eglGetCurrentDisplay(), *surfaces, context


def make_current(handles: Handles) -> None:
    """Make current what was current once."""
    if (egl := _egl()) is not None:
        egl.eglMakeCurrent(*handles)


@cache
def _egl() -> ctypes.CDLL | None:
    """EGL without PyOpenGL's checks, which take several times as long as the switch."""
    if wanted_backend() != "egl":
        return None
    egl = ctypes.CDLL("libEGL.so.1")
    for getter in (egl.eglGetCurrentDisplay, egl.eglGetCurrentSurface, egl.eglGetCurrentContext):
        getter.restype = ctypes.c_void_p
    egl.eglMakeCurrent.argtypes = [ctypes.c_void_p] * 4
    return egl
