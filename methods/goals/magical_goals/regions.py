"""Relations to regions and landmarks: the region of each block, the robot's region, and distances from landmarks.

A formula assigns blocks to regions. It is a conjunction of literals about a block and a region at the start of the
episode. At the end, the block should be in the region if the formula is true, and outside if it is not.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_goals.relation import LIMIT_BITS, Floats, Layouts, Relation, Situation, choice_bits
from magical_mj.scene import Block, GoalRegion, Scene
from magical_mj.scene.constants import COLOURS, SHAPES, Colour, Shape
from magical_mj.tasks.planning import (
    TOLERANCE,
    Subgoal,
    bring,
    drive,
    places_anywhere,
    places_inside,
    places_outside,
    scene_after,
)
from magical_mj.utils.errors import check_name

Predicate = Callable[[Block, GoalRegion, Iterable[Block]], bool]
"""A function of a block, a region, and the blocks that started in the region."""

RELATIVE: Final[Mapping[str, Predicate]] = MappingProxyType(
    {
        "has the region's colour": lambda block, region, _: block.colour == region.colour,
        "began in the region": lambda block, region, _: region.contains(block),
        "has the shape of a block that began there": lambda block, _, there: block.shape in {b.shape for b in there},
        "has the colour of a block that began there": lambda block, _, there: block.colour in {b.colour for b in there},
    }
)
"""Predicates that compare a block with a region."""


def _is(colour: Colour) -> Predicate:
    return lambda block, *_: block.colour == colour


def _has(shape: Shape) -> Predicate:
    return lambda block, *_: block.shape == shape


def _at(colour: Colour) -> Predicate:
    return lambda _, region, *__: region.colour == colour


ABSOLUTE: Final[Mapping[str, Predicate]] = MappingProxyType(
    {f"is {colour}": _is(colour) for colour in COLOURS}
    | {f"is a {shape}": _has(shape) for shape in SHAPES}
    | {f"is at a {colour} region": _at(colour) for colour in COLOURS}
)
"""Predicates with one of four colours or shapes, which costs two more bits."""

PREDICATES: Final = {**RELATIVE, **ABSOLUTE}
KINDS: Final = len(RELATIVE) + 3
LITERALS: Final = 3
"""The largest number of literals in a formula."""

Literal = tuple[str, bool]
"""A predicate's name, and its required truth value."""


@dataclass(frozen=True)
class Belonging(Relation):
    """A block is in a region if and only if the formula is true for them.

    Attributes:
        formula: the literals that must all be true.
    """

    formula: tuple[Literal, ...]

    def __post_init__(self) -> None:
        """Raises an `UnknownNameError` for unknown predicates."""
        for name, _ in self.formula:
            check_name("predicate", name, PREDICATES)

    @property
    def bits(self) -> float:
        """For each literal: the bits of the predicate's kind, its negation, and its colour or shape if it has one."""
        return LIMIT_BITS + sum(
            choice_bits(KINDS) + 1 + choice_bits(4) * (name in ABSOLUTE) for name, _ in self.formula
        )

    def wanted(self, initial: Scene) -> NDArray[np.bool_]:
        """Whether each block should be in each region. Shape (blocks, regions)."""
        wanted = np.ones((len(initial.blocks), len(initial.regions)), dtype=bool)
        for column, region in enumerate(initial.regions):
            there = [block for block in initial.blocks if region.contains(block)]
            for row, block in enumerate(initial.blocks):
                wanted[row, column] = all(PREDICATES[name](block, region, there) == true for name, true in self.formula)
        return wanted

    def deviations(self, layouts: Layouts) -> Floats:
        """For each block, the number of regions that wrongly contain it, or wrongly do not."""
        wrong = _inside(layouts.blocks, layouts.initial) != self.wanted(layouts.initial)
        return wrong.sum(axis=2, keepdims=True).astype(float)

    def subgoals(self, at: Situation) -> list[Subgoal]:
        """Moves blocks to free positions in their regions, or out of all regions."""
        todo: list[Subgoal] = []
        scene, regions = at.now, at.now.regions
        for number, wanted in enumerate(self.wanted(at.initial)):
            block = at.now.blocks[number]
            if all(region.contains(block) == wants for region, wants in zip(regions, wanted, strict=True)):
                continue
            own = [region for region, wants in zip(regions, wanted, strict=True) if wants]
            positions = places_inside(own[0]) if own else places_outside(regions)
            todo.append(bring(scene, number, positions, at.noise))
            scene = scene_after(scene, todo[-1:])
        return todo

    @property
    def text(self) -> str:
        """Such as "a block is in a region if and only if it is red"."""
        conditions = " and ".join(f"it {'' if true else 'not '}{name}" for name, true in self.formula)
        return f"a block is in a region if and only if {conditions}"


