"""The dm_env environment: dm_control's composer runs a scene, with a task's score and horizon if there is a task."""

from __future__ import annotations

from magical_mj.rendering.backend import prepare_dm_control

prepare_dm_control()  # before anything below imports dm_control

from magical_mj.engine.state import State  # noqa: E402
from magical_mj.envs.composer.environment import Environment  # noqa: E402
from magical_mj.envs.composer.loading import load, load_scene  # noqa: E402

__all__ = ["Environment", "State", "load", "load_scene"]
