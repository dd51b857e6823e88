"""Samples of gripping a block from nearby, found by random search in the simulation of the demo scene.

Demonstrations approach a block directly and close the fingers around it. They do not show how to grip a block from
another pose next to it, or after the robot has pushed it aside. Here the robot leaves a demonstration at random shortly
before a grip, with open or closed fingers, and may push that block. Then it tries several random manoeuvres to grip the
block: back off, turn to it, drive to it, close the fingers. A manoeuvre succeeds if the block then follows the fingers.
The shortest successful one becomes the target action sequence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from magical_mj.actions import ACTIONS, Action, Drive, Gripper, Turn
from magical_mj.engine import Engine, State
from magical_mj.learners.networks import blocks_of
from magical_mj.observations import FINGERS
from magical_mj.utils.errors import PhysicsError
from magical_relational.hindsight import SPEED
from magical_relational.replay import MOVED, PATH_POINTS, Replay, Samples, front, in_hand

NEAR: Final = range(4, 17)
"""The robot leaves a demonstration this number of steps before a grip."""
LATE: Final = 6
"""In a grip, the fingers close within this number of steps after the block starts to move."""
SEGMENTS: Final = (2, 4)
"""The smallest and the largest number of random segments of driving or turning when the robot leaves."""
LONGEST: Final = 5
"""The largest number of steps of a segment."""
CLOSED: Final = 0.4
"""The share of attempts after closing the fingers."""
REACH: Final = 0.75
"""Attempts begin at most this far (units) from the block to the robot's centre."""
ATTEMPTS: Final = 8
"""The number of attempts from one state."""
SHORTEST: Final = 7
"""Grips with fewer steps are left out."""
NEXT_TO: Final = 0.3
"""The robot closes its fingers at this distance (units) from its centre to the block."""
TURNS: Final = (-0.7, 0.7)
"""The range of random errors of turns, in steps."""
DRIVES: Final = (-1.0, 2.0)
"""The range of random errors of drives, in steps."""
CLOSING: Final = 4
"""The number of steps for closing the fingers."""
PULLING: Final = 3
"""The number of steps that the robot drives back with closed fingers, to test whether the block follows."""
SLIPPED: Final = 0.05
"""The largest motion (units) of a held block between the fingers while it is pulled."""
ALIKE: Final = 0.03
"""A grip must hold the block within this distance (units) of its position in a demonstration's grip."""
STILL: Final = 0.02
"""A finger that moves by less (rad) in a step is not closing."""


class _Start(NamedTuple):
    """A step of a demonstration, shortly before it grips a block."""

    replay: Replay
    step: int
    block: int


class _Rollout:
    """A rollout from a state: states (steps + 1, names), and the actions between them."""

    def __init__(self, engine: Engine, state: State) -> None:
        engine.set_state(state)
        self._engine = engine
        self.states, self.actions = [engine.state_vector()], list[int]()

    def act(self, gripper: Gripper, turn: Turn, drive: Drive, times: int) -> None:
        """Repeats an action `times` times."""
        action = Action(gripper, turn, drive).number
        for _ in range(times):
            self._engine.step(action)
            self.states.append(self._engine.state_vector())
            self.actions.append(action)

    def wander(self, rng: np.random.Generator) -> None:
        """Leaves the demonstration with some random segments of driving and turning, with open or closed fingers."""
        gripper = Gripper(int(rng.random() < CLOSED))
        for _ in range(rng.integers(SEGMENTS[0], SEGMENTS[1] + 1)):
            turn, drive = Turn(int(rng.integers(1, 3))), Drive(int(rng.integers(1, 3)))
            kind = rng.integers(3)
            times = int(rng.integers(1, LONGEST + 1))
            self.act(gripper, turn if kind else Turn.NONE, Drive.NONE if kind == 1 else drive, times)

    def take(self, block: int, rng: np.random.Generator) -> None:
        """Backs off by up to four steps, turns to a block, drives to it, and closes the fingers."""
        self.act(Gripper.OPEN, Turn.NONE, Drive.BACK, int(rng.integers(LONGEST)))
        x, y = in_hand(self.states[-1], block)
        angle = math.atan2(-x, y)
        turns = max(0, round(abs(angle) / SPEED[1] + rng.uniform(*TURNS)))
        self.act(Gripper.OPEN, Turn.LEFT if angle > 0 else Turn.RIGHT, Drive.NONE, turns)
        distance = float(np.linalg.norm(in_hand(self.states[-1], block)))
        drives = max(0, round((distance - NEXT_TO) / SPEED[0] + rng.uniform(*DRIVES)))
        self.act(Gripper.OPEN, Turn.NONE, Drive.FORWARD, drives)
        self.act(Gripper.CLOSE, Turn.NONE, Drive.NONE, CLOSING)


