"""The choice of an OpenGL backend, made before mujoco and dm_control are imported: they read MUJOCO_GL only then."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import importlib.util
import os
import sys
from functools import cache
from pathlib import Path
from typing import Any, Final

from magical_mj.utils.errors import RenderingError

PACKAGES: Final = {"egl": "libegl1, libgl1-mesa-dri", "osmesa": "libosmesa6"}
REMEDY = (
    f"Set the environment variable MUJOCO_GL, before Python starts, to egl (Debian and Ubuntu packages: "
    f"{PACKAGES['egl']}), osmesa (package: {PACKAGES['osmesa']}) or, with a display, glfw."
)
OSMESA_LIBRARIES = ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")
EGL_PLATFORM_DEVICE_EXT = 0x313F
MOST_DEVICES = 16


def choose_backend() -> None:
    """Sets MUJOCO_GL to a backend that works on this machine, EGL or else OSMesa, unless the user has set it.

    If neither works it stays unset: everything except pictures works, and the first picture raises RenderingError.
    """
    load_triton()
    os.environ.setdefault("LP_NUM_THREADS", "0")  # Mesa's software OpenGL is faster without worker threads
    os.environ.setdefault("SDL_FRAMEBUFFER_ACCELERATION", "0")  # else pygame's windows have an OpenGL context;
    # alternating between it and ours makes X11 end the process
    if wanted_backend():
        os.environ["MUJOCO_GL"] = wanted_backend()  # dm_control knows small letters only
        return
    if sys.platform != "linux":
        return
    found = next((name for name, works in PROBES.items() if works()), None)
    if found:
        os.environ["MUJOCO_GL"] = found


def wanted_backend() -> str:
    """The value of MUJOCO_GL; empty if it is not set."""
    return os.environ.get("MUJOCO_GL", "").strip().lower()


def check_opengl() -> None:
    """Raises a helpful error where importing mujoco or dm_control would fail without an explanation.

    Raises:
        RenderingError: if MUJOCO_GL is unknown to mujoco, or is EGL or OSMesa and that does not start.
    """
    wanted = wanted_backend()
    if wanted and wanted not in KNOWN:
        raise RenderingError(f"MUJOCO_GL is {wanted}, which mujoco does not know. {REMEDY}")
    if sys.platform == "linux" and wanted in PROBES and not PROBES[wanted]():
        raise RenderingError(f"MUJOCO_GL is {wanted}, which does not start on this machine. {REMEDY}")


def new_gl_context() -> Any:
    """A new OpenGL context for the chosen backend, even if mujoco was imported before it was chosen."""
    import mujoco

    wanted = wanted_backend()
    module = importlib.import_module(f"mujoco.{wanted}") if wanted in PROBES else mujoco
    return module.GLContext(64, 64)


@cache
def load_triton() -> None:
    """Loads the library of Triton if it is installed: PyTorch's CUDA builds bring it, and their optimisers import it.

    It holds an LLVM. If that of Mesa's drivers were in the process before, its functions would be taken for Triton's,
    and the process would die at that import. So this comes before all that may load a driver. It takes 0.05 s.
    """
    if sys.platform != "linux" or (package := importlib.util.find_spec("triton")) is None:
        return
    for folder in package.submodule_search_locations or ():
        for library in Path(folder).glob("_C/libtriton*.so"):
            with contextlib.suppress(OSError):
                ctypes.CDLL(str(library), os.RTLD_NOW | os.RTLD_LOCAL)


@cache
def egl_works() -> bool:
    """Whether an EGL device can be initialised in the way mujoco and dm_control do."""
    try:
        egl = ctypes.CDLL("libEGL.so.1")
    except OSError:
        return False
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    query = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    platform = egl.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    if not (query and platform):
        return False
    query_devices = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)(query)
    get_display = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p)(platform)
    egl.eglInitialize.argtypes = [ctypes.c_void_p] * 3
    devices, count = (ctypes.c_void_p * MOST_DEVICES)(), ctypes.c_int(0)
    query_devices(MOST_DEVICES, devices, ctypes.byref(count))
    displays = (get_display(EGL_PLATFORM_DEVICE_EXT, device, None) for device in devices[: count.value])
    return any(display and egl.eglInitialize(display, None, None) for display in displays)


@cache
def osmesa_works() -> bool:
    """Whether the OSMesa library can be loaded."""
    for name in OSMESA_LIBRARIES:
        with contextlib.suppress(OSError):
            ctypes.CDLL(name)
            return True
    return False


PROBES: Final = {"egl": egl_works, "osmesa": osmesa_works}
"""The backends that need no display, in the order in which they are tried."""
KNOWN: Final = ("glfw", "on", "enable", "enabled", "true", "1", "off", "disable", "disabled", "false", "0", *PROBES)
"""The values of MUJOCO_GL that mujoco and dm_control accept."""
