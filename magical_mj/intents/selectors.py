"""Selectors: which blocks a relation applies to. They are evaluated in the initial scene.

A selector is a conjunction of tests. Without tests, it selects all blocks. The tests, as a text writes them:

- ``colour=red``, ``shape!=star``: an attribute. ``colour=region`` is the colour of the region, if there is just one.
- ``like=colour``, ``like=shape``, ``like=both``: the same attributes as the block that starts in the region. This block
  itself passes neither the test nor its negation.
- ``starts=in``, ``starts=out``: in a region, or outside all regions. ``starts=matched``, ``starts=mismatched``: in a
  region of the block's own colour, or of another.
- ``odd=colour``, ``odd=shape``: the only block with its value of the attribute, if all others have one other value.
- ``nearest=red star``, ``farthest=region``: one block by its distance to a reference, which is the only block with this
  colour, shape or both, the only region, or the robot.
- ``others``, alone: the blocks that no other conjunct of the intent names.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from magical_mj.scene import Block, GoalRegion, Scene
from magical_mj.scene.constants import COLOURS, SHAPES

TIE: Final = 0.05
"""If two distances differ by less (world units), it is undefined which block is nearer."""
ODD_LEAST: Final = 3
"""The least number of blocks for the tests ``odd``."""
REGION: Final = "region"
ROBOT: Final = "robot"
OTHERS: Final = "others"

REFERENCES: Final = (REGION, ROBOT, *COLOURS, *SHAPES, *(f"{colour} {shape}" for colour in COLOURS for shape in SHAPES))
"""The references of ``nearest``, ``farthest`` and the relations ``near``."""
VALUES: Final[dict[str, tuple[str, ...]]] = {
    "colour": (*COLOURS, REGION),
    "shape": SHAPES,
    "like": ("colour", "shape", "both"),
    "starts": ("in", "out", "matched", "mismatched"),
    "odd": ("colour", "shape"),
    "nearest": REFERENCES,
    "farthest": REFERENCES,
}
"""Name of a test -> its values."""
NEGATABLE: Final = ("colour", "shape", "like")
PAIRS: Final = (("colour", "shape"), ("shape", "starts"), ("colour", "starts"))
"""The tests that can be combined, in this order."""


class UngroundedError(Exception):
    """A selector or relation is undefined in this scene, such as "the nearest to the star" without a star."""


class Test(NamedTuple):
    """One test of a selector."""

    name: str
    value: str
    equal: bool = True

    def __str__(self) -> str:
        return f"{self.name}{'=' if self.equal else '!='}{self.value}"


Selector = tuple[Test, ...]
ALL: Final[Selector] = ()
REST: Final[Selector] = (Test(OTHERS, ""),)
"""The selector ``others``."""


def names_one(selector: Selector) -> bool:
    """Whether a selector always selects a single block, by its form."""
    return bool(selector) and selector[0].name in ("odd", "nearest", "farthest")


def text_of(selector: Selector) -> str:
    """The text of a selector, which `parse` reads."""
    return OTHERS if selector == REST else ", ".join(map(str, selector)) or "all"


def selected(selector: Selector, scene: Scene) -> tuple[int, ...]:
    """The indices of the blocks that the selector selects in an initial scene, in ascending order.

    Raises:
        UngroundedError: if it is undefined there.
    """
    chosen = range(len(scene.blocks))
    for test in selector:
        passing = _passing(test, scene)
        chosen = [index for index in chosen if index in passing]
    return tuple(chosen)


def the_region(scene: Scene) -> GoalRegion:
    """The only region; raises an `UngroundedError` if there are none or several."""
    if len(scene.regions) != 1:
        raise UngroundedError(f"the scene has {len(scene.regions)} regions")
    return scene.regions[0]


def block_of(reference: str, scene: Scene) -> int:
    """The index of the block that a reference names; raises an `UngroundedError` if it is not unique."""
    words = set(reference.split())
    found = [index for index, block in enumerate(scene.blocks) if words <= {block.colour, block.shape}]
    if len(found) != 1:
        raise UngroundedError(f"{len(found)} blocks are a {reference}")
    return found[0]


def homes(scene: Scene) -> list[int | None]:
    """For each block the first region that contains its centre, or None."""
    return [
        next((number for number, region in enumerate(scene.regions) if region.contains(block)), None)
        for block in scene.blocks
    ]


def _passing(test: Test, scene: Scene) -> set[int]:
    """The blocks that pass a test."""
    name, value, equal = test
    blocks = scene.blocks
    if name in ("colour", "shape"):
        wanted = the_region(scene).colour if value == REGION else value
        return {index for index, block in enumerate(blocks) if (getattr(block, name) == wanted) == equal}
    if name == "like":
        return _alike(value, equal, scene)
    if name == "starts":
        if not scene.regions:
            raise UngroundedError("the scene has no region")
        return {index for index, home in enumerate(homes(scene)) if _starts(value, home, blocks[index], scene)}
    if name == "odd":
        return {_odd([getattr(block, value) for block in blocks])}
    return {_extreme(scene, value, 1.0 if name == "nearest" else -1.0)}


def _alike(value: str, equal: bool, scene: Scene) -> set[int]:
    region = the_region(scene)
    inner = [index for index, block in enumerate(scene.blocks) if region.contains(block)]
    if len(inner) != 1:
        raise UngroundedError(f"{len(inner)} blocks start in the region")
    attributes = ("colour", "shape") if value == "both" else (value,)
    model = scene.blocks[inner[0]]
    return {
        index
        for index, block in enumerate(scene.blocks)
        if index != inner[0] and all(getattr(block, name) == getattr(model, name) for name in attributes) == equal
    }


def _starts(value: str, home: int | None, block: Block, scene: Scene) -> bool:
    if value in ("in", "out"):
        return (home is not None) == (value == "in")
    return home is not None and (scene.regions[home].colour == block.colour) == (value == "matched")


def _odd(values: Sequence[str]) -> int:
    lone = [index for index, value in enumerate(values) if values.count(value) == 1]
    if len(values) < ODD_LEAST or len(lone) != 1 or len(set(values)) != 2:
        raise UngroundedError("no block is the odd one out")
    return lone[0]


def _extreme(scene: Scene, reference: str, sign: float) -> int:
    """The nearest block to a reference (sign 1), or the farthest (-1)."""
    itself = None
    if reference == ROBOT:
        x, y = scene.robot.x, scene.robot.y
    elif reference == REGION:
        x, y = the_region(scene).centre
    else:
        itself = block_of(reference, scene)
        x, y, _ = scene.blocks[itself].pose
    ways = sorted(
        (sign * math.hypot(block.x - x, block.y - y), index)
        for index, block in enumerate(scene.blocks)
        if index != itself
    )
    if len(ways) < 2 or ways[1][0] - ways[0][0] < TIE:
        raise UngroundedError(f"two blocks are about equally far from the {reference}")
    return ways[0][1]
