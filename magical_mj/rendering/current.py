"""Whose OpenGL context is current: after our drawing, again whose it was before.

Others draw in the same process, such as dm_control's `physics.render` and `mujoco.Renderer`. They rely on theirs
staying current, and they free their things in whichever is, which had better not be ours.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Final

from magical_mj.rendering.backend import wanted_backend

DRAW_SURFACE: Final = 0x3059  # EGL_DRAW
READ_SURFACE: Final = 0x305A  # EGL_READ


@contextmanager
def borrowed_thread() -> Iterator[None]:
    """A block that may make its own context current. With other backends than EGL, it stays current."""
    if wanted_backend() != "egl":
        yield
        return
    egl = _egl()
    context, display = egl.eglGetCurrentContext(), egl.eglGetCurrentDisplay()
    surfaces = egl.eglGetCurrentSurface(DRAW_SURFACE), egl.eglGetCurrentSurface(READ_SURFACE)
    try:
        yield
    finally:
        display = display or egl.eglGetCurrentDisplay()  # none, if nothing was current before
        if display:
            egl.eglMakeCurrent(display, *surfaces, context)


@cache
def _egl() -> ctypes.CDLL:
    """EGL without PyOpenGL's checks, which take several times as long as the switch."""
    egl = ctypes.CDLL("libEGL.so.1")
    for getter in (egl.eglGetCurrentDisplay, egl.eglGetCurrentSurface, egl.eglGetCurrentContext):
        getter.restype = ctypes.c_void_p
    egl.eglMakeCurrent.argtypes = [ctypes.c_void_p] * 4
    return egl
