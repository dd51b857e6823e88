"""The choice of a renderer, and of the OpenGL backend of our pictures, which is made when it is first asked for.

mujoco and dm_control look at MUJOCO_GL when they are imported. Our contexts are made from mujoco's modules for single
backends, so that does not matter here, and nothing is written to the environment.
"""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, Final, Literal, NamedTuple, cast, get_args

from magical_mj.rendering.contexts import HEADLESS, context_class, has_display
from magical_mj.rendering.libraries import load_triton, osmesa_works
from magical_mj.utils.errors import RenderingError, check_name

RendererName = Literal["opengl", "software"]
RENDERERS: Final[tuple[RendererName, ...]] = get_args(RendererName)
"""What draws the flat views: MuJoCo with OpenGL, or scanlines on the processor."""
VARIABLE: Final = "MAGICAL_MJ_RENDERER"
"""The environment variable that chooses between them for a whole process."""

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
_GLFW_CHOSEN: Final = (
    "dm_control was imported first, without a display and without MUJOCO_GL, so it has chosen GLFW: physics.render "
    "and dm_control's viewer find no OpenGL context of their own. Set MUJOCO_GL to {backend} before Python starts, "
    "or use magical_mj.load before dm_control is imported. Observations and env.render work"
)


class Backend(NamedTuple):
    """An OpenGL backend: its name ("" for mujoco's default outside Linux), its contexts' class, or why it fails."""

    name: str
    context: type[Any] | None = None
    problem: str = ""


def check_renderer(name: str | None) -> RendererName | None:
    """The name of a renderer; None stands for MAGICAL_MJ_RENDERER, and if that is not set, stays None.

    Raises:
        UnknownNameError: if there is no such renderer.
    """
    name = os.environ.get(VARIABLE) or None if name is None else name
    if name is not None:
        check_name("renderer", name, RENDERERS)
    return cast("RendererName | None", name)


def drawn_by(renderer: str | None = None) -> str:
    """What draws flat views, as results record it: "software", or OpenGL's backend, such as "egl".

    Args:
        renderer: as `rendering.renderer.Views` takes it.
    """
    renderer = check_renderer(renderer)
    software = renderer == "software" or (renderer is None and opengl().problem)
    return "software" if software else opengl().name


def wanted_backend() -> str:
    """The value of MUJOCO_GL; empty if it is not set."""
    return os.environ.get("MUJOCO_GL", "").strip().lower()


@cache
def opengl() -> Backend:
    """The backend of our pictures: MUJOCO_GL's, or else, on Linux, EGL, OSMesa or GLFW, whichever starts first."""
    wanted = wanted_backend()
    if wanted or sys.platform != "linux":
        return _started(wanted)
    # PyOpenGL works with one platform only. So if there is a choice, another process tries EGL.
    if osmesa_works() and subprocess.run([sys.executable, "-c", _TRY_EGL], capture_output=True, check=False).returncode:
        return _started("osmesa")
    egl = _started("egl")
    return _started("glfw") if egl.problem and has_display() else egl


def _started(name: str) -> Backend:
    """The backend of this name after it has made a context, or its problem."""
    load_triton()
    problem = _known_problem(name)
    try:
        if not problem:
            context = context_class(name)
            with ThreadPoolExecutor(1) as thread:  # so that what is current in this one stays so
                thread.submit(lambda: context().free()).result()
            return Backend(name, context)
    except Exception as error:  # noqa: BLE001 - each backend has its own exceptions
        problem = " ".join(str(error).split()).rstrip(".")
    device = os.environ.get("MUJOCO_EGL_DEVICE_ID")
    source = f"MUJOCO_GL is {name}, which does not start" if wanted_backend() else name
    suffix = f" (MUJOCO_EGL_DEVICE_ID is {device!r})" if device is not None else ""
    return Backend(name, None, f"{source}: {problem}{suffix}")


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


def prepare_dm_control() -> None:
    """To be called before dm_control is imported: it initialises its OpenGL at once, and only then looks at MUJOCO_GL.

    Without a display and without a choice by the user it would take GLFW, which fails: it gets what works. If it has
    been imported already, a warning says so.

    Raises:
        RenderingError: if MUJOCO_GL, or a variable beside it, makes that import fail.
    """
    if sys.platform != "linux":
        return
    wanted, platform = wanted_backend(), os.environ.get("PYOPENGL_PLATFORM", "").lower()
    headless = not wanted and not has_display() and opengl().name in HEADLESS and not opengl().problem
    if "dm_control.mujoco" in sys.modules:
        if headless:
            warnings.warn(_GLFW_CHOSEN.format(backend=opengl().name), stacklevel=2)
        return
    load_triton()
    if headless and platform in ("", opengl().name):
        os.environ["MUJOCO_GL"] = opengl().name
    if not wanted:
        return
    os.environ["MUJOCO_GL"] = wanted  # dm_control knows small letters only
    problem = "" if wanted in (*OFF, *KNOWN) and wanted not in HEADLESS else opengl().problem
    if wanted in HEADLESS and platform not in ("", wanted):
        problem = f"PYOPENGL_PLATFORM is {platform}, which does not go with MUJOCO_GL={wanted}"
    if problem:
        raise RenderingError(f"dm_control cannot be imported: {problem}. {REMEDY}")
