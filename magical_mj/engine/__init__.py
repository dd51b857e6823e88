"""The engine: simulates one environment in MuJoCo, scores it, and saves and restores its state."""

from __future__ import annotations

import magical_mj.assets  # noqa: F401 - imports mujoco first, whatever MUJOCO_GL is
from magical_mj.engine.engine import Engine
from magical_mj.engine.episode import State

__all__ = ["Engine", "State"]
