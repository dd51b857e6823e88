"""From a task's demo scene to the scenes of its variants: pure, and the same on every machine."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from magical_mj.scene import Dynamics, Scene
from magical_mj.scene.bodies import GRIPPER
from magical_mj.utils.errors import InvalidSeedError, PlacementError, TaskError, as_integer, short_repr
from magical_mj.variants.placement import contact, jitter, layout
from magical_mj.variants.rules import AXES, Axis, VariationRules, varied_axes

MAX_SHAPE_DRAWS: Final = 1_000

DYNAMICS_RANGES: Final[Mapping[str, tuple[float, float]]] = MappingProxyType(
    {
        "turn_torque": (0.7, 1.5),
        "finger_torque": (2.5, 4.5),
        "block_friction_force": (1.0, 1.8),
        "block_friction_torque": (0.07, 0.15),
    }
)
"""Force or torque cap -> the range from which it is drawn, independently and uniformly, as in the released code.

The drive's force is drawn before them, from the task's range.
"""


def vary(rules: VariationRules, variant: str, seed: int, body: str = GRIPPER) -> Scene:
    """The scene in which `variant` of the task starts with this body of the robot, for a seed of any size.

    Each axis has its own random generator, so that adding a draw to one axis never changes another. Dynamics are
    drawn first, since a task's rules may change them, then counts, on which the other axes depend, and poses last.

    Raises:
        UnknownNameError: if the task has no such variant.
        InvalidSeedError: if the seed is not an integer, or negative.
        PlacementError: if no legal placement was found.
        TaskError: if a rule of the task does not return a scene.
    """
    seed = check_seed(seed)
    rngs = {axis: axis_generator(rules.name, axis, seed) for axis in varied_axes(rules, variant)}
    scene = rules.demo
    if body != scene.robot.body:
        scene = replace(scene, robot=replace(scene.robot, body=body))
    dynamics = draw_dynamics(rngs["dynamics"], rules.drive_forces) if "dynamics" in rngs else None
    if dynamics is not None:
        scene = replace(scene, dynamics=dynamics)
    if "count" in rngs:
        scene = _draw(rules, "count", rngs["count"], scene)
    if "colour" in rngs:
        scene = _draw(rules, "colour", rngs["colour"], scene)
    if "shape" in rngs:
        draw_shapes = _draw if "jitter" in rngs or "layout" in rngs else _draw_until_it_fits
        scene = draw_shapes(rules, "shape", rngs["shape"], scene)
    if dynamics is not None and scene.dynamics == rules.demo.dynamics:
        scene = replace(scene, dynamics=dynamics)  # of a scene that a rule made anew, instead of changing the given one
    if "jitter" in rngs:
        scene = jitter(rules, scene, rngs["jitter"])
    if "layout" in rngs:
        own = callable(rules.layout)
        scene = _draw(rules, "layout", rngs["layout"], scene) if own else layout(rules, scene, rngs["layout"])
    return scene


def draw_dynamics(rng: np.random.Generator, drive_forces: tuple[float, float]) -> Dynamics:
    """Five independent uniform draws; the values for blocks hold for all blocks."""
    ranges = {"drive_force": drive_forces, **DYNAMICS_RANGES}
    return Dynamics(**{name: low + (high - low) * rng.random() for name, (low, high) in ranges.items()})


def _draw(rules: VariationRules, axis: Axis, rng: np.random.Generator, scene: Scene) -> Scene:
    """The scene with what the task's rule for this axis draws."""
    drawn: Any = getattr(rules, axis)(rng, scene)
    if not isinstance(drawn, Scene):
        raise TaskError(f"{rules.name}.{axis} must return a magical_mj.Scene, not {short_repr(drawn)}")
    return drawn


def _draw_until_it_fits(rules: VariationRules, axis: Axis, rng: np.random.Generator, scene: Scene) -> Scene:
    """The scene with shapes drawn by the rule, repeatedly until all fit at the blocks' poses.

    If poses stay as in the demo, some shapes would overlap a neighbour or a wall: in ClusterColour, two
    stars side by side do. So the shapes are uniform over those that fit.
    """
    touching: str | None = None
    for _ in range(MAX_SHAPE_DRAWS):
        drawn = _draw(rules, axis, rng, scene)
        touching = contact(drawn)
        if touching is None:
            return drawn
    raise PlacementError(
        f"none of {MAX_SHAPE_DRAWS} draws of shapes fits the poses of the demo scene; in the last, {touching}. "
        "Move these further apart in it"
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
    """The random generator of one axis of one task; it is independent of those of other axes and tasks.

    The bit generator is named explicitly, since later versions of numpy may change that of `default_rng`.
    """
    child = np.random.SeedSequence(seed, spawn_key=(zlib.crc32(task.encode()), AXES.index(axis)))
    return np.random.Generator(np.random.PCG64(child))