def _inside(positions: Floats, initial: Scene) -> NDArray[np.bool_]:
    """Whether each position, shape (n, bodies, 2), is in each region. Shape (n, bodies, regions)."""
    lower = np.array([(region.x_min, region.y_min) for region in initial.regions]).reshape(-1, 2)
    upper = np.array([(region.x_max, region.y_max) for region in initial.regions]).reshape(-1, 2)
    at = positions[:, :, None]
    return np.logical_and.reduce([at >= lower, at <= upper]).all(axis=3)


@dataclass(frozen=True)
class RobotInside(Relation):
    """The robot is in a goal region."""

    @property
    def bits(self) -> float:
        """The bits of the limit."""
        return LIMIT_BITS

    def deviations(self, layouts: Layouts) -> Floats:
        """0 in a region, 1 elsewhere."""
        inside = _inside(layouts.robot[:, None], layouts.initial)
        return 1.0 - inside.any(axis=2, keepdims=True).astype(float)

    def subgoals(self, at: Situation) -> list[Subgoal]:
        """Drives to the nearest position in a region."""
        positions = [position for region in at.now.regions for position in places_inside(region)]
        return [drive(at.now, positions, at.noise, tolerance=0.1)]

    @property
    def text(self) -> str:
        """A constant text."""
        return "the robot is in a region"


def formulas(scenes: Iterable[Scene]) -> Iterator[Belonging]:
    """The formulas that differ in these initial scenes. For equivalent ones, the shortest, or the first one listed."""
    scenes = list(scenes)
    literals = list(itertools.product(PREDICATES, (True, False)))
    known: dict[bytes, Belonging] = {}
    meant = {literal: [Belonging((literal,)).wanted(scene) for scene in scenes] for literal in literals}
    for count in range(1, LITERALS + 1):
        for formula in itertools.combinations(literals, count):
            wanted = [
                np.logical_and.reduce([meant[literal][number] for literal in formula]) for number in range(len(scenes))
            ]
            relation, pattern = Belonging(formula), b"".join(array.tobytes() for array in wanted)
            if pattern not in known or relation.bits < known[pattern].bits:
                known[pattern] = relation
    yield from known.values()


LANDMARKS: Final[Mapping[str, tuple[float, float]]] = MappingProxyType(
    {
        "top left corner": (-1.0, 1.0),
        "top right corner": (1.0, 1.0),
        "bottom left corner": (-1.0, -1.0),
        "bottom right corner": (1.0, -1.0),
        "middle": (0.0, 0.0),
    }
)
"""The corners and the middle of the workspace."""
WHO: Final = ("every block", "the robot")


@dataclass(frozen=True)
class Near(Relation):
    """All blocks, or the robot, are near a landmark. The deviation is the distance.

    Attributes:
        who: one of `WHO`.
        landmark: one of `LANDMARKS`.
    """

    who: str
    landmark: str

    def __post_init__(self) -> None:
        """Raises an `UnknownNameError` for an unknown subject or landmark."""
        check_name("subject", self.who, WHO)
        check_name("landmark", self.landmark, LANDMARKS)

    @property
    def bits(self) -> float:
        """The bits of the subject, the landmark and the limit."""
        return choice_bits(len(WHO)) + choice_bits(len(LANDMARKS)) + LIMIT_BITS

    def deviations(self, layouts: Layouts) -> Floats:
        """Distances from the landmark."""
        who = layouts.robot[:, None] if self.who == "the robot" else layouts.blocks
        return np.linalg.norm(who - LANDMARKS[self.landmark], axis=2, keepdims=True)

    def subgoals(self, at: Situation) -> list[Subgoal]:
        """Moves blocks, or the robot, that are too far away to the nearest position within the limit, less a margin."""
        landmark = LANDMARKS[self.landmark]
        positions = sorted(places_anywhere(), key=lambda position: math.dist(position, landmark))
        positions = [
            position for position in positions if math.dist(position, landmark) <= at.limits[0] - TOLERANCE
        ] or positions[:1]
        if self.who == "the robot":
            return [drive(at.now, positions, at.noise, TOLERANCE)]
        todo: list[Subgoal] = []
        for number, block in enumerate(at.now.blocks):
            if math.dist((block.x, block.y), landmark) > at.limits[0]:
                todo.append(bring(scene_after(at.now, todo), number, positions, at.noise))
        return todo

    @property
    def text(self) -> str:
        """Such as "the robot is within 0.50 of the middle"."""
        return f"{self.who} is within {{0:.2f}} of the {self.landmark}"
