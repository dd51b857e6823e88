"""The old path of `magical_mj.xmagical.envs`, which exported data sets of older versions name."""

from magical_mj.utils.imports import moved

__getattr__ = moved("magical_mj.xmagical.envs")
