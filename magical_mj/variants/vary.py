"""From a task's demo scene to the scenes of its variants: pure, and the same on every machine."""

from __future__ import annotations

import operator
import zlib
from dataclasses import replace
from typing import Any, Final

import numpy as np

from magical_mj.scene import Scene
from magical_mj.tasks.spec import TaskSpec
from magical_mj.utils.errors import InvalidSeedError, PlacementError, TaskError, shown
from magical_mj.variants.axes import AXES, Axis, varied_axes
from magical_mj.variants.dynamics import draw_dynamics
from magical_mj.variants.placement import contact, jitter, layout

MAX_SHAPE_DRAWS: Final = 1_000


def vary(spec: TaskSpec, variant: str, seed: int) -> Scene:
    """The scene in which `variant` of the task starts, for a seed of any size.

    Each axis has its own random generator, so that adding a draw to one axis never changes another. Dynamics are
    drawn first, since a task's rules may change them, then counts, on which the other axes depend, and poses last.

    Raises:
        UnknownNameError: if the task has no such variant.
        InvalidSeedError: if the seed is not an integer, or negative.
        PlacementError: if no legal placement was found.
        TaskError: if a rule of the task does not return a scene.
    """
    seed = check_seed(seed)
    rngs = {axis: _generator(spec.name, axis, seed) for axis in varied_axes(spec, variant)}
    scene = spec.demo
    dynamics = draw_dynamics(rngs["dynamics"]) if "dynamics" in rngs else None
    if dynamics is not None:
        scene = replace(scene, dynamics=dynamics)
    if "count" in rngs:
        scene = _draw(spec, "count", rngs["count"], scene)
    if "colour" in rngs:
        scene = _draw(spec, "colour", rngs["colour"], scene)
    if "shape" in rngs:
        draw_shapes = _draw if "jitter" in rngs or "layout" in rngs else _draw_until_it_fits
        scene = draw_shapes(spec, "shape", rngs["shape"], scene)
    if dynamics is not None and scene.dynamics == spec.demo.dynamics:
        scene = replace(scene, dynamics=dynamics)  # of a scene that a rule made anew, instead of changing the given one
    if "jitter" in rngs:
        scene = jitter(spec, scene, rngs["jitter"])
    if "layout" in rngs:
        scene = layout(spec, scene, rngs["layout"])
    return scene


def _draw(spec: TaskSpec, axis: Axis, rng: np.random.Generator, scene: Scene) -> Scene:
    """The scene with what the task's rule for this axis draws."""
    drawn: Any = getattr(spec, axis)(rng, scene)
    if not isinstance(drawn, Scene):
        raise TaskError(f"{spec.name}.{axis} must return a magical_mj.Scene, not {shown(drawn)}")
    return drawn


def _draw_until_it_fits(spec: TaskSpec, axis: Axis, rng: np.random.Generator, scene: Scene) -> Scene:
    """The scene with shapes drawn by the rule, repeatedly until all fit at the blocks' poses.

    If poses stay as in the demo, some shapes would overlap a neighbour or a wall: in ClusterColour, two
    stars side by side do. So the shapes are uniform over those that fit.
    """
    found: str | None = None
    for _ in range(MAX_SHAPE_DRAWS):
        drawn = _draw(spec, axis, rng, scene)
        found = contact(drawn)
        if found is None:
            return drawn
    raise PlacementError(
        f"none of {MAX_SHAPE_DRAWS} draws of shapes fits the poses of the demo scene; in the last, {found}. "
        "Move these further apart in it"
    )


def check_seed(seed: Any) -> int:
    """`seed` as an int.

    Raises:
        InvalidSeedError: if it is not an integer, or negative.
    """
    try:
        number = -1 if isinstance(seed, bool | np.bool_) else operator.index(seed)
    except TypeError:
        number = -1
    if number < 0:
        raise InvalidSeedError(f"{shown(seed)} is not a seed: seeds are integers from 0, of any size")
    return number


def _generator(task: str, axis: Axis, seed: int) -> np.random.Generator:
    """The random generator of one axis of one task; it is independent of those of other axes and tasks.

    The bit generator is named explicitly, since later versions of numpy may change that of `default_rng`.
    """
    child = np.random.SeedSequence(seed, spawn_key=(zlib.crc32(task.encode()), AXES.index(axis)))
    return np.random.Generator(np.random.PCG64(child))
