"""The dm_env environment: dm_control's composer runs a scene, with a task's score and horizon if there is a task."""

from __future__ import annotations

from magical_mj.engine.state import State
from magical_mj.envs.composer.environment import Environment
from magical_mj.envs.composer.loading import load, load_scene

__all__ = ["Environment", "State", "load", "load_scene"]
