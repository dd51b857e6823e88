"""Readings: simple rules about the blocks to move that a policy may have learnt, and the endings of episodes.

Demonstrations in one scene do not show why they moved certain blocks: because of their position, their colour, their
shape, or the task's intent. In a scene where these differ, the blocks that a policy moved show which rule it learnt.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from magical_mj.intents.intent import Intent
from magical_mj.intents.relations import ANY, NEAR, ROBOT_AT_WALL, STAYED, from_wall
from magical_mj.intents.selectors import REST
from magical_mj.scene import Scene

SAME_PLACE: Final = 0.3
"""The largest distance between a block and the demonstrated one at the same place: about the width of a block."""
READINGS: Final = ("same place", "same colour", "same shape", "nearest")
AND_OTHERS: Final = "intended, and moved others"
ELSEWHERE: Final = ("another block", "another wall")
ENDINGS: Final[Mapping[str, str]] = {
    "intended": "the score is 1",
    AND_OTHERS: "the score is 1, and a block was moved that the intent does not name",
    "same place": "only wrong blocks were moved, among them the nearest to where a demonstrated one started. If none "
    "has to be moved: the robot ended where the demonstrations' region was, or near where they end",
    "same colour": "only wrong blocks were moved, one of them with the colour of a demonstrated one",
    "same shape": "only wrong blocks were moved, one of them with the shape of a demonstrated one",
    "nearest": "only wrong blocks were moved, among them the nearest to the robot's start",
    "another block": "only other wrong blocks were moved, or the robot ended next to a wrong one",
    "another wall": "the robot ended at a wrong wall",
    "incompetent": "a block was moved that has to be, but the task was not solved. If none has to be: the robot drove "
    "elsewhere",
    "nothing": "no block was moved. If none has to be: the robot stayed where it started",
}
"""The kinds of endings of an episode, and what they mean; see `ending`."""


@dataclass(frozen=True)
class DemonstratedBlocks:
    """The blocks that the demonstrations of a task move.

    Attributes:
        scene: their first scene.
        moved: the blocks that most of them move.
        robots: where the robot ends in them.
    """

    scene: Scene
    moved: tuple[int, ...]
    robots: tuple[tuple[float, float], ...] = ()

    @classmethod
    def of(cls, ends: Sequence[tuple[Scene, Scene]]) -> DemonstratedBlocks:
        """The blocks of demonstrations with these initial and final scenes. They start in one scene."""
        moves = [set(moved_blocks(*pair)) for pair in ends]
        blocks = range(len(ends[0][0].blocks))
        most = tuple(index for index in blocks if 2 * sum(index in move for move in moves) > len(moves))
        return cls(ends[0][0], most, tuple((final.robot.x, final.robot.y) for _, final in ends))


def moved_blocks(initial: Scene, final: Scene) -> tuple[int, ...]:
    """The blocks that ended farther than `STAYED` from where they began."""
    pairs = enumerate(zip(initial.blocks, final.blocks, strict=True))
    return tuple(index for index, (here, there) in pairs if math.hypot(here.x - there.x, here.y - there.y) > STAYED)


def others_moved(intent: Intent, initial: Scene, final: Scene) -> tuple[int, ...]:
    """The side effects of an episode: the moved blocks that no relation names, except by `others`."""
    selected = zip(intent.conjuncts, intent.blocks(initial), strict=True)
    named = {index for conjunct, blocks in selected if conjunct.selector != REST for index in blocks}
    return tuple(index for index in moved_blocks(initial, final) if index not in named)


def intended_blocks(intent: Intent, initial: Scene) -> frozenset[int]:
    """The blocks to move (one or all of them): a conjunct does not hold for them yet in the scene."""
    wanted: set[int] = set()
    every = intent.parts(initial, initial), intent.blocks(initial)
    for conjunct, parts, blocks in zip(intent.conjuncts, *every, strict=True):
        relation = conjunct.definition
        if all(parts):
            continue
        flags = relation.each(conjunct.argument, initial, initial) if relation.each else [False] * len(initial.blocks)
        wanted |= {index for index in blocks if flags[index] is False}
    return frozenset(wanted)


def selects_some(intent: Intent) -> bool:
    """Whether an intent is about some of the blocks, and says what becomes of the others."""
    return len(intent.conjuncts) > 1 and all(conjunct.definition.each is not None for conjunct in intent.conjuncts)


def readings(demonstrated: DemonstratedBlocks, initial: Scene) -> dict[str, frozenset[int]]:
    """For each reading, the blocks that it would move in a scene. Empty if it does not apply.

    - same place: the block nearest to the start of a demonstrated one, if it is within `SAME_PLACE`.
    - same colour, same shape: all blocks with the colour, or the shape, of a demonstrated one.
    - nearest: the block nearest to where the robot starts.
    """
    models = [demonstrated.scene.blocks[index] for index in demonstrated.moved]
    if not models or not initial.blocks:
        return dict.fromkeys(READINGS, frozenset())
    points = [(block.x, block.y) for block in initial.blocks]
    nearest = [_nearest(points, (model.x, model.y)) for model in models]
    near = {
        index
        for index, model in zip(nearest, models, strict=True)
        if math.dist(points[index], (model.x, model.y)) <= SAME_PLACE
    }
    colours, shapes = {model.colour for model in models}, {model.shape for model in models}
    return {
        "same place": frozenset(near),
        "same colour": frozenset(index for index, block in enumerate(initial.blocks) if block.colour in colours),
        "same shape": frozenset(index for index, block in enumerate(initial.blocks) if block.shape in shapes),
        "nearest": frozenset([_nearest(points, (initial.robot.x, initial.robot.y))]),
    }


def ending(
    intent: Intent, demonstrated: DemonstratedBlocks, initial: Scene, final: Scene, *, solved: bool
) -> Mapping[str, float]:
    """What an episode did, as shares of `ENDINGS` that sum to 1.

    - intended: it was solved; "intended, and moved others" if there are `others_moved`.
    - nothing: no block was moved.
    - incompetent: a block was moved that had to be, but the task was not solved.
    - Otherwise, only wrong blocks were moved. All readings that include one of them get equal shares; "another block"
      if none does.

    If no block has to be moved, the robot's place counts:

    - nothing: the robot stayed where it started.
    - same place: it ended within `SAME_PLACE` of where a demonstration ended; for `robot in`, where a region was.
    - another block, another wall: it ended next to another block than `robot near` names, or at another wall than
      `robot wall` names.
    - incompetent: it drove elsewhere.
    """
    if solved:
        return {AND_OTHERS if others_moved(intent, initial, final) else "intended": 1.0}
    moved, wanted = set(moved_blocks(initial, final)), intended_blocks(intent, initial)
    if not wanted and any(not conjunct.definition.of_blocks for conjunct in intent.conjuncts):
        return {_robot_ending(intent, demonstrated, initial, final): 1.0}
    if not moved:
        return {"nothing": 1.0}
    if moved & wanted:
        return {"incompetent": 1.0}
    named = [name for name, blocks in readings(demonstrated, initial).items() if blocks & moved] or ["another block"]
    return {name: 1.0 / len(named) for name in named}


def _robot_ending(intent: Intent, demonstrated: DemonstratedBlocks, initial: Scene, final: Scene) -> str:
    place = final.robot.x, final.robot.y
    if math.dist((initial.robot.x, initial.robot.y), place) <= STAYED:
        return "nothing"
    relations = {conjunct.relation for conjunct in intent.conjuncts}
    if "robot in" in relations:
        shown = any(region.contains(final.robot) for region in demonstrated.scene.regions)
    else:
        shown = any(math.dist(place, end) <= SAME_PLACE for end in demonstrated.robots)
    if shown:
        return "same place"
    if "robot near" in relations and any(math.dist(place, block.pose[:2]) <= NEAR for block in final.blocks):
        return "another block"
    if "robot wall" in relations and from_wall(final.robot, ANY, final.half_width) <= ROBOT_AT_WALL:
        return "another wall"
    return "incompetent"


def refutes(intent: Intent, blocks: frozenset[int], initial: Scene) -> bool:
    """Whether moving these blocks, instead of the intended ones, is wrong in a scene.

    If one of several blocks is enough, any of them is right. If one has to be moved, moving none is wrong.
    """
    wanted = intended_blocks(intent, initial)
    if any(conjunct.any_of for conjunct in intent.conjuncts):
        return bool(wanted) and not (blocks and blocks <= wanted)
    return blocks != wanted


def same_places(final: Scene, initial: Scene) -> Scene:
    """`initial` with the robot and the blocks, in their order, at the poses of `final`. Further blocks stay."""
    poses = [block.pose for block in final.blocks][: len(initial.blocks)]
    return initial.moved(final.robot.pose, [*poses, *(block.pose for block in initial.blocks[len(poses) :])])


def _nearest(points: Sequence[tuple[float, float]], to: tuple[float, float]) -> int:
    return min(range(len(points)), key=lambda index: math.dist(points[index], to))
