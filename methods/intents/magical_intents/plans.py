"""The expert's plans as samples for planners: scenes, the next object and its target position, without simulation.

Demonstrations of many intents take long to generate, and most of their steps do not help a planner. It has to learn the
objects and targets of many intents in many scenes. In plans, the robot's poses are random.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from magical_intents.network import Planner
from magical_intents.subgoals import CARRIED, DONE, ROBOT, Labels, Shown
from magical_mj.intents import Intent
from magical_mj.intents.plans import plan
from magical_mj.intents.scenes import ALL_RULES, demo_scene, redrawn
from magical_mj.learners.networks import blocks_of
from magical_mj.observations import StateEncoder
from magical_mj.scene import Scene
from magical_mj.scene.scene import Pose
from magical_mj.tasks.planning import Noise, Subgoal, scene_after
from magical_mj.utils.errors import IntentError, PlacementError

SCENES: Final = 12
"""The number of scenes of each intent: the demo scene, one of the variant Layout, and others of All."""
AWAY: Final = (0.3, 0.5)
"""The smallest and the largest distance (units) of the robot from a block that it brings, or has brought."""
REACH: Final = 0.8
"""The largest coordinate of the robot (units)."""
MOST_BROUGHT: Final = 10
"""The largest number of objects that `followed` brings."""
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


def wrong_end(shown: Shown, rng: np.random.Generator) -> NDArray[np.float32]:
    """A final state that probably does not reach the intent, with blocks in other places than in the demonstration.

    One moved block is at its start, or moved blocks are at random places, or other blocks have moved instead of them.
    If none has moved, the robot is at its start.
    """
    state = shown.final.copy()
    start, blocks = (blocks_of(torch.from_numpy(each)).numpy() for each in (shown.states[0], state))
    far = np.linalg.norm(blocks[:, 1:3] - start[:, 1:3], axis=1) > CARRIED
    moved, others = rng.permutation(np.flatnonzero(far)), rng.permutation(np.flatnonzero(~far & (blocks[:, 0] > 0)))
    kind = rng.integers(3)
    if not len(moved):
        state[:3] = shown.states[0][:3]
    elif kind == 0:
        blocks[moved[:1], 1:3] = start[moved[:1], 1:3]
    elif kind == 1 or not len(others):
        blocks[moved, 1:3] = rng.uniform(-REACH, REACH, (len(moved), 2))
    else:
        count = min(len(moved), len(others))
        blocks[others[:count], 1:3] = blocks[moved[:count], 1:3]
        blocks[moved, 1:3] = start[moved, 1:3]
    return state


@torch.inference_mode()
def followed(planner: Planner, given: NDArray[Any], scenes: Sequence[Scene]) -> list[Scene]:
    """The last scene of each episode if every object that the planner chooses is brought to its target.

    Args:
        planner: the planner.
        given: a sentence's words, shape (LENGTH,), or demonstrations as `ends_of` returns them.
        scenes: the initial scenes.
    """
    rng, now, active = np.random.default_rng(0), list(scenes), set(range(len(scenes)))
    context = planner.context(torch.from_numpy(given)[None])
    initial = torch.from_numpy(_resting(scenes))
    for _ in range(MOST_BROUGHT):
        objects, places = planner(initial, torch.from_numpy(_resting(now)), context).best()
        for number, (chosen, place) in enumerate(zip(objects.tolist(), places.tolist(), strict=True)):
            if chosen == DONE:
                active.discard(number)
            elif number in active and chosen == ROBOT:
                now[number] = _with_robot(now[number], (*place, now[number].robot.angle))
            elif number in active:
                poses = [block.pose for block in now[number].blocks]
                poses[chosen] = (*place, poses[chosen][2])
                now[number] = now[number].moved(_next_to(place, rng), poses)
    return now


def ends_of(demonstrations: Iterable[tuple[Scene, Scene]]) -> NDArray[np.float32]:
    """The states of the first and the last scene of each demonstration, shape (n, 2, names)."""
    return np.stack([_resting(pair) for pair in demonstrations])


def _resting(scenes: Iterable[Scene]) -> NDArray[np.float32]:
    """The states of scenes at rest, with open fingers, shape (n, names)."""
    return np.stack([_state(StateEncoder(scene), scene, closed=False) for scene in scenes])


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
