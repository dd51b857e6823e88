"""Shared libraries that must be loaded in a certain order, or may be missing. They are only loaded, not called."""

from __future__ import annotations

import contextlib
import ctypes
import importlib.util
import os
import sys
from functools import cache
from pathlib import Path

OSMESA_LIBRARIES = ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")


@cache
def load_triton() -> None:
    """Loads Triton's library, if it is installed, before an OpenGL driver is loaded. It takes 0.05 s.

    PyTorch's CUDA builds include Triton, and their optimisers import it. It contains LLVM, as Mesa's drivers do. If
    Mesa's LLVM is loaded first, Triton calls functions of that one, and the process crashes. If other code, such as
    mujoco's renderer, has already loaded a driver, this does nothing.
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
def osmesa_works() -> bool:
    """Whether the OSMesa library can be loaded."""
    for name in OSMESA_LIBRARIES:
        with contextlib.suppress(OSError):
            ctypes.CDLL(name)
            return True
    return False
