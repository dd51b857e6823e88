"""Relations between blocks: in a line, in groups, all together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from magical_goals.relation import LIMIT_BITS, Floats, Layouts, Relation, Situation, choice_bits, layouts_of
from magical_mj.scene import Block, Scene
from magical_mj.tasks.planning import (
    Point,
    Subgoal,
    bring,
    cluster_targets,
    each_to,
    line_targets,
    places_anywhere,
    scene_after,
)
from magical_mj.utils.errors import check_name

LINE_TOLERANCE: Final = 0.07  # world units: a block within this distance has reached its target
GROUP_TOLERANCE: Final = 0.09
ATTRIBUTES: Final = ("colour", "shape", "colour and shape")


@dataclass(frozen=True)
class InLine(Relation):
    """All blocks are in one line: near the chord between the two most distant blocks, without large gaps."""

    measures = 2

    @property
    def bits(self) -> float:
        """The bits of two limits."""
        return self.measures * LIMIT_BITS

    def deviations(self, layouts: Layouts) -> Floats:
        """Distances from the chord, and from the previous block along it."""
        positions = layouts.blocks
        count, blocks, _ = positions.shape
        apart = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=3).reshape(count, -1)
        ends = np.stack(np.divmod(apart.argmax(axis=1), blocks), axis=1)
        one, other = (np.take_along_axis(positions, end[:, None, None], axis=1) for end in ends.T)
        chord = (other - one)[:, 0]
        chord /= np.maximum(np.linalg.norm(chord, axis=1, keepdims=True), 1e-9)
        along = np.einsum("nbi,ni->nb", positions - one, chord)
        aside = np.abs(np.einsum("nbi,ni->nb", positions - one, np.stack([-chord[:, 1], chord[:, 0]], axis=1)))
        order = along.argsort(axis=1)
        ranked = np.take_along_axis(along, order, axis=1)
        gaps, before = np.zeros_like(ranked), np.zeros_like(ranked)
        gaps[:, 1:] = ranked[:, 1:] - ranked[:, :-1]
        np.put_along_axis(before, order, gaps, axis=1)
        return np.stack([aside, before], axis=2)

    def subgoals(self, at: Situation) -> list[Subgoal]:
        """Moves the blocks to a line through one of them, which stays."""

        def are_lines(blocks: Floats) -> Any:
            layouts = Layouts(at.initial, np.zeros((len(blocks), 2)), blocks)
            return (self.deviations(layouts) <= at.limits).all(axis=(1, 2))

        return each_to(line_targets(_points(at.now), are_lines, at.noise, at.stuck), LINE_TOLERANCE)

    @property
    def text(self) -> str:
        """The text is constant except for the limits."""
        return "all blocks are in a line, at most {0:.2f} aside and {1:.2f} apart"


@dataclass(frozen=True)
class Grouped(Relation):
    """Blocks are near others with the same attribute.

    The deviation is the distance to the own group's centroid, divided by that to the nearest other group's centroid.

    Attributes:
        attribute: one of `ATTRIBUTES`.
    """

    attribute: str

    def __post_init__(self) -> None:
        """Raises an `UnknownNameError` for an unknown attribute."""
        check_name("attribute", self.attribute, ATTRIBUTES)

    @property
    def bits(self) -> float:
        """The bits of the attribute and the limit."""
        return choice_bits(len(ATTRIBUTES)) + LIMIT_BITS

    def deviations(self, layouts: Layouts) -> Floats:
        """Ratios of distances to centroids. 0 if there is only one group."""
        kinds = self._kinds(layouts.initial.blocks)
        members = np.array([[kind == value for kind in kinds] for value in sorted(set(kinds))], float)
        middles = members @ layouts.blocks / members.sum(axis=1, keepdims=True)
        distances = np.linalg.norm(layouts.blocks[:, :, None] - middles[:, None], axis=3)  # (n, block, kind)
        own = (distances * members.T).sum(axis=2)
        others = np.where(members.T > 0, np.inf, distances).min(axis=2)
        return (own / np.maximum(others, 1e-9))[..., None]

    def subgoals(self, at: Situation) -> list[Subgoal]:
        """Moves blocks to others of their group, as few as possible."""
        kinds, nearer = self._kinds(at.now.blocks), max(at.limits[0], 1e-3) ** -2
        targets = cluster_targets(_points(at.now), kinds, nearer, at.noise, at.stuck)
        return each_to(targets, GROUP_TOLERANCE)

    @property
    def text(self) -> str:
        """Such as "blocks are grouped by shape, ..."."""
        return f"blocks are grouped by {self.attribute}, {{0:.2f}} times as far from their own group as from any other"

    def _kinds(self, blocks: Sequence[Block]) -> list[str]:
        if self.attribute == "colour and shape":
            return [f"{block.colour} {block.shape}" for block in blocks]
        return [getattr(block, self.attribute) for block in blocks]


@dataclass(frozen=True)
class Together(Relation):
    """All blocks are near each other. The deviation is the distance from the centroid of all."""

    @property
    def bits(self) -> float:
        """The bits of the limit."""
        return LIMIT_BITS

    def deviations(self, layouts: Layouts) -> Floats:
        """Distances from the centroid."""
        return np.linalg.norm(layouts.blocks - layouts.blocks.mean(axis=1, keepdims=True), axis=2, keepdims=True)

    def subgoals(self, at: Situation) -> list[Subgoal]:
        """Moves blocks that are too far away to the nearest free position within half the limit."""
        middle = np.mean(_points(at.now), axis=0)
        near = [position for position in places_anywhere() if np.linalg.norm(position - middle) <= at.limits[0] / 2]
        todo: list[Subgoal] = []
        for number, off in enumerate(self.deviations(layouts_of(at.initial, [at.now]))[0, :, 0]):
            if off > at.limits[0]:
                todo.append(
                    bring(scene_after(at.now, todo), number, near or [(float(middle[0]), float(middle[1]))], at.noise)
                )
        return todo

    @property
    def text(self) -> str:
        """The text is constant except for the limit."""
        return "all blocks are together, within {0:.2f} of their middle"


def _points(scene: Scene) -> list[Point]:
    return [(block.x, block.y) for block in scene.blocks]
