"""Samples for the scorer: initial scenes of training intents, and final scenes with their scores, without simulation.

Some final scenes are ends of plans for the intent, others of plans for its rivals: intents that a demonstration in the
first scene also reaches. In the others, blocks are elsewhere: some moved blocks are at their start, other blocks have
moved instead of them, or some blocks of one colour or shape are at random places of one kind.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from magical_mj.intents import Intent, rivals
from magical_mj.intents.plans import planned, solved
from magical_mj.intents.scenes import ALL_RULES, demo_scene, redrawn
from magical_mj.learners.networks import blocks_of
from magical_mj.observations import StateEncoder
from magical_mj.scene import Scene
from magical_mj.tasks.planning import Noise
from magical_mj.utils.errors import IntentError, PlacementError

SCENES: Final = 16
"""The number of scenes of each intent: the demo scene, some as in the variant Layout, and others as in All."""
LAYOUTS: Final = 4
ENDS: Final = 16
"""The number of final scenes for each initial scene."""
RIGHT: Final = 2
"""The first of these are ends of plans for the intent: the cheapest plan, and a random one."""
RIVALS: Final = 5
"""The number of rivals whose ends follow, if they have a plan in the scene."""
BITS: Final = 22.0
SIMPLEST: Final = 300
"""Rivals are drawn from this number of the simplest ones with at most `BITS` bits."""
REACH: Final = 0.85
"""The largest coordinate of a block (units)."""
MOVED: Final = 0.05
"""A body has moved if it is farther (units) from its start."""
OPEN: Final = (0.39, -0.39)
"""The angles of the open fingers (rad)."""

Places = list[tuple[float, float]]


class Judged(NamedTuple):
    """An initial scene, and final scenes.

    Attributes:
        start: the state, shape (names,).
        ends: the states of final scenes, shape (ends, names). The first `RIGHT` reach the intent.
        scores: the intent's score in each, shape (ends,).
    """

    start: NDArray[np.float32]
    ends: NDArray[np.float32]
    scores: NDArray[np.float32]


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
    ends = [one or first for one in right]
    for other in [others[index] for index in rng.permutation(len(others))[:RIVALS].tolist()]:
        ends += [end] if other.grounded(scene) and (end := solved(other, scene)) else []
    while len(ends) < ENDS:
        ends.append(elsewhere(scene, ends[int(rng.integers(len(ends)))], rng))
    return [Judged(resting([scene])[0], resting(ends), _scores(intent, scene, ends))]


def _scores(intent: Intent, scene: Scene, ends: Iterable[Scene]) -> NDArray[np.float32]:
    return np.array([intent.score(scene, end) for end in ends], np.float32)


def after(scene: Scene, state: NDArray[np.float32]) -> Scene:
    """The scene with the positions of a state (names,)."""
    blocks = blocks_of(torch.from_numpy(state))[: len(scene.blocks), 1:3].tolist()
    poses = [(x, y, block.angle) for (x, y), block in zip(blocks, scene.blocks, strict=True)]
    return scene.moved((*state[:2].tolist(), scene.robot.angle), poses)


def elsewhere(scene: Scene, end: Scene, rng: np.random.Generator) -> Scene:
    """The final scene with some blocks elsewhere."""
    starts, places = ([block.pose for block in each.blocks] for each in (scene, end))
    far = [math.dist(one[:2], two[:2]) > MOVED for one, two in zip(starts, places, strict=True)]
    moved, others = (np.flatnonzero(np.array(far) == flag).tolist() for flag in (True, False))
    kind = rng.integers(4)
    targets: dict[int, tuple[float, float]] = {}
    if kind == 0 and moved:  # some are at their start
        some = rng.permutation(moved)[: int(rng.integers(1, len(moved) + 1))].tolist()
        targets = {index: starts[index][:2] for index in some}
    elif kind == 1 and moved and others:  # another block has moved instead of one
        one, other = int(rng.choice(moved)), int(rng.choice(others))
        targets = {one: starts[one][:2], other: places[one][:2]}
    elif kind == 2:  # a block is at a random place
        index = int(rng.integers(len(places)))
        targets = {index: _place(scene, rng, int(rng.integers(3)))}
    else:  # blocks of one colour or shape are at places of one kind
        base, where = (scene, end)[int(rng.integers(2))], int(rng.integers(3))
        model, attribute = base.blocks[int(rng.integers(len(places)))], ("colour", "shape")[int(rng.integers(2))]
        same = [k for k, one in enumerate(base.blocks) if getattr(one, attribute) == getattr(model, attribute)]
        places = [block.pose for block in base.blocks]
        targets = {index: _place(scene, rng, where) for index in same[: 1 + int(rng.integers(len(same)))]}
    robot = end.robot.pose
    if rng.random() < 0.1:
        robot = (*_place(scene, rng, int(rng.integers(3))), robot[2])
    return end.moved(robot, [(*targets.get(k, pose[:2]), pose[2]) for k, pose in enumerate(places)])


def _place(scene: Scene, rng: np.random.Generator, kind: int) -> tuple[float, float]:
    """A random position: anywhere, at a wall, or in a region or next to a block."""
    x, y = rng.uniform(-REACH, REACH, 2).tolist()
    if kind == 1:
        side = REACH if rng.random() < 0.5 else -REACH
        return (side, y) if rng.random() < 0.5 else (x, side)
    if kind == 2:
        if scene.regions and rng.random() < 0.6:
            x0, y0, x1, y1 = scene.regions[int(rng.integers(len(scene.regions)))].box
            return float(rng.uniform(x0, x1)), float(rng.uniform(y0, y1))
        block, angle = scene.blocks[int(rng.integers(len(scene.blocks)))], rng.uniform(0, 2 * math.pi)
        x, y = block.x + 0.3 * math.cos(angle), block.y + 0.3 * math.sin(angle)
    return max(-REACH, min(REACH, x)), max(-REACH, min(REACH, y))


def resting(scenes: Iterable[Scene]) -> NDArray[np.float32]:
    """The states of scenes at rest, with open fingers, shape (n, names)."""
    return np.stack([_state(scene) for scene in scenes])


def _state(scene: Scene) -> NDArray[Any]:
    poses = np.array([scene.robot.pose, *(block.pose for block in scene.blocks)])
    return StateEncoder(scene)(poses, np.zeros_like(poses), np.array(OPEN))
