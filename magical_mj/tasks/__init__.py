"""The tasks: one module for each, readable without knowing the simulator.

A new task is a module with a docstring that explains it, a demo scene, its rules, a score, a plan and a `TaskSpec`, and
one line here. Its variants, environments and ids follow from it. See docs/adding-a-task.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType
from typing import Final

from magical_mj.tasks.spec import RULES, Rules, TaskSpec

__all__ = ["RULES", "SPECS", "Rules", "TaskSpec"]

_MODULES: Final = (  # in the paper's order
    "move_to_corner",
    "move_to_region",
    "match_regions",
    "make_line",
    "find_dupe",
    "fix_colour",
    "cluster_colour",
    "cluster_shape",
)


def _spec(module: str) -> TaskSpec:
    return import_module(f"{__name__}.{module}").SPEC


SPECS: Final[Mapping[str, TaskSpec]] = MappingProxyType({_spec(module).name: _spec(module) for module in _MODULES})
"""All tasks by name, in the paper's order."""
