"""The old path of `magical_mj.observations`."""

from magical_mj.utils.imports import moved

__getattr__ = moved("magical_mj.observations")
