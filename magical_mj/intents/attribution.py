"""Attribution: the goals that stored episodes pursued, and the last solvable step of failed episodes.

Episodes are replayed in worker processes, and each ending is classified from the initial and the final scene. Rivals of
a task's intent are other intents that its demonstrations also reach. For each failed episode, the rivals that it
reached are found. On request, its last solvable step is found: the expert still solves the task from there, but not
later.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from magical_mj import demos
from magical_mj.actions import ACTIONS, Gripper
from magical_mj.evaluation.replay import engine_for, in_chunks, obstacle, replay_problem
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.intents import Intent, rivals
from magical_mj.intents.ambiguity import Ends, Judge
from magical_mj.intents.expert_data import with_scenes
from magical_mj.intents.names import has_intent, task_intent
from magical_mj.intents.plans import planned
from magical_mj.intents.readings import (
    ELSEWHERE,
    READINGS,
    DemonstratedBlocks,
    ending,
    intended_blocks,
    moved_blocks,
)
from magical_mj.intents.tasks import PREFIX
from magical_mj.policies.interface import actions_of
from magical_mj.scene import Scene
from magical_mj.tasks.languages import in_language
from magical_mj.tasks.planning import Noise
from magical_mj.tasks.registry import check_rules, task_spec
from magical_mj.utils.errors import PhysicsError
from magical_mj.utils.parallel import map_unordered

if TYPE_CHECKING:
    from magical_mj.engine import Engine, State

BITS: Final = 24.0
"""The longest description of a rival, in bits."""
_SCENES: Final = re.compile(r"demonstrations? in (\d*) ?(contrasting )?scenes?\b")
RECENT: Final = 64
"""The number of tasks whose rivals are kept in memory."""


@dataclass(frozen=True)
class Attribution:
    """What one episode did between its first and last scene.

    Attributes:
        ending: shares of `magical_mj.intents.readings.ENDINGS`, which sum to 1.
        moved: the blocks whose final position differs from the initial one.
        right_first: whether the first block that moved had to be moved. If several moved at the same step: any of them.
        rivals: the rivals that a failed episode reached: they hold at its end, but not at its start. Index in
            `task_rivals` -> share by bits; shares sum to 1. The simplest rival is first.
        remaining: the length (world units) of the moves that the task's plan still has at the end.
    """

    episode: EpisodeResult
    initial: Scene
    final: Scene
    ending: Mapping[str, float]
    moved: tuple[int, ...]
    right_first: bool
    rivals: Mapping[int, float]
    remaining: float


Unexplained = tuple[EpisodeResult, str]
"""An episode that cannot be attributed, and why."""


@lru_cache(maxsize=RECENT)
def task_ends(task: str) -> tuple[Ends, ...]:
    """The first and last scenes of the shipped demonstrations. For an intent: its demo scenes, and its plans' ends."""
    if in_language(task):
        intent = task_intent(task)
        return tuple(planned(intent, demo) for demo in task_spec(task).demos)
    return tuple(demonstration.ends() for demonstration in demos.load(task))


@lru_cache(maxsize=RECENT)
def demonstrated_blocks(task: str) -> DemonstratedBlocks:
    """The blocks that the demonstrations in the first demo scene of a task move."""
    ends = task_ends(task)
    return DemonstratedBlocks.of([pair for pair in ends if pair[0] == ends[0][0]])


@lru_cache(maxsize=RECENT)
def task_rivals(task: str) -> tuple[Intent, ...]:
    """The rivals that the demonstrations of a task leave, without the task's own intent; the simplest first."""
    return tuple(intent for intent in rivals(task_ends(task), BITS) if intent != task_intent(task))


def shown_task(episode: EpisodeResult) -> str:
    """The task of an episode, with the demo scenes of the demonstrations that the policy received."""
    found = _SCENES.search(episode.given)
    if found is None or not episode.task.startswith(PREFIX):
        return episode.task
    return with_scenes(episode.task, int(found[1] or 0) or None, contrasting=bool(found[2]))


def attribute(episodes: Iterable[EpisodeResult], *, jobs: int | None = None) -> Iterator[Attribution | Unexplained]:
    """Attributes episodes, in order of completion. None may be `unfit`. Include solved ones: they count in shares."""
    groups = defaultdict[str, list[tuple[str, EpisodeResult]]](list)
    for episode in episodes:
        groups[episode.given].append(("", episode))
    chunks = [[episode for _, episode in chunk] for group in groups.values() for chunk in in_chunks(group)]
    shown = [shown_task(chunk[0]) for chunk in chunks]
    work = [(chunk, demonstrated_blocks(task), task_rivals(task)) for chunk, task in zip(chunks, shown, strict=True)]
    results = map(_attribute, work) if jobs == 1 or len(work) < 2 else map_unordered(_attribute, work, jobs)
    for result in results:
        yield from result


def unfit(
    episode: EpisodeResult, recorded: Mapping[str, Any] = MappingProxyType({}), trusted: Collection[str] = ()
) -> str | None:
    """Why an episode cannot be attributed, as far as is known before its replay, or None. See `obstacle`."""
    if not has_intent(episode.task):
        return f"{episode.task} has no intent in the language"
    if episode.shift:
        return f"it was played with the shift {episode.shift}"
    if episode.other:
        return f"it was played as a control: the policy received a description of {episode.other}"
    if episode.failure is not None:
        return "the policy failed"
    return obstacle(episode, recorded, trusted)


