"""MJCF models of scenes: the look of each thing, its collision geometry and its actuators. Independent of tasks."""

import os

try:
    import mujoco  # here first: all that needs it imports this package before
except Exception:  # its exceptions differ: it imports what draws for MUJOCO_GL, which is wrong or not installed
    variable = os.environ.pop("MUJOCO_GL", None)
    if variable is None:
        raise
    os.environ["MUJOCO_GL"] = "off"  # all but mujoco's own renderer works; our pictures say what is wrong
    try:
        import mujoco  # noqa: F401
    finally:
        os.environ["MUJOCO_GL"] = variable
