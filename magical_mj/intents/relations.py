"""Relations: conditions on the selected blocks, or on the robot, in the final scene.

`parts` contains for each object whether the relation holds. Relations between several blocks, such as a line, also have
one part for each block, so that a score can count how many are right.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from magical_mj.intents.selectors import (
    ALL,
    REFERENCES,
    REST,
    Selector,
    UngroundedError,
    block_of,
    homes,
    selected,
    text_of,
    the_region,
)
from magical_mj.scene import Block, Robot, Scene
from magical_mj.tasks.cluster import right_blocks
from magical_mj.tasks.make_line import longest_line
from magical_mj.tasks.move_to_corner import FULL_SCORE_DISTANCE

NEAR: Final = 0.45
"""The largest distance between centres (world units): a little more than between two blocks that touch."""
APART: Final = 0.7
"""The least distance between the centres of blocks that are apart."""
AT_WALL: Final = 0.25
"""The largest distance from a wall to the centre of a block at the wall, about two radii of a block."""
ROBOT_AT_WALL: Final = 0.3
"""The same for the robot, which is larger."""
IN_CORNER: Final = 0.6
"""The largest distance from a corner to the centre of a block in the corner. Three blocks fit."""
STAYED: Final = 0.15
"""The largest distance of an untouched block from its initial position."""
LEAST_LINE: Final = 3

WALLS: Final = {"left": (-1, 0), "right": (1, 0), "bottom": (0, -1), "top": (0, 1)}
CORNERS: Final = {"top left": (-1, 1), "top right": (1, 1), "bottom left": (-1, -1), "bottom right": (1, -1)}
ANY: Final = "any"
HOME: Final = "home"


@dataclass(frozen=True, order=True)
class Conjunct:
    """One relation with its selector and its arguments.

    Attributes:
        relation: a key of `RELATIONS`.
        selector: the blocks; not used by relations of the robot.
        argument: a region, wall, corner, reference or attribute, as the relation requires.
        number: for "exactly", the number of blocks.
        any_of: whether one of the blocks is enough.
    """

    relation: str
    selector: Selector = ALL
    argument: str = ""
    number: int = 0
    any_of: bool = False

    def __str__(self) -> str:
        parts = [str(self.number)] if self.relation == "exactly" else []
        parts += [ANY] if self.any_of else []
        parts += [text_of(self.selector)] if self.definition.of_blocks else []
        parts += [self.definition.prefix + self.argument] if self.argument else []
        return f"{self.relation}({', '.join(parts)})"

    @property
    def definition(self) -> Relation:
        """The definition of its relation."""
        return RELATIONS[self.relation]

    def parts(self, blocks: tuple[int, ...], initial: Scene, final: Scene) -> list[bool]:
        """Whether it holds, for each object that it applies to.

        Args:
            blocks: the blocks that it selects; none for relations of the robot.
            initial: the initial scene of the episode.
            final: the final scene, with the same blocks.

        Raises:
            UngroundedError: if it is undefined in the initial scene, or needs a block and selects none.
        """
        relation = self.definition
        if relation.each is not None:
            flags = relation.each(self.argument, initial, final)
            selected_flags = [flags[index] for index in blocks]
            parts = [flag for flag in selected_flags if flag is not None]
            if not parts and relation.least:
                raise UngroundedError(f"{self} is about no block")
            return [any(parts)] if self.any_of else parts
        if relation.of_blocks and len(blocks) < max(relation.least, self.number):
            raise UngroundedError(f"{self} is about {len(blocks)} blocks")
        return relation.together(self, blocks, initial, final)

    def blocks(self, initial: Scene) -> tuple[int, ...]:
        """The blocks that it selects; none for relations of the robot, and for the selector ``others``.

        Raises:
            UngroundedError: if the selector is undefined in the initial scene.
        """
        chooses = self.definition.of_blocks and self.selector != REST
        return selected(self.selector, initial) if chooses else ()

    def judged(self, blocks: Sequence[int], initial: Scene) -> list[int]:
        """The blocks among these that the relation applies to: not, for example, the reference of `near`."""
        if (each := self.definition.each) is None:
            return list(blocks)
        flags = each(self.argument, initial, initial)
        return [index for index in blocks if flags[index] is not None]


Each = Callable[[str, Scene, Scene], "list[bool | None]"]
"""(argument, initial, final) -> for each block of the scene whether it holds; None: it does not apply to this block."""
Together = Callable[[Conjunct, tuple[int, ...], Scene, Scene], list[bool]]
"""(conjunct, blocks, initial, final) -> whether it holds, for each object."""


def _nothing(conjunct: Conjunct, blocks: tuple[int, ...], initial: Scene, final: Scene) -> list[bool]:
    raise NotImplementedError


@dataclass(frozen=True)
class Relation:
    """The definition of a relation: its arguments, and a function that judges it, `each` or `together`.

    Attributes:
        arguments: the values that it takes; ("",) if it takes none.
        each: judges each block by itself, such as whether it is in the region.
        together: judges the selected blocks together, such as whether they form a line; or the robot.
        of_blocks: whether it has a selector. Otherwise, it is a relation of the robot.
        prefix: the prefix of an argument in texts, such as "to=".
        least: the least number of selected blocks for which it is defined. 0: it also holds without any.
    """

    arguments: tuple[str, ...] = ("",)
    each: Each | None = None
    together: Together = _nothing
    of_blocks: bool = True
    prefix: str = ""
    least: int = 1

    @property
    def quantified(self) -> bool:
        """Whether "any" may precede the selector."""
        return self.each is not None and self.least > 0


def _in(argument: str, initial: Scene, final: Scene) -> list[bool | None]:
    if not initial.regions:
        raise UngroundedError("the scene has no region")
    if argument == HOME:
        pairs = zip(homes(initial), final.blocks, strict=True)
        return [None if home is None else final.regions[home].contains(block) for home, block in pairs]
    return [any(region.contains(block) for region in final.regions) for block in final.blocks]


def _out(argument: str, initial: Scene, final: Scene) -> list[bool | None]:
    return [not inner for inner in _in(argument, initial, final)]


def _exactly(conjunct: Conjunct, blocks: tuple[int, ...], initial: Scene, final: Scene) -> list[bool]:
    region = the_region(final)
    return [sum(region.contains(final.blocks[index]) for index in blocks) == conjunct.number]


def from_wall(body: Block | Robot, wall: str, half: float) -> float:
    """The distance of a centre from a wall, or from the nearest one."""
    sides = WALLS.values() if wall == ANY else [WALLS[wall]]
    return half - max(u * body.x + v * body.y for u, v in sides)


def _wall(argument: str, initial: Scene, final: Scene) -> list[bool | None]:
    return [from_wall(block, argument, final.half_width) <= AT_WALL for block in final.blocks]


def _from_corner(block: Block, corner: str, half: float) -> float:
    """The distance of a centre from a corner, or from the nearest one."""
    corners = CORNERS.values() if corner == ANY else [CORNERS[corner]]
    return min(math.hypot(block.x - u * half, block.y - v * half) for u, v in corners)


def _corner(argument: str, initial: Scene, final: Scene) -> list[bool | None]:
    return [_from_corner(block, argument, final.half_width) <= IN_CORNER for block in final.blocks]


def _near_corner(argument: str, initial: Scene, final: Scene) -> list[bool | None]:
    return [_from_corner(block, argument, final.half_width) <= FULL_SCORE_DISTANCE for block in final.blocks]


def _near(argument: str, initial: Scene, final: Scene) -> list[bool | None]:
    other = block_of(argument, initial)
    return [
        None if index == other else _distance(block, final.blocks[other]) <= NEAR
        for index, block in enumerate(final.blocks)
    ]


def _apart(conjunct: Conjunct, blocks: tuple[int, ...], initial: Scene, final: Scene) -> list[bool]:
    return [
        all(_distance(final.blocks[index], final.blocks[other]) >= APART for other in blocks if other != index)
        for index in blocks
    ]


def _line(conjunct: Conjunct, blocks: tuple[int, ...], initial: Scene, final: Scene) -> list[bool]:
    points = [(final.blocks[index].x, final.blocks[index].y) for index in blocks]
    right = longest_line(points)
    return [number < right for number in range(len(points))]


def _clustered(conjunct: Conjunct, blocks: tuple[int, ...], initial: Scene, final: Scene) -> list[bool]:
    values = {getattr(block, conjunct.argument) for block in initial.blocks}
    if len(values) < 2:
        raise UngroundedError(f"all blocks have the same {conjunct.argument}")
    right = right_blocks(final, "colour" if conjunct.argument == "colour" else "shape")
    return [right[index] for index in blocks]


def _untouched(argument: str, initial: Scene, final: Scene) -> list[bool | None]:
    return [_distance(here, there) <= STAYED for here, there in zip(final.blocks, initial.blocks, strict=True)]


def _robot_in(conjunct: Conjunct, blocks: tuple[int, ...], initial: Scene, final: Scene) -> list[bool]:
    return [the_region(final).contains(final.robot)]


def _robot_near(conjunct: Conjunct, blocks: tuple[int, ...], initial: Scene, final: Scene) -> list[bool]:
    return [_distance(final.robot, final.blocks[block_of(conjunct.argument, initial)]) <= NEAR]


def _robot_wall(conjunct: Conjunct, blocks: tuple[int, ...], initial: Scene, final: Scene) -> list[bool]:
    return [from_wall(final.robot, conjunct.argument, final.half_width) <= ROBOT_AT_WALL]


def _distance(body: Block | Robot, other: Block | Robot) -> float:
    return math.hypot(body.x - other.x, body.y - other.y)


_BLOCKS: Final = tuple(reference for reference in REFERENCES if reference not in ("region", "robot"))
RELATIONS: Final = {
    "in": Relation(("region", HOME), each=_in),
    "out": Relation(each=_out, least=0),
    "exactly": Relation(together=_exactly),
    "wall": Relation((*WALLS, ANY), each=_wall),
    "corner": Relation((*CORNERS, ANY), each=_corner),
    "near corner": Relation(tuple(CORNERS), each=_near_corner),
    "near": Relation(_BLOCKS, each=_near, prefix="to="),
    "apart": Relation(together=_apart, least=2),
    "line": Relation(together=_line, least=LEAST_LINE),
    "clustered": Relation(("colour", "shape"), together=_clustered, prefix="by="),
    "untouched": Relation(each=_untouched, least=0),
    "robot in": Relation(together=_robot_in, of_blocks=False),
    "robot near": Relation(_BLOCKS, together=_robot_near, of_blocks=False, prefix="to="),
    "robot wall": Relation((*WALLS, ANY), together=_robot_wall, of_blocks=False),
}
"""All relations by name, in the order of canonical texts."""
