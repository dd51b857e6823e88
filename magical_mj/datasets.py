"""The demonstrations of a task in the form that a tool reads."""

from magical_mj.demos.datasets import (
    FORMATS,
    Format,
    load,
    make_env_and_datasets,
)

__all__ = ["FORMATS", "Format", "load", "make_env_and_datasets"]
