"""Hindsight samples: a path that the robot has driven shows how to reach its end.

The robot plays in the demo scene, free or with the block that it carries in a demonstration, with random segments of
driving and turning that touch no other object. The path is then transformed, so that it ends at a pose shortly before
the demonstration grips or releases a block. The robot's actions on the path become the actions that lead to this pose,
as in goal-conditioned supervised learning (Ghosh et al. 2021, arXiv:1912.06088). This is valid because the motion of a
robot that touches nothing does not depend on its pose. Paths that would cross other blocks, or that are much longer
than necessary, are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from magical_mj.actions import NOOP, Action, Drive, Gripper, Turn
from magical_mj.engine import Engine
from magical_mj.learners.networks import blocks_of
from magical_mj.observations import FINGERS, MAX_BLOCKS, MAX_REGIONS
from magical_mj.utils.errors import PhysicsError
from magical_relational.replay import PATH_POINTS, Replay, Samples, front, in_hand

Floats = NDArray[np.floating[Any]]

LENGTH: Final = 34
"""The largest number of steps of a play, enough to turn around and drive 2.4 units."""
SEGMENTS: Final = (
    (True, Drive.NONE, 10),
    (False, Drive.FORWARD, 10),
    (True, Drive.FORWARD, 6),
    (False, Drive.FORWARD, 5),
)
"""The segments of a play: whether it turns, how it drives, and the largest number of steps."""
BUMPS: Final = 40
"""A play that touches an object continues from `BACK` steps earlier, at most this number of times."""
BACK: Final = 3
TOUCHED: Final = 0.01
"""A block that moves farther (units) was touched."""
SLIPPED: Final = 0.08
"""The largest motion (units) of a carried block between the fingers."""
BLOCKED: Final = 0.02
"""If the robot moves less far (units) in a second step forward, a wall blocks it."""
BEFORE: Final = 8
"""A path ends at most this number of steps before the end of a motion, or before the `MARGIN` of a grip."""
MARGIN: Final = 3
"""The number of steps between the end of a path and a grip."""
APART: Final = (0.36, 0.3)
"""The clearance (units) of a path from other blocks: for the robot's centre, and for the carried block's."""
ROOM: Final = 0.45
"""The smallest distance (units) to the nearest block at the start of a free play."""
SPEED: Final = (0.1, 0.3125)
"""The robot's speed, in units and rad per step."""
LONGER: Final = (1.5, 3)
"""The largest number of steps of a path: this factor times that of the shortest path, plus additional steps."""
CLOSE: Final = 0.08
"""Within this distance (units) of its end, the shortest path only turns."""


class _Play(NamedTuple):
    """States (steps + 1, names), and the actions between them (steps,)."""

    states: NDArray[np.float32]
    actions: NDArray[np.int64]


class _Moment(NamedTuple):
    """A step of a demonstration, and the block that moves with the robot there."""

    step: int
    held: int | None


def by_hindsight(
    engine: Engine, replays: Sequence[Replay], count: int, plays: int, rng: np.random.Generator
) -> list[Samples]:
    """At least `count` samples, from `plays` plays of each kind. If few paths fit, there are fewer."""
    moments = [_moments(replay) for replay in replays]
    library: dict[tuple[int, int | None], list[_Play]] = {}
    for number, replay in enumerate(replays):
        for begins in [[_Moment(step, None) for step in _free_steps(replay)], *_held(replay).values()]:
            for _ in range(plays):
                moment = begins[rng.integers(len(begins))]
                play = _play(engine, replay, moment, rng)
                if len(play.actions) > BACK:
                    library.setdefault(_kind(number, moment), []).append(play)
    parts: list[Samples] = []
    found = 0
    for _ in range(3 * count):
        if found >= count:
            break
        number = int(rng.integers(len(replays)))
        if not moments[number]:
            continue
        group = moments[number][rng.integers(len(moments[number]))]
        moment = group[rng.integers(len(group))]
        chosen = library.get(_kind(number, moment))
        part = _transformed(chosen[rng.integers(len(chosen))], replays[number], moment, rng) if chosen else None
        if part is not None:
            parts.append(part)
            found += len(part.path)
    return parts


def _kind(number: int, moment: _Moment) -> tuple[int, int | None]:
    """The kind of a play. Free plays suit all demonstrations, while each demonstration grips a block differently."""
    return (-1, None) if moment.held is None else (number, moment.held)


