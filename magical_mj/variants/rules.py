"""The variants: their axes, the rules that a task declares for them, and the scenes that result.

All functions are pure, and give the same scenes on every machine.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final, Literal, get_args

import numpy as np

from magical_mj.scene import Dynamics, Scene
from magical_mj.scene.bodies import GRIPPER
from magical_mj.utils.errors import (
    InvalidSeedError,
    PlacementError,
    TaskError,
    UnknownNameError,
    as_integer,
    check_name,
    short_repr,
)
from magical_mj.variants.placement import contact, jitter, layout, with_room

Axis = Literal["jitter", "layout", "colour", "shape", "count", "dynamics", "diagnose"]
AXES: Final[tuple[Axis, ...]] = get_args(Axis)
"""An axis's index in this tuple selects its random generator: append new axes, never insert or reorder any."""

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

OTHER_VARIANTS: Final[Mapping[str, tuple[Axis, ...]]] = MappingProxyType({"Diagnose": ("diagnose",)})
"""Variants beyond the paper's. They must be named, since "all" means those of `VARIANTS`."""

AxisRule = Callable[[np.random.Generator, Scene], Scene]
"""Draws one attribute of a scene: its colours, its shapes or its counts.

The result must be a scene of the task (`VariationRules.check`). Poses usually stay as they are. Blocks that a count
rule adds may have any pose, since they are placed afterwards. But a block that belongs in a goal region must be in it.
"""

DiagnoseRule = Callable[[np.random.Generator, Scene, int], Scene]
"""Draws a scene where a wrong reading of the demonstrations fails. The seed, the last argument, selects the reading."""

_ROUNDING: Final = 1e-9
WIDER: Final = 0.2
"""How much wider than the arena a region may be (world units). x-magical's goal zone is wider."""

MAX_SHAPE_DRAWS: Final = 1_000
MAX_REDRAWS: Final = 300
"""The largest number of scenes that are drawn until a task accepts one."""

DYNAMICS_RANGES: Final[Mapping[str, tuple[float, float]]] = MappingProxyType(
    {
        "turn_torque": (0.7, 1.5),
        "finger_torque": (2.5, 4.5),
        "block_friction_force": (1.0, 1.8),
        "block_friction_torque": (0.07, 0.15),
    }
)
"""Force or torque cap -> the range of its independent uniform draw, as in the released code.

The drive's force cap is drawn before these, from the task's range.
"""


