"""From a task's demo scene to the scenes of its variants: pure, and the same on every machine."""

from __future__ import annotations

import operator
from dataclasses import replace
from typing import Any

import numpy as np

from magical_mj.errors import InvalidSeedError
from magical_mj.scene import Scene
from magical_mj.tasks.spec import TaskSpec
from magical_mj.variants.axes import AXES, Axis, varied_axes
from magical_mj.variants.dynamics import draw_dynamics
from magical_mj.variants.placement import jitter, layout


def vary(spec: TaskSpec, variant: str, seed: int) -> Scene:
    """The scene in which `variant` of the task starts, for a seed of any size.

    Each axis draws from a random generator of its own, so that a draw added to one never moves another.
    Counts come first, since the other axes draw for what there is, and poses last.

    Raises:
        UnknownNameError: if the task has no such variant.
        InvalidSeedError: if the seed is not an integer, or negative.
        PlacementError: if no legal placement was found.
    """
    seed = check_seed(seed)
    rngs = {axis: _generator(seed, axis) for axis in varied_axes(spec, variant)}
    scene = spec.demo
    for axis, rule in (("count", spec.count), ("colour", spec.colour), ("shape", spec.shape)):
        if rule is not None and axis in rngs:
            scene = rule(rngs[axis], scene)
    if "dynamics" in rngs:
        scene = replace(scene, dynamics=draw_dynamics(rngs["dynamics"]))
    if "jitter" in rngs:
        scene = jitter(spec, scene, rngs["jitter"])
    if "layout" in rngs:
        scene = layout(spec, scene, rngs["layout"])
    return scene


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
        raise InvalidSeedError(f"{seed!r} is not a seed: seeds are the integers from 0 up, of any size")
    return number


def _generator(seed: int, axis: Axis) -> np.random.Generator:
    """The axis's own generator: that of child ``AXES.index(axis)`` of ``SeedSequence(seed)``.

    The bit generator is named, for `default_rng` may choose another one in a later numpy.
    """
    child = np.random.SeedSequence(seed, spawn_key=(AXES.index(axis),))
    return np.random.Generator(np.random.PCG64(child))
