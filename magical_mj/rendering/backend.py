"""The choice of a renderer and of its OpenGL backend, made when the first picture is drawn. An import chooses nothing.

mujoco and dm_control look at MUJOCO_GL when they are imported, and PyOpenGL at PYOPENGL_PLATFORM. We make our contexts
from mujoco's modules for single backends, so that neither matters.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import importlib.util
import os
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Final, Literal, cast, get_args

from magical_mj.utils.errors import RenderingError, check_name

RendererName = Literal["opengl", "software"]
RENDERERS: Final[tuple[RendererName, ...]] = get_args(RendererName)
"""What draws the flat views: MuJoCo with OpenGL, or scanlines on the processor."""
VARIABLE: Final = "MAGICAL_MJ_RENDERER"
"""The environment variable that chooses between them for a whole process."""

PACKAGES: Final = {"egl": "libegl1, libgl1-mesa-dri", "osmesa": "libosmesa6"}
REMEDY = (
    f"Set the environment variable MUJOCO_GL, before Python starts, to egl (Debian and Ubuntu packages: "
    f"{PACKAGES['egl']}), osmesa (package: {PACKAGES['osmesa']}) or, with a display, glfw."
)
OSMESA_LIBRARIES = ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")
EGL_PLATFORM_DEVICE_EXT = 0x313F
MAX_DEVICES = 16


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
    renderer, backend = check_renderer(renderer), chosen_backend()
    return "software" if renderer == "software" or (renderer is None and problem_of(backend)) else backend


def chosen_backend() -> str:
    """The OpenGL backend of our pictures: MUJOCO_GL, or else, on Linux, EGL or OSMesa, whichever works first.

    Empty if that is left to mujoco, which takes GLFW on Linux. Nothing is written to the environment: which backend
    mujoco's and dm_control's own renderers use is not ours to choose.
    """
    if sys.platform != "linux" or wanted_backend():
        return wanted_backend()
    return next((name for name in PROBES if not problem_of(name)), "")


def wanted_backend() -> str:
    """The value of MUJOCO_GL; empty if it is not set."""
    return os.environ.get("MUJOCO_GL", "").strip().lower()


def problem_of(backend: str) -> str:
    """Why a backend cannot work in this process, as far as that can be told without drawing; empty if it may work."""
    if backend and backend not in KNOWN:
        return f"MUJOCO_GL is {backend}, which mujoco does not know"
    if backend in OFF:
        return f"MUJOCO_GL is {backend}"
    if sys.platform != "linux":
        return ""
    if backend not in PROBES:  # mujoco takes GLFW
        missing = "" if backend else "neither EGL nor OSMesa starts on this machine, and "
        return "" if has_display() else egl_device_problem() or f"{missing}GLFW needs a display"
    if backend == "egl" and (problem := egl_device_problem()):
        return problem
    return "" if PROBES[backend]() else f"MUJOCO_GL is {backend}, which does not start on this machine"


def prepare_dm_control() -> None:
    """To be called before dm_control is imported: it initialises its OpenGL at once, and only then looks at MUJOCO_GL.

    Without a display and without a choice by the user it would take GLFW, which fails: it gets what works.

    Raises:
        RenderingError: if MUJOCO_GL, or a variable beside it, makes that import fail.
    """
    if "dm_control._render" in sys.modules or sys.platform != "linux":
        return
    load_triton()
    wanted, platform = wanted_backend(), os.environ.get("PYOPENGL_PLATFORM", "").lower()
    if not wanted:
        fitting = (name for name in PROBES if platform in ("", name) and not problem_of(name))
        if not has_display() and (backend := next(fitting, "")):
            os.environ["MUJOCO_GL"] = backend
        return
    os.environ["MUJOCO_GL"] = wanted  # dm_control knows small letters only
    problem = problem_of(wanted) if wanted in PROBES or wanted not in KNOWN else ""
    if wanted in PROBES and platform not in ("", wanted):
        problem = f"PYOPENGL_PLATFORM is {platform}, which does not go with MUJOCO_GL={wanted}"
    if problem:
        raise RenderingError(f"dm_control cannot be imported: {problem}. {REMEDY}")


def has_display() -> bool:
    """Whether a window could be opened, as far as the environment says."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Mesa's software OpenGL, if it starts within the block, works without threads, which is faster for small pictures.

    It looks at the variable when a display is initialised; afterwards the environment is as before.
    """
    if "LP_NUM_THREADS" in os.environ:
        yield
        return
    os.environ["LP_NUM_THREADS"] = "0"
    try:
        yield
    finally:
        os.environ.pop("LP_NUM_THREADS", None)


@cache
def load_triton() -> None:
    """Loads the library of Triton if it is installed: PyTorch's CUDA builds bring it, and their optimisers import it.

    It holds an LLVM. If that of Mesa's drivers were in the process before, its functions would be taken for Triton's,
    and the process would die at that import. So this comes before all that may load a driver. It takes 0.05 s. Where
    somebody else, such as mujoco's renderer, has loaded a driver already, it is too late, and nothing is done.
    """
    if sys.platform != "linux" or (package := importlib.util.find_spec("triton")) is None:
        return
    with contextlib.suppress(OSError):
        if "libLLVM" in Path("/proc/self/maps").read_text():
            return
    for folder in package.submodule_search_locations or ():
        for library in Path(folder).glob("_C/libtriton*.so"):
            with contextlib.suppress(OSError):
                ctypes.CDLL(str(library), os.RTLD_NOW | os.RTLD_LOCAL)


@cache
def egl_library() -> ctypes.CDLL | None:
    """EGL; None without it. mujoco looks for its functions among those of all libraries that are loaded."""
    load_triton()
    try:
        egl = ctypes.CDLL("libEGL.so.1", mode=ctypes.RTLD_GLOBAL)
    except OSError:
        return None
    pointers = ("GetProcAddress", "GetCurrentDisplay", "GetCurrentSurface", "GetCurrentContext", "CreateContext")
    for name in pointers:
        getattr(egl, f"egl{name}").restype = ctypes.c_void_p
    for name, count in (("Initialize", 3), ("MakeCurrent", 4), ("CreateContext", 4), ("DestroyContext", 2)):
        getattr(egl, f"egl{name}").argtypes = [ctypes.c_void_p] * count
    egl.eglChooseConfig.argtypes = [*[ctypes.c_void_p] * 3, ctypes.c_int, ctypes.c_void_p]
    return egl


@cache
def egl_devices() -> tuple[int, ...]:
    """The displays of EGL's devices, in the order in which mujoco and dm_control count them; 0 for a failing one."""
    egl = egl_library()
    if egl is None:
        return ()
    query = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    platform = egl.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    if not (query and platform):
        return ()
    query_devices = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)(query)
    get_display = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p)(platform)
    devices, count = (ctypes.c_void_p * MAX_DEVICES)(), ctypes.c_int(0)
    query_devices(MAX_DEVICES, devices, ctypes.byref(count))
    return tuple(get_display(EGL_PLATFORM_DEVICE_EXT, device, None) or 0 for device in devices[: count.value])


