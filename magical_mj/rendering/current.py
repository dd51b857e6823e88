"""Whose OpenGL context is current.

Others draw in the same process, such as dm_control's `physics.render` and `mujoco.Renderer`, and rely on theirs staying
current. So after our drawing theirs is again; where none was, ours stays, for switching takes 5 % of a step.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Final

from magical_mj.rendering.backend import wanted_backend

DRAW_SURFACE: Final = 0x3059  # EGL_DRAW
READ_SURFACE: Final = 0x305A  # EGL_READ

Handles = tuple[int | None, int | None, int | None, int | None]
"""EGL's display, surfaces to draw to and to read from, and context."""


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
