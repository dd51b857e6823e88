"""Functions for task modules: drawing colours and shapes, and checking scenes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final, Literal, TypeVar

import numpy as np

from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.scene.constants import ARENA_HALF_WIDTH, BLOCK_SIZE, COLOURS, SHAPES, Colour, Shape
from magical_mj.utils.errors import InvalidSceneError

_T = TypeVar("_T")


def uniform_integer(rng: np.random.Generator, low: int, high: int) -> int:
    """A uniform integer from `low` to `high`, both included.

    It uses only `Generator.random`, because numpy may change the algorithms of its other draws. The scenes of a seed
    must never change.
    """
    return low + int((high - low + 1) * rng.random())


def pick(rng: np.random.Generator, options: Sequence[_T]) -> _T:
    """One of the options, all equally likely."""
    return options[uniform_integer(rng, 0, len(options) - 1)]


def pick_each(rng: np.random.Generator, options: Sequence[_T], number: int) -> list[_T]:
    """`number` independent uniform picks; repeats are allowed."""
    return [pick(rng, options) for _ in range(number)]


def shuffled(rng: np.random.Generator, items: Sequence[_T]) -> list[_T]:
    """The items in random order, all orders equally likely."""
    keys = [rng.random() for _ in items]
    return [items[index] for index in sorted(range(len(items)), key=keys.__getitem__)]


def coloured(scene: Scene, colours: Iterable[Colour]) -> Scene:
    """The scene with other block colours, one per block."""
    blocks = (replace(block, colour=colour) for block, colour in zip(scene.blocks, colours, strict=True))
    return replace(scene, blocks=tuple(blocks))


def shaped(scene: Scene, shapes: Iterable[Shape]) -> Scene:
    """The scene with other block shapes, one per block."""
    blocks = (replace(block, shape=shape) for block, shape in zip(scene.blocks, shapes, strict=True))
    return replace(scene, blocks=tuple(blocks))


def any_colours(rng: np.random.Generator, scene: Scene) -> Scene:
    """Axis rule: every block gets an independent uniform colour."""
    return coloured(scene, pick_each(rng, COLOURS, len(scene.blocks)))


def any_shapes(rng: np.random.Generator, scene: Scene) -> Scene:
    """Axis rule: every block gets an independent uniform shape."""
    return shaped(scene, pick_each(rng, SHAPES, len(scene.blocks)))


def inside(region: GoalRegion, blocks: Iterable[Block]) -> list[int]:
    """Indices of the blocks whose centre is in the region, borders included."""
    return [index for index, block in enumerate(blocks) if region.contains(block)]


WRONG: Final = 0.3
"""The constant that each wrong object adds to the remaining distance, so that crossing a border counts."""


def way_in(region: GoalRegion, item: Robot | Block) -> float:
    """The distance of a centre from the region, plus `WRONG`; 0 if it is in the region."""
    if region.contains(item):
        return 0.0
    dx = max(region.x_min - item.x, item.x - region.x_max, 0.0)
    dy = max(region.y_min - item.y, item.y - region.y_max, 0.0)
    return WRONG + math.hypot(dx, dy)


def way_out(region: GoalRegion, item: Robot | Block, half_width: float = ARENA_HALF_WIDTH) -> float:
    """The distance of a block's centre from the region's nearest side, plus `WRONG`; 0 if it is not in the region.

    Sides count if there is room for a block between them and the wall, at `half_width`.
    """
    if not region.contains(item):
        return 0.0
    room = half_width - BLOCK_SIZE
    sides = (
        (item.x - region.x_min, -region.x_min),
        (region.x_max - item.x, region.x_max),
        (item.y - region.y_min, -region.y_min),
        (region.y_max - item.y, region.y_max),
    )
    return WRONG + min([away for away, side in sides if side < room] or [away for away, _ in sides])


def require(condition: bool, task: str, need: str) -> None:
    """Raises an `InvalidSceneError` unless the condition holds.

    Args:
        condition: a condition on scenes of the task.
        task: the task's name.
        need: the requirement, and what the scene has instead. The message ends with it: "... it needs <need>".
    """
    if not condition:
        raise InvalidSceneError(f"this is not a scene of {task}: it needs {need}")


def require_regions(scene: Scene, task: str, number: Literal[0, 1]) -> None:
    """Raises an `InvalidSceneError` unless the scene has exactly `number` goal regions."""
    wanted = "exactly one goal region" if number else "no goal regions"
    require(len(scene.regions) == number, task, f"{wanted}, but this has {len(scene.regions)}")
