"""The old path of `magical_mj.actions`, which messages of earlier versions named."""

from magical_mj.utils.imports import moved

__getattr__ = moved("magical_mj.actions")
