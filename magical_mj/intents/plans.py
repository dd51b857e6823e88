"""Plans of intents: positions of blocks and of the robot that satisfy all relations with a margin.

Each block that has to move gets the cheapest free position that satisfies all its relations. If one of several blocks
is enough, as with "any" and "exactly", the cheapest one moves. Lines and clusters follow. If possible, they do not move
blocks that have other relations. The robot moves last.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cache, lru_cache
from typing import Final, NamedTuple

import numpy as np

from magical_mj.intents.distances import ARRANGED, Floats, Slack, distances, slack_of
from magical_mj.intents.intent import Intent
from magical_mj.intents.relations import Conjunct
from magical_mj.intents.selectors import block_of
from magical_mj.scene import GoalRegion, Scene
from magical_mj.tasks.cluster import NEARER
from magical_mj.tasks.make_line import longest_line
from magical_mj.tasks.planning import (
    APART,
    CARRYING,
    CROWDED_COST,
    FETCHING,
    SPARE,
    SPREAD,
    WANDER,
    Noise,
    Point,
    Subgoal,
    cluster_targets,
    line_targets,
    places_anywhere,
    places_inside,
    scene_after,
)

MARGINS: Final = (0.09, 0.06, 0.03)
"""The slacks that positions should have (world units). The first that is possible is used."""
TOLERANCE: Final = 0.07
"""A block this near to its position (world units) has reached it; or nearer, if the margin is smaller."""
ROBOT_MARGIN: Final = 0.04
"""The least slack of the robot's position."""
CLEAR: Final = 0.34
"""The least distance between the centres of a block and the robot, with its fingers away from the block."""
ROBOT_LIMIT: Final = 0.78
"""The robot drives to positions within this square (half side)."""
TRIES: Final = 4
"""The number of attempts to find a plan that satisfies the intent."""
TOUCHING: Final = 0.25
"""Moved blocks whose centres are nearer would overlap."""


class _Choice(NamedTuple):
    """A position for a block."""

    cost: float
    place: Point
    margin: float