@dataclass(frozen=True, kw_only=True)
class VariationRules:
    """The part of a task's definition about variants. `magical_mj.tasks.TaskSpec` adds its score and its plan.

    A task supports the axis colour, shape or count if it has a rule for it.
    """

    name: str
    """The name in ids and file names, such as ``"FindDupe"``: letters and digits."""
    demo: Scene
    """The initial scene of all demonstrations, with blocks and regions in the original's order."""
    further_demos: tuple[Scene, ...] = ()
    """Further initial scenes of demonstrations. Test variants vary `demo` only, so that their scenes do not depend on
    the number of demo scenes."""
    check: Callable[[Scene], None]
    """Raises `InvalidSceneError` if this task cannot start in the scene."""
    accepts: Callable[[Scene], bool] | None = None
    """Whether an episode should start in a drawn scene; otherwise, the scene is drawn again. None: always."""

    colour: AxisRule | None = None
    shape: AxisRule | None = None
    count: AxisRule | None = None
    diagnose: DiagnoseRule | None = None
    """Draws a whole scene of the variant Diagnose."""
    jitter: bool = True
    """Whether poses may change a little."""
    layout: bool | AxisRule = True
    """Whether poses may be drawn from the whole workspace, or a rule of the task that draws them."""
    drive_forces: tuple[float, float] = (2.2, 3.5)
    """The range of the drive's force cap in Dynamics."""
    region_size: tuple[float, float] = (0.0, 0.0)
    """Least and greatest height and width of the goal regions, in world units."""
    inner_margin: float = 0.0
    """For objects that belong in a region: the least distance (world units) in a layout between the object's centre and
    the sides of the largest square around the region's centre."""

    def __post_init__(self) -> None:
        """Raises `TaskError` if a field has a wrong type or is out of range."""
        if not is_task_name(self.name):
            raise TaskError(f"the name of a task must be made of letters and digits, not {short_repr(self.name)}")
        self._require("demo", isinstance(self.demo, Scene), "a magical_mj.Scene")
        further = isinstance(self.further_demos, tuple) and all(isinstance(s, Scene) for s in self.further_demos)
        self._require("further_demos", further, "a tuple of scenes")
        self._require("jitter", isinstance(self.jitter, bool), "a bool")
        self._require("layout", isinstance(self.layout, bool) or callable(self.layout), "a bool, or a function")
        forces = isinstance(self.drive_forces, tuple) and len(self.drive_forces) == 2
        self._require("drive_forces", forces and 0 < self.drive_forces[0] <= self.drive_forces[1], "a range above 0")
        self._require("check", callable(self.check), "a function")
        self._require_functions("accepts", "colour", "shape", "count", "diagnose")
        if self.count is not None and not self.layout:
            raise TaskError(f"{self.name}.count needs a layout, which places the added blocks: omit layout=False")
        self._check_regions()

    @property
    def demos(self) -> tuple[Scene, ...]:
        """All demo scenes. The scene of seed n in the Demo variant is number n modulo their count."""
        return self.demo, *self.further_demos

    @cached_property
    def supported_axes(self) -> tuple[Axis, ...]:
        """The axes that the task supports: dynamics always, the others if it declares them."""
        return tuple(axis for axis in AXES if axis == "dynamics" or getattr(self, axis))

    @cached_property
    def variants(self) -> Mapping[str, tuple[Axis, ...]]:
        """The task's variants with the axes that each one varies: All, and those whose axes the task supports.

        All varies the supported axes, without jitter if there is a layout. `OTHER_VARIANTS` are last.
        """
        supported = set(self.supported_axes)
        left_out = "jitter" if "layout" in supported else None
        everything = tuple(axis for axis in VARIANTS["All"] if axis in supported and axis != left_out)
        known = {**VARIANTS, "All": everything, **OTHER_VARIANTS}
        return {name: axes for name, axes in known.items() if supported.issuperset(axes)}

    def _require(self, part: str, condition: bool, need: str) -> None:
        """Raise a `TaskError` unless the condition holds. `need` describes valid values."""
        if not condition:
            raise TaskError(f"{self.name}.{part} must be {need}, not {short_repr(getattr(self, part))}")

    def _require_functions(self, *parts: str) -> None:
        """Raise a `TaskError` unless each of these parts is a function or None."""
        for part in parts:
            self._require(part, getattr(self, part) is None or callable(getattr(self, part)), "a function, or None")

    def _check_regions(self) -> None:
        """Raise a `TaskError` unless the sizes are possible and include those of the demos' regions."""
        sides = [side for demo in self.demos for region in demo.regions for side in (region.height, region.width)]
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
    """Whether a task may have this name. Ids and file names need letters and digits."""
    return isinstance(name, str) and name.isascii() and name.isalnum()


def _are_sizes(sizes: Any, most: float) -> bool:
    """Whether this is a pair of a least and a greatest size, both at most `most`."""
    if not isinstance(sizes, tuple | list) or len(sizes) != 2 or not all(isinstance(x, int | float) for x in sizes):
        return False
    return 0 <= sizes[0] <= sizes[1] <= most


def varied_axes(rules: VariationRules, variant: str) -> tuple[Axis, ...]:
    """The axes that `variant` varies in this task.

    Raises:
        UnknownNameError: if the variant is unknown, or this task does not have it.
    """
    if isinstance(variant, str) and variant in rules.variants:
        return rules.variants[variant]
    every = VARIANTS | OTHER_VARIANTS
    check_name("variant", variant, every)
    missing = [axis for axis in every[variant] if axis not in rules.supported_axes]
    if missing == ["diagnose"]:
        raise UnknownNameError(f"{rules.name} has no variant 'Diagnose', which only intents have. See docs/intents.md")
    raise UnknownNameError(
        f"{rules.name} has no variant {variant!r}, because its {' and '.join(missing)} cannot vary. "
        f"It has: {', '.join(rules.variants)}"
    )


def vary(rules: VariationRules, variant: str, seed: int, body: str = GRIPPER) -> Scene:
    """The initial scene of a task's variant for a seed, with this body of the robot.

    Each axis has its own random generator, so that adding a draw to one axis never changes another. If the task does
    not accept the scene, all axes are drawn again. `varied_axes` checks the variant, and `check_seed` the seed.

    Raises:
        PlacementError: if no legal placement was found.
        TaskError: if a rule of the task does not return a scene.
    """
    axes = rules.variants[variant]
    demo = rules.demo if axes else rules.demos[seed % len(rules.demos)]
    if body != demo.robot.body:
        demo = replace(demo, robot=replace(demo.robot, body=body))
        if "layout" not in axes:
            demo = with_room(demo)
    if not axes:
        return demo
    rngs: dict[Axis, np.random.Generator] = {axis: axis_generator(rules.name, axis, seed) for axis in axes}
    for _ in range(MAX_REDRAWS):
        scene = _varied(rules, demo, rngs, seed)
        if rules.accepts is None or rules.accepts(scene):
            return scene
    raise PlacementError(f"none of {MAX_REDRAWS} scenes of {rules.name}-{variant} with seed {seed} is a good start")


