"""The variants as sets of axes, what a task declares about its variation, and which variants follow from that."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal, get_args

import numpy as np

from magical_mj.scene import Scene
from magical_mj.utils.errors import TaskError, UnknownNameError, check_name, short_repr

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

AxisRule = Callable[[np.random.Generator, Scene], Scene]
"""Draws one attribute of a scene: its colours, its shapes or its counts.

The result must be a scene of the task (`VariationRules.check`). Poses usually stay as they are. Blocks that a count
rule adds may have any pose, since they are placed afterwards; but a block that belongs in a goal region must be in it.
"""

_ROUNDING: Final = 1e-9
WIDER: Final = 0.2
"""By how much (world units) a region may be wider than the arena: x-magical's zone is."""


@dataclass(frozen=True, kw_only=True)
class VariationRules:
    """What a task declares about its variation; `magical_mj.tasks.TaskSpec` adds its score and its plan.

    A task supports each of the axes colour, shape and count if it has a rule for it.
    """

    name: str
    """As in ids and file names, such as ``"FindDupe"``: letters and digits."""
    demo: Scene
    """The one scene in which demonstrations start; blocks and regions in the original's order."""
    check: Callable[[Scene], None]
    """Raises `InvalidSceneError` unless the scene is one in which this task can start."""

    colour: AxisRule | None = None
    shape: AxisRule | None = None
    count: AxisRule | None = None
    jitter: bool = True
    """Whether poses may change a little."""
    layout: bool | AxisRule = True
    """Whether poses may be drawn from the whole workspace; or a rule of the task's own, which draws them."""
    drive_forces: tuple[float, float] = (2.2, 3.5)
    """The range of the drive's force cap in Dynamics."""
    region_size: tuple[float, float] = (0.0, 0.0)
    """Least and greatest height and width of the goal regions, in world units."""
    inner_margin: float = 0.0
    """For what belongs in a region: the least distance (world units) that a layout keeps between its
    centre and the sides of the largest square around the region's centre."""

    def __post_init__(self) -> None:
        """Raises `TaskError` if a field has a wrong type or is out of its range."""
        if not is_task_name(self.name):
            raise TaskError(f"the name of a task must be made of letters and digits, not {short_repr(self.name)}")
        self._require("demo", isinstance(self.demo, Scene), "a magical_mj.Scene")
        self._require("jitter", isinstance(self.jitter, bool), "a bool")
        self._require("layout", isinstance(self.layout, bool) or callable(self.layout), "a bool, or a function")
        forces = isinstance(self.drive_forces, tuple) and len(self.drive_forces) == 2
        self._require("drive_forces", forces and 0 < self.drive_forces[0] <= self.drive_forces[1], "a range above 0")
        self._require("check", callable(self.check), "a function")
        for axis in ("colour", "shape", "count"):
            rule = getattr(self, axis)
            self._require(axis, rule is None or callable(rule), "a function, or None")
        if self.count is not None and not self.layout:
            raise TaskError(f"{self.name}.count needs layouts, which place the blocks that it adds: omit layout=False")
        self._check_regions()

    def _require(self, part: str, condition: bool, need: str) -> None:
        """Raise `TaskError`, which says what this field must be, unless the condition holds."""
        if not condition:
            raise TaskError(f"{self.name}.{part} must be {need}, not {short_repr(getattr(self, part))}")

    def _check_regions(self) -> None:
        """Raise `TaskError` unless the sizes are possible, and those of the demo's regions are among them."""
        sides = [side for region in self.demo.regions for side in (region.height, region.width)]
        possible = _are_sizes(self.region_size, 2 * self.demo.half_width + WIDER) and (
            self.region_size[0] > 0 or not sides
        )
        self._require("region_size", possible, "the least and greatest side of its goal regions, above 0")
        low, high = self.region_size
        if not all(low - _ROUNDING <= side <= high + _ROUNDING for side in sides):
            listed = ", ".join(f"{side:g}" for side in sides)
            raise TaskError(f"{self.name}.region_size is {(low, high)}; the sides in its demo must be within: {listed}")
        margin: Any = self.inner_margin
        small = isinstance(margin, int | float) and (margin == 0 or 0 < margin < low / 2)
        self._require("inner_margin", small, "0, or less than half of the least side of its regions")


def is_task_name(name: Any) -> bool:
    """Whether tasks may be called so: letters and digits, as ids and names of files need."""
    return isinstance(name, str) and name.isascii() and name.isalnum()


def _are_sizes(sizes: Any, most: float) -> bool:
    """Whether these are a least and a greatest size, of at most `most`."""
    if not isinstance(sizes, tuple | list) or len(sizes) != 2 or not all(isinstance(x, int | float) for x in sizes):
        return False
    return 0 <= sizes[0] <= sizes[1] <= most


def supported_axes(rules: VariationRules) -> tuple[Axis, ...]:
    """The axes that a task supports: always dynamics, the others as it declares."""
    return tuple(axis for axis in AXES if axis == "dynamics" or getattr(rules, axis))


def variants_of(rules: VariationRules) -> tuple[str, ...]:
    """The variants of a task: All, and those whose axes the task supports."""
    supported = set(supported_axes(rules))
    return tuple(name for name, axes in VARIANTS.items() if name == "All" or supported.issuperset(axes))


def varied_axes(rules: VariationRules, variant: str) -> tuple[Axis, ...]:
    """The axes that `variant` varies in this task.

    Raises:
        UnknownNameError: if there is no such variant, or this task does not have it.
    """
    check_name("variant", variant, VARIANTS)
    supported = supported_axes(rules)
    if variant == "All":
        left_out = "jitter" if "layout" in supported else None
        return tuple(axis for axis in VARIANTS["All"] if axis in supported and axis != left_out)
    missing = [axis for axis in VARIANTS[variant] if axis not in supported]
    if missing:
        raise UnknownNameError(
            f"{rules.name} has no variant {variant!r}, for its {' and '.join(missing)} cannot vary. "
            f"It has: {', '.join(variants_of(rules))}"
        )
    return VARIANTS[variant]
