"""Whose OpenGL context is current: after our drawing, again whose it was before.

Others draw in the same process, such as dm_control's `physics.render` and `mujoco.Renderer`. They rely on theirs
staying current, and they free their things in whichever is, which had better not be ours.
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


def current() -> Handles | None:
    """What is current on this thread; None if nothing is, or if EGL is not what we draw with."""
    egl = _egl()
    if egl is None or not (context := egl.eglGetCurrentContext()):
        return None
    surfaces = egl.eglGetCurrentSurface(DRAW_SURFACE), egl.eglGetCurrentSurface(READ_SURFACE)
    return egl.eglGetCurrentDisplay(), *surfaces, context


def switch(old: Handles, new: Handles | None) -> None:
    """Make `new` current, or nothing, where `old` is."""
    if (egl := _egl()) is not None:
        egl.eglMakeCurrent(*(new or (old[0], None, None, None)))


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
