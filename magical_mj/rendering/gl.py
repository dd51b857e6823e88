"""OpenGL contexts, and the few functions of OpenGL, EGL and GLX that are called directly.

With EGL nothing of PyOpenGL is used, which mujoco's and dm_control's renderers have: it chooses one platform for the
whole process when it is imported, and with another one neither their windows nor our pictures could be drawn.

Other code in the same process, such as dm_control's viewer, its `physics.render` and `mujoco.Renderer`, relies on its
own context staying current. So after our drawing it is made current again. If there was none and no display, ours stays
current, since switching takes 5 % of a step.
"""

from __future__ import annotations

import ctypes
import importlib
import os
from collections.abc import Callable
from ctypes import c_int, c_uint, c_void_p
from functools import cache
from typing import Any, Final, NamedTuple

from magical_mj.rendering.backend import (
    PROBES,
    chosen_backend,
    egl_display,
    egl_library,
    load_triton,
    one_thread,
    problem_of,
)
from magical_mj.utils.errors import RenderingError

RGBA: Final = 0x1908
UNSIGNED_BYTE: Final = 0x1401
FRAMEBUFFER: Final = 0x8D40
RENDERBUFFER: Final = 0x8D41
DEPTH_STENCIL_ATTACHMENT: Final = 0x821A
RENDERER: Final = 0x1F01
VERSION: Final = 0x1F02
EGL_DRAW: Final = 0x3059
EGL_READ: Final = 0x305A
EGL_OPENGL_API: Final = 0x30A2
CONFIGURATION: Final = (0x3024, 8, 0x3023, 8, 0x3022, 8, 0x3021, 8, 0x3033, 1, 0x3040, 8, 0x3038)
"""Red, green, blue and alpha have 8 bits, pixel buffers exist, OpenGL draws; the end of EGL's list of attributes."""


class Handles(NamedTuple):
    """What is current in a thread: display, surfaces to draw to and to read from, and context, of EGL or of GLX."""

    display: int | None
    draw: int | None
    read: int | None
    context: int | None
    glx: ctypes.CDLL | None = None  # None for EGL


class Functions(NamedTuple):
    """OpenGL functions by their names without the prefix "gl", and the exception that they raise."""

    read_pixels: Callable[[int, int, int, int, int, int, ctypes.c_void_p], None]
    framebuffer_renderbuffer: Callable[[int, int, int, int], None]
    get_string: Callable[[int], bytes]
    error: type[Exception]


class EglContext:
    """An OpenGL context without a window, with the methods of mujoco's contexts."""

    def __init__(self, egl: ctypes.CDLL, display: int) -> None:
        configuration, count = c_void_p(), c_int()
        attributes = (c_int * len(CONFIGURATION))(*CONFIGURATION)
        found = egl.eglChooseConfig(display, attributes, ctypes.byref(configuration), 1, ctypes.byref(count))
        if not (found and count.value and egl.eglBindAPI(EGL_OPENGL_API)):
            raise RuntimeError("EGL has no OpenGL with 8 bits for each colour")
        self._egl, self._display, self._process = egl, display, os.getpid()
        self._context: int | None = egl.eglCreateContext(display, configuration, None, None)
        if not self._context:
            raise RuntimeError(f"EGL cannot make a context (error {egl.eglGetError():#x})")

    def make_current(self) -> None:
        """Makes it the context of this thread."""
        if not self._egl.eglMakeCurrent(self._display, None, None, self._context):
            raise RuntimeError(f"EGL cannot make its context current (error {self._egl.eglGetError():#x})")

    def free(self) -> None:
        """Frees it; may be called twice, and does nothing in the child of a fork."""
        if self._context and self._process == os.getpid():
            if self._egl.eglGetCurrentContext() == self._context:
                self._egl.eglMakeCurrent(self._display, None, None, None)
            self._egl.eglDestroyContext(self._display, self._context)
        self._context = None

    def __del__(self) -> None:
        """With the thread that it belongs to."""
        if getattr(self, "_context", None):
            self.free()


def new_context() -> Any:
    """A new OpenGL context for the chosen backend, whatever mujoco chose for itself when it was imported.

    Raises:
        RenderingError: if the backend cannot work; whatever the backend raises if it fails.
    """
    import mujoco

    load_triton()
    backend = chosen_backend()
    if problem := problem_of(backend):
        raise RenderingError(problem)
    if egl := _egl():
        return EglContext(egl, egl_display())
    with one_thread():
        module = importlib.import_module(f"mujoco.{backend}") if backend in PROBES else mujoco
        return module.GLContext(64, 64)


