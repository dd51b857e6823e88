"""The common rules of ClusterColour and ClusterShape: blocks in clusters by one of their attributes.

Score
    Every value of the attribute (colour or shape) that occurs has a centroid, the mean position of its
    blocks. A block is right if its squared distance to its own centroid is less than a third of its squared
    distance to the nearest other centroid. The score is 0 if at most half of the blocks are right. Above
    that, it rises linearly, to 1 if all are right.

    With this rule, a policy can score without acting: in the ClusterShape demo, 5 of 8 blocks are right at the
    start, a score of 0.25 (ClusterColour: 4 of 8, a score of 0).

Remaining distance
    Let d be a block's distance to its own centroid, and D its distance to the nearest other one. Each block that is
    not right adds sqrt(3) d - D + 0.3; by the released code's rules, d + 2 d^2 - D + 0.3. At most 5.2 for each block
    (released: 19.1).

Differences from the original
    The released code has its own rule, ramp and horizon (rules="released"). A block is right if d < D - 2 d^2,
    with d and D as above. The score is 0 if at most three quarters of the blocks are right. Episodes have 240 steps
    instead of 320.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Final, Literal, TypeVar

import numpy as np

from magical_mj.scene import Block, Scene
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.tasks.planning import Noise, Subgoal, cluster_targets, each_to
from magical_mj.tasks.rules import (
    WRONG,
    coloured,
    pick_each,
    require,
    require_regions,
    shaped,
    shuffled,
    uniform_integer,
)
from magical_mj.tasks.spec import Measure, Rules, TaskSpec

Attribute = Literal["colour", "shape"]
_T = TypeVar("_T")

STEPS: Final = 320
RELEASED_STEPS: Final = 240
MIN_BLOCKS: Final = 7
MAX_BLOCKS: Final = 10
# for right blocks, the ratio of the squared distances to the nearest other centroid and to their own exceeds this
NEARER: Final = 3
ZERO_SCORE_SHARE: Final[Mapping[Rules, float]] = MappingProxyType({"paper": 0.5, "released": 0.75})
"""The largest share of right blocks with score 0."""


def _covering(rng: np.random.Generator, values: tuple[_T, ...], number: int) -> list[_T]:
    """Each value at least once, all others independent and uniform, in random order. Length `number`."""
    return shuffled(rng, [*values, *pick_each(rng, values, number - len(values))])


def colour(rng: np.random.Generator, scene: Scene) -> Scene:
    """Uniform colours, with at least one block of each."""
    return coloured(scene, _covering(rng, COLOURS, len(scene.blocks)))


def shape(rng: np.random.Generator, scene: Scene) -> Scene:
    """Uniform shapes, with at least one block of each."""
    return shaped(scene, _covering(rng, SHAPES, len(scene.blocks)))


def count(rng: np.random.Generator, scene: Scene) -> Scene:
    """7 to 10 blocks: the demo's without the last one, or with some of them duplicated."""
    return replace(scene, blocks=(scene.blocks * 2)[: uniform_integer(rng, MIN_BLOCKS, MAX_BLOCKS)])


def check(scene: Scene, attribute: Attribute, task: str) -> None:
    """Raises an `InvalidSceneError` unless there are blocks of two or more values and no goal region."""
    values = len({getattr(block, attribute) for block in scene.blocks})
    require(values >= 2, task, f"blocks of at least two different {attribute}s, but this has {values}")
    require_regions(scene, task, 0)


def _centroids(scene: Scene, attribute: Attribute) -> dict[str, tuple[float, float]]:
    """Mean x and y of the blocks of each occurring value of the attribute."""
    members: dict[str, list[Block]] = {}
    for block in scene.blocks:
        members.setdefault(getattr(block, attribute), []).append(block)
    return {
        value: (sum(block.x for block in blocks) / len(blocks), sum(block.y for block in blocks) / len(blocks))
        for value, blocks in members.items()
    }


def _squares(scene: Scene, attribute: Attribute) -> Iterator[tuple[float, float]]:
    """Each block's squared distances to its own centroid and to the nearest other one."""
    centroids = _centroids(scene, attribute)
    for block in scene.blocks:
        squares = {value: (block.x - x) ** 2 + (block.y - y) ** 2 for value, (x, y) in centroids.items()}
        own = squares.pop(getattr(block, attribute))
        yield own, min(squares.values())


def right_blocks(scene: Scene, attribute: Attribute, rules: Rules = "paper") -> list[bool]:
    """For each block whether it is right: see the module's docstring."""
    return [_is_right(own, other, rules) for own, other in _squares(scene, attribute)]


def _is_right(own: float, other: float, rules: Rules) -> bool:
    """Whether a block with these squared distances is right."""
    if rules == "released":
        return math.sqrt(own) < math.sqrt(other) - 2 * own
    return own < other / NEARER


def score(final: Scene, attribute: Attribute, rules: Rules = "paper") -> float:
    """The share of right blocks above the share with score 0, scaled to [0, 1]."""
    share = sum(right_blocks(final, attribute, rules)) / len(final.blocks)
    zero_share = ZERO_SCORE_SHARE[rules]
    return max(0.0, (share - zero_share) / (1 - zero_share))


def distance(initial: Scene, final: Scene, rules: Rules = "paper", *, attribute: Attribute) -> float:
    """The remaining distance; see the module's docstring."""
    return sum(ways(final, attribute, rules))


def ways(final: Scene, attribute: Attribute, rules: Rules = "paper") -> list[float]:
    """How much each block adds to the remaining distance: 0 if it is right."""
    found = []
    for own, other in _squares(final, attribute):
        way = math.sqrt(own) + 2 * own if rules == "released" else math.sqrt(NEARER * own)
        # Rounding could make the difference negative.
        found.append(0.0 if _is_right(own, other, rules) else WRONG + max(way - math.sqrt(other), 0.0))
    return found


def plan(initial: Scene, now: Scene, noise: Noise, attribute: Attribute) -> list[Subgoal]:
    """Blocks move to others with the same value of the attribute. The plan moves few blocks over short distances."""
    kinds = [getattr(block, attribute) for block in now.blocks]
    points = [(block.x, block.y) for block in now.blocks]
    return each_to(cluster_targets(points, kinds, NEARER, noise), tolerance=0.09)


def spec(name: str, attribute: Attribute, demo: Scene, score: Measure) -> TaskSpec:
    """The task of clustering by an attribute."""
    return TaskSpec(
        name=name,
        summary=f"push the blocks into clusters by {attribute}",
        demo=demo,
        steps=STEPS,
        released_steps=RELEASED_STEPS,
        score=score,
        distance=partial(distance, attribute=attribute),
        check=partial(check, attribute=attribute, task=name),
        plan=partial(plan, attribute=attribute),
        colour=colour,
        shape=shape,
        count=count,
    )
