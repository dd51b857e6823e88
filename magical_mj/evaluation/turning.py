"""The last step of a failed episode from which the expert still solves it, and what the failure was."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from magical_mj.evaluation.attribution import Attribution, engine_for
from magical_mj.intents.readings import READINGS
from magical_mj.policies.interface import actions_of
from magical_mj.scene.actions import ACTIONS, Gripper
from magical_mj.utils.errors import PhysicsError
from magical_mj.utils.parallel import map_unordered

if TYPE_CHECKING:
    from magical_mj.engine import Engine, State

ANOTHER_GOAL: Final = "pursued another goal"
MISSED: Final = "missed the grip"
NOTHING: Final = "did nothing"
OUT_OF_TIME: Final = "ran out of time"
UNSOLVABLE: Final = "made it unsolvable"
FAILURES: Final = (ANOTHER_GOAL, MISSED, NOTHING, OUT_OF_TIME, UNSOLVABLE)


@dataclass(frozen=True)
class Turning:
    """Where a failed episode was lost.

    Attributes:
        attribution: the episode.
        last: the number of actions after which the expert still solved it in the remaining steps; None if it does not
            solve the scene at all.
        failure: one of `FAILURES`.
    """

    attribution: Attribution
    last: int | None
    failure: str


def turnings(attributions: Iterable[Attribution], *, jobs: int | None = None) -> Iterator[Turning]:
    """Where failed episodes were lost, as they come. Each takes seconds, or half a minute."""
    pieces = list(attributions)
    return map(turning, pieces) if jobs == 1 or len(pieces) < 2 else map_unordered(turning, pieces, jobs)


def turning(attribution: Attribution) -> Turning:
    """Where a failed episode was lost.

    The last step is found by bisection, which assumes that a lost episode stays lost: if the expert solves it again
    from a later step, this may be missed. One expert is asked, the one with seed 0, so that the last step is a lower
    bound. The failure is the first of these that holds:

    - pursued another goal: wrong blocks were moved and none of those that had to be, or the robot went to where the
      demonstrations' region was (see `magical_mj.intents.readings.ending`);
    - missed the grip: no block was moved, though the gripper was closed; did nothing: nor was that;
    - ran out of time: from the last state, the expert solves it with the steps of a whole episode;
    - made it unsolvable: it does not.
    """
    episode = attribution.episode
    with closing(engine_for(episode)) as engine:
        states = [engine.get_state()]
        for action in actions_of(episode.actions):
            engine.step(action)
            states.append(engine.get_state())
        if not _solves(engine, states[0]):
            return Turning(attribution, None, _failure(attribution, engine, states[-1]))
        low, high = 0, len(states) - 1
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if _solves(engine, states[middle]) else (low, middle)
        return Turning(attribution, low, _failure(attribution, engine, states[-1]))


def _failure(attribution: Attribution, engine: Engine, last: State) -> str:
    kinds = attribution.ending
    if kinds.keys() & {*READINGS, "another block"}:
        return ANOTHER_GOAL
    if "nothing" in kinds:
        closes = any(ACTIONS[action][0] is Gripper.CLOSE for action in actions_of(attribution.episode.actions))
        return MISSED if closes else NOTHING
    return OUT_OF_TIME if _solves(engine, replace(last, steps=0)) else UNSOLVABLE


def _solves(engine: Engine, state: State) -> bool:
    """Whether the expert solves the task from this state in the steps that are left."""
    from magical_mj.policies.expert import Expert

    engine.set_state(state)
    expert = Expert(engine, engine.task or "")
    try:
        while not engine.over:
            engine.step(expert())
    except PhysicsError:
        return False
    return engine.score() == 1.0
