"""MJCF models of scenes: visual geoms, collision geoms and actuators. This layer does not depend on tasks."""

import os

try:
    import mujoco  # modules that need mujoco import this package first
except Exception:  # various types: MUJOCO_GL names an OpenGL backend that does not exist or is not installed
    variable = os.environ.pop("MUJOCO_GL", None)
    if variable is None:
        raise
    os.environ["MUJOCO_GL"] = "off"  # mujoco works without its renderer; the first picture raises a clear error
    try:
        import mujoco  # noqa: F401
    finally:
        os.environ["MUJOCO_GL"] = variable
