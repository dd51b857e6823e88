"""The dm_env environment: dm_control's composer runs a scene, with a task's score and horizon if there is a task."""

from __future__ import annotations

from magical_mj.environment.environment import Environment
from magical_mj.environment.loading import load, load_scene
from magical_mj.environment.state import State

__all__ = ["Environment", "State", "load", "load_scene"]
