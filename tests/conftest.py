"""Imported before any test module: magical_mj chooses the OpenGL backend, which mujoco looks at when it is imported."""

import magical_mj  # noqa: F401
