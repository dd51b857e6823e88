"""Samples of taking a block from close by, found by trying in the simulation of the demo scene.

Demonstrations come straight to a block and close the hand around it: none shows what to do next to one, or with one
that was pushed aside. Here the robot leaves a demonstration shortly before a grip, at random, and may push that block.
From there it tries some ways to take it: back off, turn to it, drive to it, close the hand. The shortest of those after
which the block follows the hand is what should have been done.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from magical_mj.engine import Engine
from magical_mj.engine.simulation import State
from magical_mj.learners.networks import blocks_of
from magical_mj.scene.actions import ACTIONS, Action, Drive, Gripper, Turn
from magical_mj.scene.state_vector import FINGERS
from magical_mj.utils.errors import PhysicsError
from magical_relational.hindsight import SPEED
from magical_relational.samples import MOVED, WAY, Replay, Samples, front, in_hand

NEAR: Final = range(4, 17)
"""Steps before a grip at which the robot leaves a demonstration."""
LATE: Final = 6
"""Steps after a block began to move, within which the hand closes if it takes the block."""
PIECES: Final = (2, 4)
"""The least and the greatest number of random pieces of driving or turning with which it leaves, each of up to
`LONGEST` steps."""
LONGEST: Final = 5
REACH: Final = 0.75
"""Units from the robot's middle to the block, from which it tries to take it."""
TRIES: Final = 8
"""Ways that are tried from one place."""
SHORTEST: Final = 7
"""Steps with which a way to a grip begins to tell something new."""
NEXT_TO: Final = 0.3
"""Units from the robot's middle to the block, where it stops driving and closes the hand."""
TURNS: Final = (-0.7, 0.7)
"""Steps by which it turns too little or too far, at random."""
DRIVES: Final = (-1.0, 2.0)
"""Steps by which it stops too early or too late."""
CLOSING: Final = 4
"""Steps in which the hand closes."""
PULLING: Final = 3
"""Steps backward with the hand closed, in which the block must follow."""
SLIPPED: Final = 0.05
"""Units that a held block may move in the hand while it is pulled."""
ALIKE: Final = 0.03
"""Units by which a grip may differ from one of a demonstration."""
STILL: Final = 0.02
"""Rad that a finger moves in a step at least, while it closes."""


class _Start(NamedTuple):
    """A step of a demonstration, shortly before it takes a block."""

    replay: Replay
    step: int
    block: int


class _Try:
    """What the robot does from a state on: states (steps + 1, names), and the actions between them."""

    def __init__(self, engine: Engine, state: State) -> None:
        engine.set_state(state)
        self._engine = engine
        self.states, self.actions = [engine.state_vector()], list[int]()

    def act(self, gripper: Gripper, turn: Turn, drive: Drive, times: int) -> None:
        """Does the same for some steps."""
        action = Action(gripper, turn, drive).number
        for _ in range(times):
            self._engine.step(action)
            self.states.append(self._engine.state_vector())
            self.actions.append(action)

    def wander(self, rng: np.random.Generator) -> None:
        """Leaves the demonstration with some random pieces of driving and turning."""
        for _ in range(rng.integers(PIECES[0], PIECES[1] + 1)):
            turn, drive = Turn(int(rng.integers(1, 3))), Drive(int(rng.integers(1, 3)))
            kind = rng.integers(3)
            times = int(rng.integers(1, LONGEST + 1))
            self.act(Gripper.OPEN, turn if kind else Turn.NONE, Drive.NONE if kind == 1 else drive, times)

    def take(self, block: int, rng: np.random.Generator) -> None:
        """Backs off or not, turns to a block, drives to it, and closes the hand."""
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
    """At least `count` samples of taking the blocks that demonstrations take; fewer if that hardly ever succeeds."""
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
    """Whether the hand closes about when a block begins to move."""
    around = replay.actions[max(0, begin - 2) : begin + LATE]
    return any(ACTIONS[action].gripper == Gripper.CLOSE for action in around)


def _free(replay: Replay, begin: int, early: int, block: int) -> bool:
    """Whether, so many steps before this block begins to move, nothing moves and nothing else comes first."""
    return early <= begin and replay.next[begin - early].min() == begin == replay.next[begin - early, block]


def _shortest(engine: Engine, start: _Start, grips: NDArray[Any], rng: np.random.Generator) -> _Try | None:
    """Leaves the demonstration, and tries to take the block from there."""
    aside = _Try(engine, start.replay.saved[start.step])
    aside.wander(rng)
    if _disturbs(start, aside) or np.linalg.norm(in_hand(aside.states[-1], start.block)) > REACH:
        return None
    saved, found = engine.get_state(), []
    for _ in range(TRIES):
        way = _Try(engine, saved)
        way.take(start.block, rng)
        after = _Try(engine, engine.get_state())
        after.act(Gripper.CLOSE, Turn.NONE, Drive.BACK, PULLING)
        hands = [in_hand(tried.states[-1], start.block) for tried in (way, after)]
        holds = np.linalg.norm(hands[1] - hands[0]) < SLIPPED
        if holds and np.linalg.norm(grips - hands[1], axis=1).min() < ALIKE and not _disturbs(start, after):
            found.append(way)
    best = min(found, key=lambda way: len(way.actions), default=None)
    return None if best is None or len(best.actions) < SHORTEST else best


def _disturbs(start: _Start, tried: _Try) -> bool:
    """Whether any other block has moved."""
    places = blocks_of(torch.from_numpy(tried.states[-1][None]))[0, :, 1:3].numpy()
    moved = np.linalg.norm(places - start.replay.places[start.step], axis=1) > MOVED
    moved[start.block] = False
    return bool(moved.any())


def _samples(start: _Start, way: _Try) -> Samples:
    """The steps of a way, up to when the fingers have closed."""
    states, actions = np.array(way.states), np.array(way.actions)
    count = len(actions)
    closing = np.abs(np.diff(states[:, FINGERS], axis=0)).max(1) > STILL
    steps = np.flatnonzero((np.arange(count) <= count - CLOSING) | closing)
    poses = np.concatenate([states[:, :2], front(states[:, :3])], 1).reshape(-1, 2, 2)
    later = np.linspace(steps, count, WAY // 2, axis=1).round().astype(int)
    ahead = torch.from_numpy(poses[later].transpose(0, 2, 1, 3).reshape(len(steps), WAY, 2))
    here = np.full(len(steps), start.step)
    pair, _, freedom = start.replay.freedoms(here)
    seen = torch.from_numpy(states[steps])
    pivot = blocks_of(seen)[:, start.block, 1:3].clone()
    return Samples(seen, torch.from_numpy(actions[steps]), *start.replay.loose(here), ahead, pair, pivot, freedom)
