"""The choice between OpenGL and the software renderer, and of OpenGL's backend.

The backend is chosen when it is first needed. mujoco and dm_control read MUJOCO_GL when they are imported. Here,
contexts come from mujoco's module for the chosen backend. So the order of imports does not matter, and no variable is
changed.
"""

from __future__ import annotations

import atexit
import importlib
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from typing import Any, Final, Literal, NamedTuple, cast, get_args

from magical_mj.rendering.libraries import load_triton, osmesa_works
from magical_mj.utils.errors import check_name

RendererName = Literal["opengl", "software"]
RENDERERS: Final[tuple[RendererName, ...]] = get_args(RendererName)
"""The renderers of the flat views: MuJoCo with OpenGL, or scanlines on the processor."""
VARIABLE: Final = "MAGICAL_MJ_RENDERER"
"""The environment variable with the renderer of the whole process."""

HEADLESS: Final = ("egl", "osmesa")
"""The backends that need no display. The first is tried first."""
SIDE: Final = 64
"""Side of a context's own picture, in pixels. Our pictures are drawn into other buffers."""
PACKAGES: Final = {"egl": "libegl1, libgl1-mesa-dri", "osmesa": "libosmesa6"}
REMEDY: Final = (
    f"Set the environment variable MUJOCO_GL, before Python starts, to egl (Debian and Ubuntu packages: "
    f"{PACKAGES['egl']}), osmesa (package: {PACKAGES['osmesa']}) or, with a display, glfw."
)
NO_OPENGL: Final = f"No picture can be drawn, since OpenGL did not start: {{error}}. {REMEDY}"
OFF: Final = ("off", "disable", "disabled", "false", "0")
KNOWN: Final = ("glfw", "on", "enable", "enabled", "true", "1", *OFF, *HEADLESS)
"""The values of MUJOCO_GL that mujoco and dm_control accept."""
_TRY_EGL: Final = "from mujoco.egl import GLContext; GLContext(1, 1).make_current()"


class Backend(NamedTuple):
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
def opengl() -> Backend:
    """The backend of our pictures: MUJOCO_GL's, or else, on Linux, EGL, OSMesa or GLFW, whichever starts first."""
    wanted = wanted_backend()
    if wanted or sys.platform != "linux":
        return _started(wanted)
    # PyOpenGL cannot change its platform. So if there is a choice, another process tries EGL.
    if osmesa_works() and subprocess.run([sys.executable, "-c", _TRY_EGL], capture_output=True, check=False).returncode:
        return _started("osmesa")
    egl = _started("egl")
    return _started("glfw") if egl.problem and has_display() else egl


def _started(name: str) -> Backend:
    """The backend of this name, after a test whether it can make a context."""
    load_triton()
    problem = _known_problem(name)
    try:
        if not problem:
            with ThreadPoolExecutor(1) as thread:  # `free` leaves its thread without a context
                thread.submit(lambda: new_context(name).free()).result()
            return Backend(name)
    except Exception as error:  # noqa: BLE001 - each backend has its own exceptions
        problem = " ".join(str(error).split()).rstrip(".")
    device = os.environ.get("MUJOCO_EGL_DEVICE_ID")
    source = f"MUJOCO_GL is {name}, which does not start" if wanted_backend() else name
    suffix = f" (MUJOCO_EGL_DEVICE_ID is {device!r})" if device is not None else ""
    return Backend(name, f"{source}: {problem}{suffix}")


def _known_problem(name: str) -> str:
    if name in OFF:
        return "it switches OpenGL off"
    if name and name not in KNOWN:
        return "mujoco does not know it"
    if name == "osmesa" and not osmesa_works():
        return "its library is missing"
    if sys.platform == "linux" and name not in HEADLESS and not has_display():
        return "GLFW needs a display"
    return "on macOS it draws in the main thread only" if sys.platform == "darwin" and name == "glfw" else ""


def new_context(name: str = "") -> Any:
    """A new OpenGL context of mujoco's. It is current in no thread, and this thread's current context stays so.

    If this starts Mesa's software OpenGL, it uses no threads, which is faster for small pictures. The variable for that
    is reset afterwards, so that other processes can use threads.

    Args:
        name: the backend; "" means the chosen one, see `opengl`.
    """
    name = name or opengl().name
    before = {variable: os.environ.get(variable) for variable in ("LP_NUM_THREADS", "PYOPENGL_PLATFORM")}
    os.environ.setdefault("LP_NUM_THREADS", "0")
    try:
        with ThreadPoolExecutor(1) as thread:  # mujoco's constructor leaves its thread without a context
            context = thread.submit(_context_class(name), SIDE, SIDE).result()
    finally:
        for variable, value in before.items():
            if value is None:
                os.environ.pop(variable, None)
            else:
                os.environ[variable] = value
    if name == "egl":
        from OpenGL import EGL

        # mujoco would terminate EGL at exit: before dm_control frees its contexts, and in a forked child it would hang.
        atexit.unregister(EGL.eglTerminate)
    return context


@cache
def _context_class(name: str) -> type[Any]:
    """MuJoCo's class of contexts. Freeing one never fails: at exit, other code may have closed EGL before."""
    module: Any = importlib.import_module(f"mujoco.{name}" if name in HEADLESS else "mujoco")

    class Context(module.GLContext):
        def free(self) -> None:
            with suppress(Exception):
                super().free()

    return Context
