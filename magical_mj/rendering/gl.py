"""The few OpenGL functions that we call ourselves.

They are PyOpenGL's raw ones, checked for errors like all: its module `OpenGL.GL` takes 85 ms and 6 MB to import, and
its functions take twice as long.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Final, NamedTuple

RGBA: Final = 0x1908
UNSIGNED_BYTE: Final = 0x1401
FRAMEBUFFER: Final = 0x8D40
RENDERBUFFER: Final = 0x8D41
DEPTH_STENCIL_ATTACHMENT: Final = 0x821A


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
