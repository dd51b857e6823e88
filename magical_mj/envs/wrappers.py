"""The old path of `magical_mj.wrappers`, which saved specs of environments name."""

from magical_mj.utils.imports import moved

__getattr__ = moved("magical_mj.wrappers")