@cache
def egl_display() -> int:
    """The first display that can be initialised, or that of MUJOCO_EGL_DEVICE_ID; 0 if there is none."""
    egl, displays = egl_library(), egl_devices()
    if egl is None or egl_device_problem():
        return 0
    if wanted := os.environ.get("MUJOCO_EGL_DEVICE_ID"):
        displays = displays[int(wanted) :][:1]
    with one_thread():
        return next((display for display in displays if display and egl.eglInitialize(display, None, None)), 0)


def egl_device_problem() -> str:
    """What is wrong with MUJOCO_EGL_DEVICE_ID; empty if all is well."""
    wanted, count = os.environ.get("MUJOCO_EGL_DEVICE_ID", "0"), len(egl_devices())
    if not count or (wanted.strip().isdecimal() and int(wanted) < count):
        return ""
    return f"MUJOCO_EGL_DEVICE_ID is {wanted!r}; EGL's devices here are numbered from 0 to {count - 1}"


@cache
def osmesa_works() -> bool:
    """Whether the OSMesa library can be loaded."""
    for name in OSMESA_LIBRARIES:
        with contextlib.suppress(OSError):
            ctypes.CDLL(name)
            return True
    return False


PROBES: Final[dict[str, Callable[[], object]]] = {"egl": egl_display, "osmesa": osmesa_works}
"""The backends that need no display, in the order in which they are tried."""
OFF: Final = ("off", "disable", "disabled", "false", "0")
KNOWN: Final = ("glfw", "on", "enable", "enabled", "true", "1", *OFF, *PROBES)
"""The values of MUJOCO_GL that mujoco and dm_control accept."""
