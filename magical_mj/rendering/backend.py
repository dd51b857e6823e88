"""The choice between OpenGL and the software renderer, and of OpenGL's backend.

The backend is chosen at the first picture. mujoco and dm_control read MUJOCO_GL when they are imported. Here, contexts
come from mujoco's module for the chosen backend, so the order of imports does not matter.
"""

from __future__ import annotations

import atexit
import importlib
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from pathlib import Path
from threading import RLock
from typing import Any, Final, Literal, NamedTuple, cast, get_args

from magical_mj.utils.environment import environment_restored
from magical_mj.utils.errors import check_name

RendererName = Literal["opengl", "software"]
RENDERERS: Final[tuple[RendererName, ...]] = get_args(RendererName)
"""The renderers of the flat views: MuJoCo with OpenGL, or scanlines on the processor."""
VARIABLE: Final = "MAGICAL_MJ_RENDERER"
"""The environment variable with the renderer of the whole process."""

HEADLESS: Final = ("egl", "osmesa")
"""The backends that need no display."""
PACKAGES: Final = {"egl": "libegl1, libgl1-mesa-dri", "osmesa": "libosmesa6"}
REMEDY: Final = (
    f"Set the environment variable MUJOCO_GL, before Python starts, to egl (Debian and Ubuntu packages: "
    f"{PACKAGES['egl']}), osmesa (package: {PACKAGES['osmesa']}) or, with a display, glfw."
)
NO_OPENGL: Final = f"No picture can be drawn, since OpenGL did not start: {{error}}. {REMEDY}"
STARTING: Final = RLock()
"""Held while OpenGL starts: drivers have crashed when two threads drew their first frames at once."""


class OpenGL(NamedTuple):
    """An OpenGL backend: its name ("" for mujoco's default outside Linux), and why it does not work, or ""."""

    name: str
    problem: str = ""


def check_renderer(name: str | None) -> RendererName | None:
    """The name of a renderer. If it is None, the value of MAGICAL_MJ_RENDERER, or None if that is not set.

    Raises:
        UnknownNameError: if the renderer is unknown.
    """
    name = os.environ.get(VARIABLE) or None if name is None else name
    if name is not None:
        check_name("renderer", name, RENDERERS)
    return cast("RendererName | None", name)


def drawn_by(renderer: str | None = None) -> str:
    """The renderer of flat views, as results record it: "software", or OpenGL's backend, such as "egl".

    Args:
        renderer: as `rendering.renderer.Views` takes it.
    """
    renderer = check_renderer(renderer)
    software = renderer == "software" or (renderer is None and opengl().problem)
    return "software" if software else opengl().name


def wanted_backend() -> str:
    """The value of MUJOCO_GL; empty if it is not set."""
    return os.environ.get("MUJOCO_GL", "").strip().lower()


def has_display() -> bool:
    """Whether the environment variables name a display."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@cache
def opengl() -> OpenGL:
    """The backend of our pictures: the one that MUJOCO_GL names, by default mujoco's choice for the system.

    The default on Linux is EGL, or GLFW if EGL does not start because other code has loaded PyOpenGL for windows.
    """
    wanted = wanted_backend()
    if wanted or sys.platform != "linux":
        return _tried(wanted)
    egl = _tried("egl")
    return _tried("glfw") if egl.problem and has_display() else egl


def _tried(name: str) -> OpenGL:
    try:
        with STARTING, ThreadPoolExecutor(1) as thread:
            thread.submit(_start, name).result()
        return OpenGL(name)
    except Exception as error:  # noqa: BLE001 - each backend has its own exceptions
        variables = [variable for variable in ("MUJOCO_GL", "MUJOCO_EGL_DEVICE_ID") if variable in os.environ]
        cause = ", ".join([name, *(f"{variable} is {os.environ[variable]!r}" for variable in variables)])
        return OpenGL(name, f"{cause}: {' '.join(str(error).split()).rstrip('.')}")


def _start(name: str) -> None:
    """Loads the driver of a backend, and makes and frees a context, which leaves this thread without a context."""
    load_triton()
    if name not in HEADLESS and sys.platform == "linux" and not has_display():
        raise RuntimeError("GLFW needs a display")
    if name == "glfw" and sys.platform == "darwin":
        raise RuntimeError("on macOS it draws in the main thread only")
    with environment_restored("LP_NUM_THREADS", "PYOPENGL_PLATFORM"):
        os.environ.setdefault("LP_NUM_THREADS", "0")  # Mesa's software OpenGL draws small pictures faster so
        new_context(name).free()
    if name == "egl":
        from OpenGL import EGL

        # mujoco would terminate EGL at exit: before dm_control frees its contexts, and in a forked child it would hang.
        atexit.unregister(EGL.eglTerminate)


def new_context(name: str) -> Any:
    """A new OpenGL context of mujoco's. It does not become current, in this thread or another."""
    module: Any = importlib.import_module(f"mujoco.{name}" if name in HEADLESS else "mujoco")

    class Context(module.GLContext):
        def free(self) -> None:
            with suppress(Exception):  # at exit, other code may have closed EGL before
                super().free()

    with ThreadPoolExecutor(1) as thread:  # mujoco's constructor leaves its thread without a context
        return thread.submit(lambda: Context(64, 64)).result()  # our pictures are drawn into other buffers


@cache
def load_triton() -> None:
    """Imports Triton, if it is installed, before an OpenGL driver is loaded. It takes 0.15 s.

    PyTorch's CUDA builds include Triton, and their optimisers import it. It contains LLVM, as Mesa's drivers do. If
    Mesa's LLVM is loaded first, Triton calls functions of that one, and the process crashes. If other code, such as
    mujoco's renderer, has already loaded a driver, this does nothing.
    """
    with suppress(Exception):  # no Triton, a broken one, or a system without /proc
        if "libLLVM" not in Path("/proc/self/maps").read_text():
            importlib.import_module("triton")