def _held(replay: Replay) -> dict[int, list[_Moment]]:
    """For each block, the moments when only it moves."""
    moving, begun = (np.zeros((replay.never, MAX_BLOCKS), bool) for _ in range(2))
    for motion in replay.motions():
        moving[motion.begin : motion.end, motion.block] = begun[motion.begin, motion.block] = True
    alone = moving & ~begun & (moving.sum(1, keepdims=True) == 1)
    steps = {block: np.flatnonzero(alone[:, block]).tolist() for block in range(MAX_BLOCKS) if alone[:, block].any()}
    return {block: [_Moment(step, block) for step in at] for block, at in steps.items()}


def _moments(replay: Replay) -> list[list[_Moment]]:
    """The moments shortly before each grip, before each end of a motion, and, if no block moves, before the end."""
    held = {moment.step: moment for group in _held(replay).values() for moment in group}
    moving = {step for motion in replay.motions() for step in range(motion.begin, motion.end)}
    found = []
    for motion in replay.motions():
        grip = motion.begin - MARGIN
        found.append([_Moment(step, None) for step in range(max(0, grip - BEFORE), grip) if step not in moving])
        leaves = range(max(motion.begin + 1, motion.end - BEFORE), motion.end)
        found.append([held[step] for step in leaves if step in held and held[step].held == motion.block])
    if not moving:
        last = int(np.flatnonzero(replay.actions != NOOP).max(initial=0))
        found.append([_Moment(step, None) for step in range(max(0, last - BEFORE), last + 1)])
    return [group for group in found if group]


def _free_steps(replay: Replay) -> list[int]:
    """The steps without a block near the robot. If there are none, the step with the largest distance to blocks."""
    exists = blocks_of(torch.from_numpy(replay.states))[..., 0].numpy() > 0
    gaps = np.linalg.norm(replay.positions - replay.states[:, None, :2], axis=2)
    gaps = np.where(exists, gaps, np.inf).min(1)[:-1]
    still = ~replay.moving[:-1].any(1)
    return np.flatnonzero(still & (gaps > ROOM)).tolist() or [int(gaps.argmax())]


def _play(engine: Engine, replay: Replay, moment: _Moment, rng: np.random.Generator) -> _Play:
    """Drives and turns at random, beginning at a moment, without touching any block except the held one."""
    engine.set_state(replay.saved[moment.step])
    gripper = Gripper.OPEN if moment.held is None else Gripper.CLOSE
    states, saved, actions = [engine.state_vector()], [engine.get_state()], []
    bumps, segment = 0, []
    try:
        while len(actions) < LENGTH and bumps < BUMPS:
            segment = segment or _segment(gripper, rng)
            action = segment.pop()
            engine.step(action)
            state = engine.state_vector()
            pushing = len(actions) > 1 and action == actions[-1] and action % 3 == Drive.FORWARD
            if _touches(states[0], state, moment.held) or (pushing and _distance(states[-1], state) < BLOCKED):
                left = max(1, len(states) - BACK)
                del states[left:], saved[left:], actions[left - 1 :]
                engine.set_state(saved[-1])
                bumps, segment = bumps + 1, []
            else:
                states.append(state)
                saved.append(engine.get_state())
                actions.append(action)
    except PhysicsError:
        pass  # the steps until then can be used
    return _Play(np.array(states), np.array(actions, dtype=np.int64))


def _segment(gripper: Gripper, rng: np.random.Generator) -> list[int]:
    """One action a few times: a turn, a drive, or both."""
    turn, drive, most = SEGMENTS[rng.integers(len(SEGMENTS))]
    action = Action(gripper, Turn(int(rng.integers(1, 3))) if turn else Turn.NONE, drive)
    return [action.number] * int(rng.integers(1, most + 1))


