"""The dm_env environment: dm_control's composer runs a scene, with a task's score and horizon if there is a task."""

from __future__ import annotations

import sys
from typing import Any

import mujoco

from magical_mj.engine import State
from magical_mj.rendering.backend import prepare_dm_control
from magical_mj.utils.errors import MissingExtraError

try:
    prepare_dm_control()  # before it is imported
    from magical_mj.envs.composer.entities import Arena
    from magical_mj.envs.composer.environment import Environment, load, load_scene
except (ImportError, AttributeError) as error:  # the latter with versions that do not fit together
    MISSING = (
        "magical_mj.load needs dm_control, which installs with Python below 3.13 and MuJoCo 3 (this is Python "
        f"{sys.version_info.major}.{sys.version_info.minor} with MuJoCo {mujoco.__version__}): pip install dm_control "
        f"there, or use Gymnasium or magical_mj.Engine here ({error})"
    )

    class _Missing:
        """Stands for what is missing until it is used, so that the package can be listed and imported whole."""

        def __init__(self, *_: Any, **__: Any) -> None:
            raise MissingExtraError(MISSING)

    Arena = Environment = load = load_scene = _Missing

__all__ = ["Arena", "Environment", "State", "load", "load_scene"]