def _varied(rules: VariationRules, scene: Scene, rngs: Mapping[Axis, np.random.Generator], seed: int) -> Scene:
    """The demo scene with new draws of some axes.

    Dynamics are drawn first, since a task's rules may change them. Counts follow, because the other axes depend on
    them. Poses are drawn last.
    """
    dynamics = draw_dynamics(rngs["dynamics"], rules.drive_forces) if "dynamics" in rngs else None
    if dynamics is not None:
        scene = replace(scene, dynamics=dynamics)
    for axis in ("count", "colour"):
        if axis in rngs:
            scene = _draw(rules, axis, rngs[axis], scene)
    if "shape" in rngs:
        draw_shapes = _draw if "jitter" in rngs or "layout" in rngs else _draw_until_it_fits
        scene = draw_shapes(rules, "shape", rngs["shape"], scene)
    if dynamics is not None and scene.dynamics == rules.demo.dynamics:
        scene = replace(scene, dynamics=dynamics)  # a rule that makes a new scene loses them
    if "diagnose" in rngs:
        return _draw(rules, "diagnose", rngs["diagnose"], scene, seed)
    if "jitter" in rngs:
        scene = jitter(scene, rngs["jitter"], rules.region_size)
    if "layout" in rngs:
        if callable(rules.layout):
            return _draw(rules, "layout", rngs["layout"], scene)
        scene = layout(scene, rngs["layout"], rules.region_size, rules.inner_margin)
    return scene


def draw_dynamics(rng: np.random.Generator, drive_forces: tuple[float, float]) -> Dynamics:
    """Five independent uniform draws. All blocks have the same values."""
    ranges = {"drive_force": drive_forces, **DYNAMICS_RANGES}
    return Dynamics(**{name: low + (high - low) * rng.random() for name, (low, high) in ranges.items()})


def _draw(rules: VariationRules, axis: Axis, rng: np.random.Generator, scene: Scene, *seed: int) -> Scene:
    """The scene that the task's rule for this axis returns."""
    drawn: Any = getattr(rules, axis)(rng, scene, *seed)
    if not isinstance(drawn, Scene):
        raise TaskError(f"{rules.name}.{axis} must return a magical_mj.Scene, not {short_repr(drawn)}")
    return drawn


def _draw_until_it_fits(rules: VariationRules, axis: Axis, rng: np.random.Generator, scene: Scene) -> Scene:
    """The scene with shapes drawn by the rule, repeatedly until all fit at the blocks' poses.

    If poses stay as in the demo, some shapes overlap a neighbour or a wall: in ClusterColour, two neighbouring stars
    do. So the shapes are uniform over the draws without contact.
    """
    if touching := contact(scene):  # the demo scene itself must fit
        raise PlacementError(f"in the demo scene of {rules.name}, {touching}: move them apart, so that shapes can vary")
    for _ in range(MAX_SHAPE_DRAWS):
        drawn = _draw(rules, axis, rng, scene)
        touching = contact(drawn)
        if touching is None:
            return drawn
    raise PlacementError(
        f"none of {MAX_SHAPE_DRAWS} draws of shapes fits the poses of the demo scene; in the last, {touching}. "
        "Move these two further apart in the demo scene"
    )


def check_seed(seed: Any) -> int:
    """`seed` as an int.

    Raises:
        InvalidSeedError: if it is not an integer, or negative.
    """
    number = as_integer(seed)
    if number is None:
        raise InvalidSeedError(f"{short_repr(seed)} is not a seed: seeds are integers from 0, of any size")
    return number


def axis_generator(task: str, axis: Axis, seed: int) -> np.random.Generator:
    """The random generator of one axis of one task. It is independent of those of other axes and tasks.

    The bit generator is named explicitly, since later versions of numpy may change that of `default_rng`.
    """
    child = np.random.SeedSequence(seed, spawn_key=(zlib.crc32(task.encode()), AXES.index(axis)))
    return np.random.Generator(np.random.PCG64(child))