def _distance(state: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    return float(np.linalg.norm(state[:2] - other[:2]))


def _touches(start: NDArray[np.float32], state: NDArray[np.float32], held: int | None) -> bool:
    """Whether another block has moved since the start, or the held one has slipped."""
    before, now = (blocks_of(torch.from_numpy(values[None]))[0, :, 1:3].numpy() for values in (start, state))
    moved = np.linalg.norm(now - before, axis=1)
    if held is not None:
        if np.linalg.norm(in_hand(state, held) - in_hand(start, held)) > SLIPPED:
            return True
        moved[held] = 0.0
    return bool(moved.max() > TOUCHED)


def _turn(angle: Any) -> Floats:
    """The matrix that rotates columns by an angle, and rows back."""
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def _transformed(play: _Play, replay: Replay, moment: _Moment, rng: np.random.Generator) -> Samples | None:
    """Samples of a play's first part, transformed so that it ends at a moment.

    Only steps with a clear and direct remaining path become samples. None if there are no such steps.
    """
    end = int(rng.integers(min(BACK + 1, len(play.actions)), len(play.actions) + 1))
    context, last = replay.states[moment.step], play.states[end]
    angle = float(context[2] - last[2])
    turn = _turn(angle)

    def transformed(positions: NDArray[Any]) -> Floats:
        return context[:2] + (positions - last[:2]) @ turn.T

    blocks = blocks_of(torch.from_numpy(play.states)).numpy()
    poses = np.concatenate([transformed(play.states[:, :2]), play.states[:, 2:3].astype(float) + angle], 1)
    ahead = front(poses) if moment.held is None else transformed(blocks[:, moment.held, 1:3])
    steps = np.arange(end)
    here = np.array([moment.step])
    displaceable = replay.displaceable(here)
    removable = displaceable[2][0, MAX_REGIONS:].numpy() & replay.deliveries
    clear = _clear(poses[:end], ahead[:end], replay, moment, removable)
    good = clear & _direct(poses[:end], context[:3], end - steps)
    steps = steps[good]
    if not len(steps):
        return None
    states = torch.from_numpy(np.repeat(context[None], len(steps), 0))
    states[:, :3] = torch.from_numpy(poses[steps])
    states[:, FINGERS] = torch.from_numpy(play.states[steps][:, FINGERS])
    if moment.held is not None:
        held = blocks_of(states)[:, moment.held]
        held[:, 1:3] = torch.from_numpy(ahead[steps])
        held[:, 3] = torch.from_numpy(blocks[steps, moment.held, 3] + angle)
    later = np.linspace(steps, end, PATH_POINTS // 2, axis=1).round().astype(int)
    path = torch.from_numpy(np.concatenate([poses[later][..., :2], ahead[later]], 1)).float()
    others = blocks_of(states)
    near = torch.cdist(path, others[..., 1:3]).amin(1) < APART[0]
    others[..., 0] *= ~(near & torch.from_numpy(removable))
    displaceable, freedoms = (
        [part.expand(len(steps), *part.shape[1:]) for part in parts] for parts in (displaceable, replay.freedoms(here))
    )
    actions = torch.from_numpy(play.actions[steps])
    return Samples._make([states, actions, *displaceable, path, *freedoms, replay.looks(len(steps))])


def _clear(
    poses: Floats, ahead: Floats, replay: Replay, moment: _Moment, removable: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Whether the remaining path keeps the clearance `APART` from other blocks, or at least that of its end.

    Blocks that may be missing do not count: they are removed from the samples if they are too close.
    """
    blocks = blocks_of(torch.from_numpy(replay.states[moment.step : moment.step + 1]))[0].numpy()
    others = (blocks[:, 0] > 0) & ~removable
    if moment.held is not None:
        others[moment.held] = False
    positions, clear = blocks[others, 1:3], np.ones(len(poses), bool)
    if not len(positions):
        return clear
    ends = [replay.states[moment.step, :2], *(() if moment.held is None else (blocks[moment.held, 1:3],))]
    for own, end, apart in zip((poses[:, :2], ahead), ends, APART, strict=False):
        least = np.minimum(apart, np.linalg.norm(positions - end, axis=1) - TOUCHED)
        clear &= (np.linalg.norm(own[:, None] - positions, axis=2) > least).all(1)
    return np.logical_and.accumulate(clear[::-1])[::-1]


def _direct(poses: Floats, end: NDArray[Any], steps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether the remaining path is not much longer (`LONGER`) than turning, driving straight and turning again."""
    to_end = end[:2] - poses[:, :2]
    distance = np.linalg.norm(to_end, axis=1)
    bearing = np.arctan2(to_end[:, 1], to_end[:, 0]) - math.pi / 2 - poses[:, 2]
    final = end[2] - poses[:, 2]
    turns = np.where(distance < CLOSE, _size(final), _size(bearing) + _size(final - bearing))
    shortest = distance / SPEED[0] + turns / SPEED[1]
    return steps <= LONGER[0] * shortest + LONGER[1]


def _size(angles: Floats) -> Floats:
    """The absolute values of angles, at most pi."""
    return np.abs((angles + math.pi) % math.tau - math.pi)