def _attribute(
    work: tuple[Sequence[EpisodeResult], DemonstratedBlocks, tuple[Intent, ...]],
) -> list[Attribution | Unexplained]:
    """The work of one process: some episodes of one environment, the demonstrated blocks, and the rivals."""
    chunk, demonstrated, intents = work
    judge = Judge(intents)
    with closing(engine_for(chunk[0])) as engine:
        return [_attributed(episode, engine, demonstrated, judge) for episode in chunk]


def _attributed(
    episode: EpisodeResult, engine: Engine, demonstrated: DemonstratedBlocks, judge: Judge
) -> Attribution | Unexplained:
    engine.reset(seed=None if episode.seed == engine.seed else episode.seed)
    first: list[int] = []

    def watch(_: int) -> None:
        if not first:
            first.extend(moved_blocks(engine.initial_scene, engine.scene))

    if problem := replay_problem(episode, engine, watch):
        return episode, problem
    intent, initial, final = task_intent(episode.task), engine.initial_scene, engine.scene
    solved = episode.score == 1.0
    return Attribution(
        episode=episode,
        initial=initial,
        final=final,
        ending=ending(intent, demonstrated, initial, final, solved=solved),
        moved=moved_blocks(initial, final),
        right_first=not intended_blocks(intent, initial).isdisjoint(first),
        rivals={} if solved else _shares(judge, initial, final),
        remaining=0.0 if solved else remaining(episode, (initial, final)),
    )


def _shares(judge: Judge, initial: Scene, final: Scene) -> dict[int, float]:
    """The reached intents by number, each with its share: an intent of n bits has the weight 2 to the power of -n."""
    reached = np.flatnonzero(judge.reached(initial, final)).tolist()
    if not reached:
        return {}
    bits = np.array([judge.intents[index].bits for index in reached])
    weights = np.exp2(-(bits - bits.min()))
    return dict(zip(reached, (weights / weights.sum()).tolist(), strict=True))


def remaining(episode: EpisodeResult, scenes: tuple[Scene, Scene]) -> float:
    """The length (world units) of the moves that the task's plan still has in the second of two scenes."""
    noise = Noise(np.random.default_rng(0), 0.0)
    subgoals = task_spec(episode.task).subgoals(scenes, noise, check_rules(episode.rules))
    return sum(subgoal.left(scenes[1]) for subgoal in subgoals)


ANOTHER_GOAL: Final = "pursued another goal"
MISSED: Final = "missed the grip"
NOTHING: Final = "did nothing"
OUT_OF_TIME: Final = "ran out of time"
UNSOLVABLE: Final = "made it unsolvable"
FAILURES: Final[Mapping[str, str]] = {
    ANOTHER_GOAL: "only wrong blocks were moved, or the robot drove to where the demonstrations' region was",
    MISSED: "no block was moved, although the gripper was closed",
    NOTHING: "no block was moved, and the gripper was not closed",
    OUT_OF_TIME: "from the last state, the expert solves the task with the steps of a whole episode",
    UNSOLVABLE: "the expert does not solve it even then",
}
"""Why episodes fail: the first of these that holds."""


@dataclass(frozen=True)
class LastSolvable:
    """The last step of a failed episode from where it could still be solved, and why it failed.

    Attributes:
        last: the largest number of actions that still lets the expert solve the task in the remaining
            steps. None: it does not even solve the initial scene.
        failure: one of `FAILURES`.
    """

    attribution: Attribution
    last: int | None
    failure: str

    @property
    def episode(self) -> EpisodeResult:
        """The stored episode."""
        return self.attribution.episode


def last_solvable_steps(attributions: Iterable[Attribution], *, jobs: int | None = None) -> Iterator[LastSolvable]:
    """The results of `last_solvable_step`, in order of completion. Each takes seconds, or half a minute."""
    failed = list(attributions)
    if jobs == 1 or len(failed) < 2:
        return map(last_solvable_step, failed)
    return map_unordered(last_solvable_step, failed, jobs)


def last_solvable_step(attribution: Attribution) -> LastSolvable:
    """Finds the last solvable step of a failed episode, and why it failed.

    The step is found by bisection. This assumes that an episode cannot become solvable again; if it does, a later step
    may be missed. Only the expert with seed 0 is tried, so the result is a lower bound.
    """
    episode = attribution.episode
    with closing(engine_for(episode)) as engine:
        states = [engine.get_state()]
        for action in actions_of(episode.actions):
            engine.step(action)
            states.append(engine.get_state())
        if not _solves(engine, states[0]):
            return LastSolvable(attribution, None, _failure(attribution, engine, states[-1]))
        low, high = 0, len(states) - 1
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if _solves(engine, states[middle]) else (low, middle)
        return LastSolvable(attribution, low, _failure(attribution, engine, states[-1]))


def _failure(attribution: Attribution, engine: Engine, last: State) -> str:
    kinds = attribution.ending
    if kinds.keys() & {*READINGS, *ELSEWHERE}:
        return ANOTHER_GOAL
    if "nothing" in kinds:
        episode = attribution.episode
        closes = any(ACTIONS[action][0] is Gripper.CLOSE for action in actions_of(episode.actions))
        grips = closes and intended_blocks(task_intent(episode.task), attribution.initial)
        return MISSED if grips else NOTHING
    return OUT_OF_TIME if _solves(engine, replace(last, steps=0)) else UNSOLVABLE


def _solves(engine: Engine, state: State) -> bool:
    """Whether the expert solves the task from this state in the steps that are left."""
    from magical_mj.experts import Expert

    engine.set_state(state)
    expert = Expert(engine, engine.task or "")
    try:
        while not engine.over:
            engine.step(expert())
    except PhysicsError:
        return False
    return engine.score() == 1.0
