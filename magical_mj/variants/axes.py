"""The variants as sets of axes, and which variants a task has."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, Literal, get_args

from magical_mj.tasks.spec import TaskSpec
from magical_mj.utils.errors import UnknownNameError, check_name

Axis = Literal["jitter", "layout", "colour", "shape", "count", "dynamics"]
AXES: Final[tuple[Axis, ...]] = get_args(Axis)
"""An axis's index in this tuple selects its random generator: append new ones, never insert or reorder."""

VARIANTS: Final[Mapping[str, tuple[Axis, ...]]] = MappingProxyType(
    {
        "Demo": (),
        "Jitter": ("jitter",),
        "Layout": ("layout",),
        "Colour": ("colour",),
        "Shape": ("shape",),
        "CountPlus": ("layout", "colour", "shape", "count"),
        "Dynamics": ("dynamics",),
        "All": ("jitter", "layout", "colour", "shape", "count", "dynamics"),  # fixed, even if AXES grows
    }
)
"""The axes of each variant. In All, a task leaves out axes that it does not support, and jitter if it has layout."""


def supported_axes(spec: TaskSpec) -> tuple[Axis, ...]:
    """The axes that a task supports: always jitter and dynamics, the others as its spec says."""
    offered: dict[Axis, bool] = {
        "jitter": True,
        "layout": spec.layout,
        "colour": spec.colour is not None,
        "shape": spec.shape is not None,
        "count": spec.count is not None,
        "dynamics": True,
    }
    return tuple(axis for axis in AXES if offered[axis])


def variants_of(spec: TaskSpec) -> tuple[str, ...]:
    """The variants of a task: All, and those whose axes the task supports."""
    supported = set(supported_axes(spec))
    return tuple(name for name, axes in VARIANTS.items() if name == "All" or supported.issuperset(axes))


def varied_axes(spec: TaskSpec, variant: str) -> tuple[Axis, ...]:
    """The axes that `variant` varies in this task.

    Raises:
        UnknownNameError: if there is no such variant, or this task does not have it.
    """
    check_name("variant", variant, VARIANTS)
    supported = supported_axes(spec)
    if variant == "All":
        left_out = "jitter" if "layout" in supported else None
        return tuple(axis for axis in VARIANTS["All"] if axis in supported and axis != left_out)
    missing = [axis for axis in VARIANTS[variant] if axis not in supported]
    if missing:
        raise UnknownNameError(
            f"{spec.name} has no variant {variant!r}, for its {' and '.join(missing)} cannot vary. "
            f"It has: {', '.join(variants_of(spec))}"
        )
    return VARIANTS[variant]
