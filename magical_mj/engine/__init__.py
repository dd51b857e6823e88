"""The engine: one world of MuJoCo with its scene, score and states."""

from __future__ import annotations

import magical_mj.assets  # noqa: F401 - which imports mujoco, whatever MUJOCO_GL is
from magical_mj.engine.engine import Engine
from magical_mj.engine.simulation import State

__all__ = ["Engine", "State"]
