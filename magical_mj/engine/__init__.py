"""The engine: one world of MuJoCo with its scene, score and states."""

import magical_mj.assets  # noqa: F401 - which imports mujoco, whatever MUJOCO_GL is
