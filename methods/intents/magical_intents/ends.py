"""Samples for the scorer: initial scenes of training intents, and final scenes with their scores, without simulation.

Some final scenes are ends of plans for the intent, others of plans for its rivals: intents that a demonstration in the
first scene also reaches. The others are what the search asks about: scenes on the way to these ends, perhaps with other
objects at random places, and after a move of one more object.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from magical_intents.search import Floats, places
from magical_mj.intents import Intent, rivals
from magical_mj.intents.intent import MOST_CONJUNCTS, share_of
from magical_mj.intents.plans import planned, solved
from magical_mj.intents.scenes import ALL_RULES, demo_scene, redrawn
from magical_mj.intents.selectors import REST
from magical_mj.learners.networks import blocks_of
from magical_mj.observations import MAX_BLOCKS, StateEncoder
from magical_mj.scene import Scene
from magical_mj.tasks.planning import Noise
from magical_mj.utils.errors import IntentError, PlacementError

SCENES: Final = 10
"""The number of scenes of each intent: the demo scene, some as in the variant Layout, and others as in All."""
LAYOUTS: Final = 4
RIGHT: Final = 2
"""The first final scenes are ends of plans for the intent: the cheapest plan, and a random one."""
RIVALS: Final = 4
"""The number of rivals whose ends follow, if they have a plan in the scene."""
BITS: Final = 22.0
SIMPLEST: Final = 300
"""Rivals are drawn from this number of the simplest ones with at most `BITS` bits."""
WAYS: Final = 2
"""The number of scenes on the way to an end. Only the last can be the end itself."""
TOWARDS: Final = 0.75
"""How often such an end is right, and how often the next object is one that has to move."""
ASTRAY: Final = (0, 0, 1, 2, 3)
"""The numbers of other objects at random places in such a scene, with equal probabilities."""
KEPT: Final = 2
"""The number of moves with the best scores, and of other moves, that are kept in such a scene."""
MOVED: Final = 0.05
"""A body has moved if it is farther (units) from its start."""
OPEN: Final = (0.39, -0.39)
"""The angles of the open fingers (rad)."""


class Judged(NamedTuple):
    """An initial scene, and final scenes.

    Attributes:
        start: the state, shape (names,).
        ends: the states of final scenes, shape (ends, names). The first `RIGHT` reach the intent.
        scores: the intent's score in each, shape (ends,).
        shares: the share of each of its relations, shape (ends, MOST_CONJUNCTS); -1 if it has fewer.
        named: which blocks its relations select, shape (MAX_BLOCKS,).
    """

    start: NDArray[np.float32]
    ends: NDArray[np.float32]
    scores: NDArray[np.float32]
    shares: NDArray[np.float32]
    named: NDArray[np.float32]


def judged(intent: Intent, rng: np.random.Generator, scenes: int = SCENES) -> list[Judged]:
    """Final scenes of an intent in some random initial scenes. Scenes without a plan are left out."""
    found = []
    try:
        _, demo = demo_scene(intent, lambda _: rng)
        others = simple_rivals(intent, demo)
        for number in range(scenes):
            rules = ALL_RULES if number > LAYOUTS else ()
            found += judged_in(intent, redrawn(intent, rng, demo, *rules) if number else demo, others, rng)
    except (IntentError, PlacementError):
        pass
    return found


def simple_rivals(intent: Intent, demo: Scene) -> list[Intent]:
    """The simplest intents that a demonstration in a scene also reaches."""
    return rivals([planned(intent, demo)], BITS)[:SIMPLEST]


def judged_in(intent: Intent, scene: Scene, others: Sequence[Intent], rng: np.random.Generator) -> list[Judged]:
    """Final scenes in one initial scene, some of them for other intents. An empty list if the intent has no plan."""
    right = [solved(intent, scene, noise) for noise in (None, Noise(rng, 1.0))]
    if (first := right[0]) is None:
        return []
    goals = [_positions(one or first) for one in right]
    for other in [others[index] for index in rng.permutation(len(others))[:RIVALS].tolist()]:
        goals += [_positions(end)] if other.grounded(scene) and (end := solved(other, scene)) else []
    every = [*goals, _positions(scene)]
    for way in range(WAYS):
        every += _moves(intent, scene, goals, rng, whole=way == WAYS - 1)
    ends = [_placed(scene, each) for each in every]
    shares = np.full((len(ends), MOST_CONJUNCTS), -1.0, np.float32)
    for row, end in zip(shares, ends, strict=True):
        row[: len(intent.conjuncts)] = [share_of(parts) for parts in intent.parts(scene, end)]
    scores = np.array([intent.score(scene, end) for end in ends], np.float32)
    return [Judged(resting([scene])[0], resting(ends), scores, shares, _named(intent, scene))]


def _moves(intent: Intent, scene: Scene, goals: list[Floats], rng: np.random.Generator, *, whole: bool) -> list[Floats]:
    """Positions on the way to a goal, and after moves of one object: those with the best scores, and some others."""
    start, right = _positions(scene), rng.random() < TOWARDS or len(goals) == RIGHT
    goal = goals[int(rng.integers(RIGHT)) if right else int(rng.integers(RIGHT, len(goals)))]
    moved = np.flatnonzero(np.linalg.norm(goal - start, axis=1) > MOVED)
    brought = rng.permutation(moved)[: int(rng.integers(len(moved) + whole))] if len(moved) else moved
    way = start.copy()
    way[brought] = goal[brought]
    boxes = np.array([region.box for region in scene.regions], np.float32).reshape(-1, 4)
    for stray in rng.permutation(np.setdiff1d(np.arange(len(way)), brought))[: int(rng.choice(ASTRAY))].tolist():
        if elsewhere := places(way, stray, boxes):
            way[stray] = elsewhere[int(rng.integers(len(elsewhere)))]
    left = np.setdiff1d(moved, brought)
    one = int(rng.choice(left)) if len(left) and rng.random() < TOWARDS else int(rng.integers(len(way)))
    found = []
    for place in places(way, one, boxes):
        end = way.copy()
        end[one] = place
        found.append((intent.share(scene, _placed(scene, end)), rng.random(), end))
    best = [end for *_, end in sorted(found, key=lambda each: each[:2], reverse=True)]
    rest = best[KEPT:]
    return [way, *best[:KEPT], *(rest[index] for index in rng.permutation(len(rest))[:KEPT])]


def _named(intent: Intent, scene: Scene) -> NDArray[np.float32]:
    pairs = zip(intent.conjuncts, intent.blocks(scene), strict=True)
    flags = np.zeros(MAX_BLOCKS, np.float32)
    flags[[block for conjunct, blocks in pairs if conjunct.selector != REST for block in blocks]] = 1.0
    return flags


def _positions(scene: Scene) -> Floats:
    """The positions of the blocks and, last, the robot, shape (blocks + 1, 2)."""
    return np.array([body.pose[:2] for body in (*scene.blocks, scene.robot)], np.float32)


def _placed(scene: Scene, positions: Floats) -> Scene:
    """The scene with such positions."""
    *blocks, robot = positions.tolist()
    poses = [(x, y, block.angle) for (x, y), block in zip(blocks, scene.blocks, strict=True)]
    return scene.moved((*robot, scene.robot.angle), poses)


def after(scene: Scene, state: NDArray[np.float32]) -> Scene:
    """The scene with the positions of a state (names,)."""
    blocks = blocks_of(torch.from_numpy(state))[: len(scene.blocks), 1:3].numpy()
    return _placed(scene, np.concatenate([blocks, state[None, :2]]))


def resting(scenes: Iterable[Scene]) -> NDArray[np.float32]:
    """The states of scenes at rest, with open fingers, shape (n, names)."""
    return np.stack([_state(scene) for scene in scenes])


def _state(scene: Scene) -> NDArray[Any]:
    poses = np.array([scene.robot.pose, *(block.pose for block in scene.blocks)])
    return StateEncoder(scene)(poses, np.zeros_like(poses), np.array(OPEN))
