"""Shared libraries that have to be loaded in a certain order, or may be missing. They are loaded, and not called."""

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
def osmesa_works() -> bool:
    """Whether the OSMesa library can be loaded."""
    for name in OSMESA_LIBRARIES:
        with contextlib.suppress(OSError):
            ctypes.CDLL(name)
            return True
    return False
