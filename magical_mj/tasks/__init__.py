"""The tasks. Each has a module that can be read without knowing the simulator; both cluster tasks share `cluster`.

A new task is a module with a docstring that explains it, a demo scene, its rules, a score, a plan and a `TaskSpec`. It
also needs a line here. Its variants, environments and ids follow from it. See docs/adding-a-task.md.
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
from magical_mj.tasks.suites import suites

__all__ = ["KNOWN", "RULES", "SPECS", "SUITES", "Rules", "TaskSpec"]

_ALL = (move_to_corner, move_to_region, match_regions, make_line, find_dupe, fix_colour, cluster_colour, cluster_shape)

SPECS: Final[Mapping[str, TaskSpec]] = MappingProxyType({module.SPEC.name: module.SPEC for module in _ALL})
"""All tasks by name, in the paper's order."""

SUITES: Final[Mapping[str, Mapping[str, TaskSpec]]] = MappingProxyType(
    {"magical": SPECS, **{name: suite.tasks for name, suite in suites().items()}}
)
"""The suites: the benchmark, which "all" means, and others. Each suite has its own protocol number."""

KNOWN: Final[Mapping[str, TaskSpec]] = MappingProxyType(
    {name: spec for suite in SUITES.values() for name, spec in suite.items()}
)
"""The tasks of all suites by name."""