@cache
def functions() -> Functions:
    """The functions. An OpenGL context must exist before."""
    egl = _egl()
    if egl is None:
        from OpenGL.error import GLError  # the raw modules: `OpenGL.GL` would take 85 ms and 6 MB, and twice the time
        from OpenGL.raw.GL.VERSION import GL_1_0, GL_3_0

        return Functions(GL_1_0.glReadPixels, GL_3_0.glFramebufferRenderbuffer, GL_1_0.glGetString, GLError)
    read = ctypes.CFUNCTYPE(None, c_int, c_int, c_int, c_int, c_uint, c_uint, c_void_p)
    attach = ctypes.CFUNCTYPE(None, c_uint, c_uint, c_uint, c_uint)
    get_error = ctypes.CFUNCTYPE(c_uint)(egl.eglGetProcAddress(b"glGetError"))
    get_string = ctypes.CFUNCTYPE(ctypes.c_char_p, c_uint)(egl.eglGetProcAddress(b"glGetString"))
    read_pixels = read(egl.eglGetProcAddress(b"glReadPixels"))
    framebuffer_renderbuffer = attach(egl.eglGetProcAddress(b"glFramebufferRenderbuffer"))

    def checked(function: Callable[..., None]) -> Callable[..., None]:
        def call(*arguments: Any) -> None:
            function(*arguments)
            if error := get_error():
                raise OpenGLError(f"OpenGL reports error {error:#x}")

        return call

    return Functions(checked(read_pixels), checked(framebuffer_renderbuffer), get_string, OpenGLError)


class OpenGLError(Exception):
    """An error that OpenGL reports after a call."""


def is_current(handles: Handles | None) -> bool:
    """Whether the EGL context of `handles` is current (fast)."""
    egl = _egl()
    return egl is not None and handles is not None and egl.eglGetCurrentContext() == handles.context


def current() -> Handles | None:
    """The current context of this thread; None if there is none, or if our backend is not EGL."""
    egl = _egl()
    if egl is None:
        return None
    if context := egl.eglGetCurrentContext():
        surfaces = egl.eglGetCurrentSurface(EGL_DRAW), egl.eglGetCurrentSurface(EGL_READ)
        return Handles(egl.eglGetCurrentDisplay(), *surfaces, context)
    glx = _glx()
    if glx is None or not (context := glx.glXGetCurrentContext()):
        return None
    surfaces = glx.glXGetCurrentDrawable(), glx.glXGetCurrentReadDrawable()
    return Handles(glx.glXGetCurrentDisplay(), *surfaces, context, glx)


def release(handles: Handles | None) -> None:
    """Releases a context of GLX, beside which EGL's cannot become current; for contexts of EGL nothing is needed."""
    if handles is not None and handles.glx is not None:
        handles.glx.glXMakeContextCurrent(handles.display, None, None, None)


def make_current(handles: Handles) -> None:
    """Makes a context current that `current` returned earlier, in place of one of ours."""
    if (egl := _egl()) is None:
        return
    display, draw, read, context, glx = handles
    if glx is None:
        egl.eglMakeCurrent(display, draw, read, context)
    else:
        leave()
        glx.glXMakeContextCurrent(display, draw, read, context)


def leave() -> None:
    """Leaves this thread without a context of EGL."""
    if (egl := _egl()) is not None:
        egl.eglMakeCurrent(egl.eglGetCurrentDisplay(), None, None, None)


def _egl() -> ctypes.CDLL | None:
    """The EGL library; None if the backend of our pictures is another."""
    return egl_library() if backend_of_process() == "egl" else None


@cache
def backend_of_process() -> str:
    """The backend when the first picture is drawn, and from then on."""
    return chosen_backend()


def _glx() -> ctypes.CDLL | None:
    """The GLX library if other code has loaded it, such as GLFW or pygame with a window under X11."""
    try:
        glx = ctypes.CDLL("libGLX.so.0", mode=os.RTLD_NOLOAD | os.RTLD_NOW)
    except OSError:
        return None
    for name in ("Context", "Display", "Drawable", "ReadDrawable"):
        getattr(glx, f"glXGetCurrent{name}").restype = ctypes.c_void_p
    glx.glXMakeContextCurrent.argtypes = [ctypes.c_void_p] * 4
    return glx
