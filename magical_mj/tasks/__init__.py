"""What the tasks are: a module each, readable without knowing the simulator.

A new task is a module with a page docstring, a demo scene, its rules, a score and a `TaskSpec`, and a line
here; its variants, environments and ids follow.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from magical_mj.tasks import (
    cluster_colour,
    cluster_shape,
    find_dupe,
    fix_colour,
    make_line,
    match_regions,
    move_to_corner,
    move_to_region,
)
from magical_mj.tasks.spec import RULES, Rules, TaskSpec

__all__ = ["RULES", "SPECS", "Rules", "TaskSpec"]

_MODULES: Final = (  # in the paper's order
    move_to_corner,
    move_to_region,
    match_regions,
    make_line,
    find_dupe,
    fix_colour,
    cluster_colour,
    cluster_shape,
)

SPECS: Final[Mapping[str, TaskSpec]] = MappingProxyType({module.SPEC.name: module.SPEC for module in _MODULES})
"""All tasks by name, in the paper's order."""
