"""Imported before any test module: magical_mj chooses the OpenGL backend, which mujoco looks at when it is imported."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # PyTorch's: several tests run at once, and its threads wait busily

import magical_mj  # noqa: F401
