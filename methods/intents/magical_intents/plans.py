"""The expert's plans as samples for planners: scenes, the next object and its target position, without simulation.

Demonstrations of many intents take long to generate, and most of their steps do not help a planner. It has to learn the
objects and targets of many intents in many scenes. In plans, the robot's poses are random.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_intents.subgoals import DONE, ROBOT, Labels, Shown
from magical_mj.intents import Intent
from magical_mj.intents.plans import plan
from magical_mj.intents.scenes import ALL_RULES, demo_scene, redrawn
from magical_mj.observations import StateEncoder
from magical_mj.scene import Scene
from magical_mj.scene.scene import Pose
from magical_mj.tasks.planning import Noise, Subgoal, scene_after
from magical_mj.utils.errors import IntentError, PlacementError

SCENES: Final = 16
"""The number of scenes of each intent: the demo scene, one of the variant Layout, and others of All."""
AWAY: Final = (0.3, 0.5)
"""The smallest and the largest distance (units) of the robot from a block that it brings, or has brought."""
REACH: Final = 0.8
"""The largest coordinate of the robot (units)."""
OPEN: Final = (0.39, -0.39)
CLOSED: Final = (0.27, -0.29)
"""Angles of the left and the right finger (rad)."""


def planned(intent: Intent, rng: np.random.Generator, scenes: int = SCENES) -> list[Shown]:
    """The plans of an intent in some random scenes. Scenes without a plan are left out."""
    found = []
    try:
        _, demo = demo_scene(intent, lambda _: rng)
        for number in range(scenes):
            scene = redrawn(intent, rng, demo, *(ALL_RULES if number > 1 else ())) if number else demo
            found += _shown(intent, scene, rng)
    except (IntentError, PlacementError):
        pass
    return found


def _shown(intent: Intent, scene: Scene, rng: np.random.Generator) -> Iterator[Shown]:
    noise, now = Noise(rng, 1.0), scene
    encode, steps = StateEncoder(scene), list[tuple[Scene, bool, int, tuple[float, float]]]()
    todo = plan(intent, scene, scene, noise)
    while todo:
        todo.sort(key=lambda one: _away(now, one))
        subgoal, *todo = todo
        number = ROBOT if subgoal.block is None else subgoal.block
        for state, closed in [(now, False), *_on_the_way(now, subgoal, rng)]:
            steps.append((state, closed, number, subgoal.target))
        now = scene_after(now, [subgoal])
        if subgoal.block is not None:
            now = _with_robot(now, _next_to(subgoal.target, rng))
            todo = todo or [one for one in plan(intent, scene, now, noise) if one.block is None]
    if not steps or not intent.holds(scene, now):
        return
    steps.append((now, False, DONE, (0.0, 0.0)))
    states = np.stack([_state(encode, state, closed=closed) for state, closed, _, _ in steps])
    labels = Labels(np.array([one[2] for one in steps]), np.array([one[3] for one in steps], np.float32))
    first = np.flatnonzero(np.diff(labels.objects, prepend=-1))
    yield Shown(states, np.zeros(len(steps), np.int64), labels, states[-1], first)


def _away(scene: Scene, subgoal: Subgoal) -> float:
    """The robot's distance from the block of a subgoal; infinite for subgoals of the robot, so that they are last."""
    if subgoal.block is None:
        return math.inf
    block = scene.blocks[subgoal.block]
    return math.dist((scene.robot.x, scene.robot.y), (block.x, block.y))


def _on_the_way(scene: Scene, subgoal: Subgoal, rng: np.random.Generator) -> Iterator[tuple[Scene, bool]]:
    """A state of driving to the object, then one of bringing it, each with a flag for closed fingers."""
    share, robot = rng.random(2), scene.robot.pose
    target = subgoal.target
    if subgoal.block is None:
        yield _with_robot(scene, (*_between(robot, target, share[0]), rng.uniform(-math.pi, math.pi))), False
        return
    block = scene.blocks[subgoal.block].pose
    yield _with_robot(scene, (*_between(robot, block, 0.7 * share[0]), rng.uniform(-math.pi, math.pi))), False
    carried = _between(block, target, share[1])
    poses = [one.pose for one in scene.blocks]
    poses[subgoal.block] = (*carried, block[2])
    yield scene.moved(_next_to(carried, rng), poses), True


def _between(start: tuple[float, ...], end: tuple[float, ...], share: float) -> tuple[float, float]:
    return start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])


def _next_to(position: tuple[float, float], rng: np.random.Generator) -> Pose:
    """A pose of the robot next to a block, and facing it."""
    angle, distance = rng.uniform(-math.pi, math.pi), rng.uniform(*AWAY)
    x, y = position[0] + distance * math.sin(angle), position[1] - distance * math.cos(angle)
    return max(-REACH, min(REACH, x)), max(-REACH, min(REACH, y)), angle


def _with_robot(scene: Scene, pose: Pose) -> Scene:
    return scene.moved(pose, [block.pose for block in scene.blocks])


def _state(encode: StateEncoder, scene: Scene, *, closed: bool) -> NDArray[np.float32]:
    poses = np.array([scene.robot.pose, *(block.pose for block in scene.blocks)])
    return encode(poses, np.zeros_like(poses), np.array(CLOSED if closed else OPEN))