def plan(intent: Intent, initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """The remaining subgoals: those of blocks, or if none remains, that of the robot."""
    todo: list[Subgoal] = []
    arranged = any(conjunct.relation in ARRANGED for conjunct in intent.conjuncts)
    for _ in range(TRIES if arranged or noise.strength else 1):  # only arrangements vary without noise
        todo = _Attempt(intent, initial, now, noise).subgoals()
        if _blocks_hold(intent, initial, scene_after(now, todo)) and not _overlaps(now, todo):
            break
    return todo or _drive(intent, initial, now, noise)


def solved(intent: Intent, scene: Scene, noise: Noise | None = None) -> Scene | None:
    """The scene after a plan from the start of an episode, or None if no plan satisfies the intent.

    Without noise, it is the cheapest plan.
    """
    todo = _from_start(intent, scene, noise)
    end = scene_after(scene, todo)
    return end if not _overlaps(scene, todo) and intent.holds(scene, end) else None


def planned(intent: Intent, scene: Scene) -> tuple[Scene, Scene]:
    """A scene, and the scene after a plan that satisfies the intent. Without one, the scene itself."""
    return scene, solved(intent, scene) or scene


def cost(intent: Intent, scene: Scene) -> float:
    """The estimated number of actions from the start of an episode: the sum of the subgoals' costs."""
    return sum(subgoal.cost(scene) for subgoal in _from_start(intent, scene))


def _from_start(intent: Intent, scene: Scene, noise: Noise | None = None) -> list[Subgoal]:
    """All subgoals from the start of an episode."""
    noise = noise or Noise(np.random.Generator(np.random.PCG64(0)), 0.0)  # named, since numpy may change its default
    todo = plan(intent, scene, scene, noise)
    return todo + _drive(intent, scene, scene_after(scene, todo), noise)


class _Attempt:
    """One plan for the blocks. `after` is the scene after the subgoals found so far."""

    def __init__(self, intent: Intent, initial: Scene, now: Scene, noise: Noise) -> None:
        self._initial, self._now, self._noise = initial, now, noise
        self._after = now
        self._targets: dict[int, Subgoal] = {}
        self._wants: dict[int, list[Slack]] = {index: [] for index in range(len(now.blocks))}
        self._conjuncts = [
            (conjunct, blocks)
            for conjunct, blocks in zip(intent.conjuncts, intent.blocks(initial), strict=True)
            if conjunct.definition.of_blocks
        ]
        references = [block_of(conjunct.argument, initial) for conjunct, _ in self._of("near")]
        self._order = sorted(self._wants, key=lambda index: index not in references)

    def subgoals(self) -> list[Subgoal]:
        """The subgoals of all blocks that move."""
        for conjunct, blocks in self._conjuncts:
            if not (conjunct.any_of or conjunct.relation in ("exactly", *ARRANGED)):
                self._want(conjunct, conjunct.judged(blocks, self._initial))
        for conjunct, blocks in self._conjuncts:
            if conjunct.any_of:
                self._want(conjunct, self._cheapest(conjunct, conjunct.judged(blocks, self._initial), 1))
        for conjunct, blocks in self._of("exactly"):
            inner = self._cheapest(conjunct, blocks, conjunct.number)
            self._want(conjunct, inner)
            self._want(Conjunct("out"), [index for index in blocks if index not in inner])
        self._place()
        for conjunct, blocks in self._of(*ARRANGED):
            self._arrange(conjunct, blocks)
        return list(self._targets.values())

    def _of(self, *relations: str) -> list[tuple[Conjunct, tuple[int, ...]]]:
        return [(conjunct, blocks) for conjunct, blocks in self._conjuncts if conjunct.relation in relations]

    def _want(self, conjunct: Conjunct, blocks: Sequence[int]) -> None:
        for index in blocks:
            self._wants[index].append(slack_of(conjunct, self._initial, index, blocks))

    def _cheapest(self, conjunct: Conjunct, blocks: Sequence[int], number: int) -> list[int]:
        """The blocks that satisfy the conjunct at the least cost."""
        costs = {
            index: self._cost(index, [*self._wants[index], slack_of(conjunct, self._initial, index, blocks)])
            for index in blocks
        }
        return sorted(blocks, key=lambda index: costs[index])[:number]

    def _cost(self, index: int, wants: Sequence[Slack]) -> float:
        if _slack(wants, self._after, _point(self._after, index)) >= 0:
            return 0.0
        choice = self._choice(index, wants)
        return math.inf if choice is None else FETCHING + choice.cost

    def _place(self) -> None:
        """Moves each block with a relation that does not hold. The references of `near` come first."""
        for index in self._order:
            wants = self._wants[index]
            if not wants or _slack(wants, self._after, _point(self._after, index)) >= 0:
                continue
            choice = self._choice(index, wants)
            if choice is not None:
                self._move(index, choice.place, min(TOLERANCE, choice.margin))

    def _move(self, index: int, target: Point, tolerance: float) -> None:
        self._targets[index] = Subgoal(index, target, tolerance)
        self._after = scene_after(self._now, self._targets.values())

    def _choice(self, index: int, wants: Sequence[Slack]) -> _Choice | None:
        """The cheapest position of a block that satisfies its relations, with the largest possible margin."""
        places = np.concatenate([_places(self._now.regions), [self._initial.blocks[index].pose[:2]]])
        slack = _slack(wants, self._after, places)
        for margin in MARGINS:
            possible = places[slack >= margin]
            if not len(possible):
                continue
            costs = CARRYING * distances(possible, self._now.blocks[index].pose)
            crowding = CROWDED_COST * _crowding(possible, self._after, index)
            costs += crowding + self._noise(SPREAD, costs.shape)
            best = int(costs.argmin())
            if crowding[best] == 0.0 or margin == MARGINS[-1]:
                x, y = possible[best].tolist()
                return _Choice(float(costs[best]), (x, y), margin)
        return None

    def _arrange(self, conjunct: Conjunct, blocks: Sequence[int]) -> None:
        """Moves blocks into a line or into clusters. Those that other relations are about stay if possible."""
        points = [_point(self._after, index) for index in blocks]
        fixed = [number for number, index in enumerate(blocks) if self._wants[index]]
        places = [(float(x), float(y)) for ((x, y),) in points]
        if conjunct.relation == "line":
            targets = line_targets(places, lambda ends: self._lines(ends / SPARE, blocks), self._noise, fixed)
        else:
            kinds = [getattr(self._now.blocks[index], conjunct.argument) for index in blocks]
            targets = cluster_targets(places, kinds, NEARER, self._noise, fixed)
        for index, target in zip(blocks, targets, strict=True):
            if target is not None:
                self._move(index, target, TOLERANCE)

    def _lines(self, arrangements: Floats, blocks: Sequence[int]) -> Iterator[bool]:
        """Whether the blocks form a line in each of the arrangements, touch no others, and their relations hold."""
        others = [block.pose for index, block in enumerate(self._after.blocks) if index not in blocks]
        for points in arrangements:
            free = all(distances(points, other).min() >= APART for other in others)
            yield (
                free
                and longest_line((SPARE * points).tolist()) == len(blocks)
                and all(
                    _slack(self._wants[index], self._after, points[number : number + 1]) >= 0
                    for number, index in enumerate(blocks)
                )
            )


def _drive(intent: Intent, initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """The subgoal of the robot, if a relation about it does not hold."""
    about = [conjunct for conjunct in intent.conjuncts if not conjunct.definition.of_blocks]
    if all(all(conjunct.parts((), initial, now)) for conjunct in about):
        return []
    wants = [slack_of(conjunct, initial, None) for conjunct in about]
    places = _places(now.regions)
    places = places[np.abs(places).max(axis=1) <= ROBOT_LIMIT]
    clear = np.min([distances(places, block.pose) for block in now.blocks], axis=0, initial=math.inf)
    places = places[(clear >= CLEAR) & (_slack(wants, now, places) >= ROBOT_MARGIN)]
    if not len(places):
        return []
    costs = CARRYING * distances(places, now.robot.pose)
    x, y = places[int((costs + noise(WANDER, costs.shape)).argmin())].tolist()
    return [Subgoal(None, (x, y), ROBOT_MARGIN)]


def _slack(wants: Sequence[Slack], scene: Scene, places: Floats) -> Floats:
    """The least slack at each position; infinite without relations."""
    return np.min([want(scene, places) for want in wants], axis=0, initial=math.inf)


def _point(scene: Scene, index: int) -> Floats:
    """A block's position, shape (1, 2)."""
    return np.array([scene.blocks[index].pose[:2]])


def _crowding(places: Floats, scene: Scene, index: int) -> Floats:
    """How much nearer than `APART` each position is to other blocks, summed over the blocks."""
    crowding = np.zeros(len(places))
    for number, block in enumerate(scene.blocks):
        if number != index:
            crowding += np.clip(APART - distances(places, block.pose), 0.0, None)
    return crowding


@lru_cache(maxsize=64)
def _places(regions: tuple[GoalRegion, ...]) -> Floats:
    """Positions anywhere in the arena and, closer together, in the regions."""
    return np.concatenate([_anywhere(), *(np.array(places_inside(region)) for region in regions)])


@cache
def _anywhere() -> Floats:
    return np.array(places_anywhere())


def _overlaps(now: Scene, todo: Sequence[Subgoal]) -> bool:
    """Whether a moved block overlaps another one after the subgoals."""
    after = scene_after(now, todo)
    return any(
        index != subgoal.block and math.dist(subgoal.target, block.pose[:2]) < TOUCHING
        for subgoal in todo
        for index, block in enumerate(after.blocks)
    )


def _blocks_hold(intent: Intent, initial: Scene, final: Scene) -> bool:
    """Whether all relations about blocks hold."""
    return all(
        all(parts)
        for conjunct, parts in zip(intent.conjuncts, intent.parts(initial, final), strict=True)
        if conjunct.definition.of_blocks
    )
