"""The old path of `magical_mj.xmagical.sweep_to_top`, which packages with tasks of their own import."""

from magical_mj.utils.imports import moved

__getattr__ = moved("magical_mj.xmagical.sweep_to_top")