def gripped(engine: Engine, replays: Sequence[Replay], count: int, rng: np.random.Generator) -> list[Samples]:
    """At least `count` samples of gripping the blocks that demonstrations grip. Fewer if few attempts succeed."""
    starts, grips = [], []
    for replay in replays:
        for block, begin, end in replay.motions():
            if _closes(replay, begin) and begin + LATE < end:
                grips.append(in_hand(replay.states[begin + LATE], block))
                starts += [_Start(replay, begin - early, block) for early in NEAR if _free(replay, begin, early, block)]
    parts: list[Samples] = []
    found = 0
    for _ in range(count if starts else 0):
        if found >= count:
            break
        start = starts[rng.integers(len(starts))]
        try:
            best = _shortest(engine, start, np.array(grips), rng)
        except PhysicsError:
            continue
        if best is not None:
            parts.append(_samples(start, best))
            found += len(parts[-1].actions)
    return parts


def _closes(replay: Replay, begin: int) -> bool:
    """Whether the fingers close around the time at which a block starts to move."""
    around = replay.actions[max(0, begin - 2) : begin + LATE]
    return any(ACTIONS[action].gripper == Gripper.CLOSE for action in around)


def _free(replay: Replay, begin: int, early: int, block: int) -> bool:
    """Whether no block moves in the `early` steps before this block starts to move."""
    return early <= begin and replay.next[begin - early].min() == begin == replay.next[begin - early, block]


def _shortest(engine: Engine, start: _Start, grips: NDArray[Any], rng: np.random.Generator) -> _Rollout | None:
    """Leaves the demonstration, and returns the shortest attempt that grips the block; None if all attempts fail."""
    aside = _Rollout(engine, start.replay.saved[start.step])
    aside.wander(rng)
    if _disturbs(start, aside) or np.linalg.norm(in_hand(aside.states[-1], start.block)) > REACH:
        return None
    saved, found = engine.get_state(), []
    for _ in range(ATTEMPTS):
        attempt = _Rollout(engine, saved)
        attempt.take(start.block, rng)
        after = _Rollout(engine, engine.get_state())
        after.act(Gripper.CLOSE, Turn.NONE, Drive.BACK, PULLING)
        hands = [in_hand(rollout.states[-1], start.block) for rollout in (attempt, after)]
        holds = np.linalg.norm(hands[1] - hands[0]) < SLIPPED
        if holds and np.linalg.norm(grips - hands[1], axis=1).min() < ALIKE and not _disturbs(start, after):
            found.append(attempt)
    best = min(found, key=lambda attempt: len(attempt.actions), default=None)
    return None if best is None or len(best.actions) < SHORTEST else best


def _disturbs(start: _Start, rollout: _Rollout) -> bool:
    """Whether any other block has moved."""
    positions = blocks_of(torch.from_numpy(rollout.states[-1][None]))[0, :, 1:3].numpy()
    moved = np.linalg.norm(positions - start.replay.positions[start.step], axis=1) > MOVED
    moved[start.block] = False
    return bool(moved.any())


def _samples(start: _Start, attempt: _Rollout) -> Samples:
    """The samples of an attempt, until the fingers have closed."""
    states, actions = np.array(attempt.states), np.array(attempt.actions)
    count = len(actions)
    closing = np.abs(np.diff(states[:, FINGERS], axis=0)).max(1) > STILL
    steps = np.flatnonzero((np.arange(count) <= count - CLOSING) | closing)
    poses = np.concatenate([states[:, :2], front(states[:, :3])], 1).reshape(-1, 2, 2)
    later = np.linspace(steps, count, PATH_POINTS // 2, axis=1).round().astype(int)
    path = torch.from_numpy(poses[later].transpose(0, 2, 1, 3).reshape(len(steps), PATH_POINTS, 2))
    here = np.full(len(steps), start.step)
    pair, _, freedom = start.replay.freedoms(here)
    seen = torch.from_numpy(states[steps])
    pivot = blocks_of(seen)[:, start.block, 1:3].clone()
    displaceable, looks = start.replay.displaceable(here), start.replay.looks(len(here))
    return Samples(seen, torch.from_numpy(actions[steps]), *displaceable, path, pair, pivot, freedom, looks)
