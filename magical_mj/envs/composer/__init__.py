"""The dm_env environment: dm_control's composer simulates a scene, with the score and horizon of a task if given."""

from __future__ import annotations

import sys
from typing import Any

import mujoco

from magical_mj.engine import State
from magical_mj.rendering.backend import prepare_dm_control
from magical_mj.utils.errors import MissingExtraError

try:
    prepare_dm_control()  # before the first import of dm_control
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
