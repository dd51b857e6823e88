"""The dm_env environment: dm_control's composer simulates a scene, with the score and horizon of a task if given."""

from __future__ import annotations

import os
import sys
import warnings
from typing import Any, Final

import mujoco

from magical_mj.engine import State
from magical_mj.rendering.backend import HEADLESS, REMEDY, has_display, load_triton, opengl, wanted_backend
from magical_mj.utils.environment import environment_restored
from magical_mj.utils.errors import MissingExtraError, RenderingError

_OTHERS: Final = ("glfw", "on", "enable", "enabled", "true", "1", "off", "disable", "disabled", "false", "0")
"""The values of MUJOCO_GL, besides `HEADLESS`, that mujoco and dm_control accept."""
_GLFW_CHOSEN: Final = (
    "dm_control was imported first, without a display and without MUJOCO_GL, so it has chosen GLFW: physics.render "
    "and dm_control's viewer find no OpenGL context of their own. Set MUJOCO_GL to {backend} before Python starts, "
    "or use magical_mj.load before dm_control is imported. Observations and env.render work"
)


def _prepare() -> None:
    """Sets MUJOCO_GL for dm_control, which reads it once, when it is imported.

    Without a display and without MUJOCO_GL, dm_control would choose GLFW, which fails. So MUJOCO_GL is set to a backend
    that works. If dm_control has been imported already, a warning is given instead. Values that would make the import
    fail raise an error.
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
    os.environ["MUJOCO_GL"] = wanted  # dm_control accepts lower case only
    problem = "" if wanted in _OTHERS else opengl().problem
    if wanted in HEADLESS and platform not in ("", wanted):
        problem = f"PYOPENGL_PLATFORM is {platform}, which contradicts MUJOCO_GL={wanted}"
    if problem:
        raise RenderingError(f"dm_control cannot be imported: {problem}. {REMEDY}")


try:
    with environment_restored("MUJOCO_GL", "PYOPENGL_PLATFORM"):
        _prepare()  # before the first import of dm_control
        from magical_mj.envs.composer.entities import Arena
        from magical_mj.envs.composer.environment import Environment, load, load_scene
except (ImportError, AttributeError) as error:  # AttributeError: versions of dm_control and MuJoCo do not match
    MISSING = (
        "magical_mj.load needs dm_control, which requires Python below 3.13 and MuJoCo 3 (this is Python "
        f"{sys.version_info.major}.{sys.version_info.minor} with MuJoCo {mujoco.__version__}): run pip install "
        f"dm_control with such versions, or use Gymnasium or magical_mj.Engine ({error})"
    )

    class _Missing:
        """Replaces missing objects, so that the package can be imported. Using one raises the error."""

        def __init__(self, *_: Any, **__: Any) -> None:
            raise MissingExtraError(MISSING)

    Arena = Environment = load = load_scene = _Missing

__all__ = ["Arena", "Environment", "State", "load", "load_scene"]
