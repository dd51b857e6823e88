"""Attribution: what stored episodes were after, from their initial and final scenes.

Episodes are replayed in worker processes. Of each the ending is classified, and of each that failed, the rivals of the
task's intent that it reached are found: intents of which the demonstrations cannot say that they were not meant.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from magical_mj import demos
from magical_mj.evaluation.replay import inconsistency, obstacle, other_scene
from magical_mj.evaluation.scores import SCORE_TOLERANCE, EpisodeResult
from magical_mj.intents import Intent, rivals
from magical_mj.intents.ambiguity import Ends, Judge
from magical_mj.intents.names import has_intent, task_intent
from magical_mj.intents.plans import planned
from magical_mj.intents.readings import Shown, ending, moved_blocks
from magical_mj.policies.interface import actions_of
from magical_mj.scene import Scene
from magical_mj.tasks.languages import in_language
from magical_mj.tasks.planning import Noise
from magical_mj.tasks.registry import check_rules, task_spec
from magical_mj.utils.errors import PhysicsError
from magical_mj.utils.parallel import map_unordered

if TYPE_CHECKING:
    from magical_mj.engine import Engine

BITS: Final = 24.0
"""The longest description of a rival."""
CHUNK: Final = 50
"""The number of episodes that a worker replays before it reports."""
RECENT: Final = 64
"""The number of tasks whose rivals are kept in memory."""


@dataclass(frozen=True)
class Attribution:
    """What one episode did.

    Attributes:
        episode: the stored episode.
        initial: the scene in which it began.
        final: the scene in which it ended.
        ending: shares of `magical_mj.intents.readings.ENDINGS`, which sum to 1.
        moved: the blocks that ended elsewhere than they began.
        rivals: of a failed episode, the numbers of the task's rivals that its end satisfies and its start did not, in
            the list of `task_rivals`, with their shares by bits, which sum to 1; the simplest first.
        remaining: the length (world units) of the moves that the task's plan still wants at the end.
    """

    episode: EpisodeResult
    initial: Scene
    final: Scene
    ending: Mapping[str, float]
    moved: tuple[int, ...]
    rivals: Mapping[int, float]
    remaining: float


@dataclass(frozen=True)
class Unexplained:
    """An episode that cannot be attributed, and why."""

    episode: EpisodeResult
    problem: str


@lru_cache(maxsize=RECENT)
def task_ends(task: str) -> tuple[Ends, ...]:
    """The initial and the final scene of each shipped demonstration.

    For an intent, these are its demo scenes and the ends of its plans there.
    """
    if in_language(task):
        intent = task_intent(task)
        return tuple(planned(intent, demo) for demo in task_spec(task).demos)
    scenes = [demonstration.scenes() for demonstration in demos.load(task)]
    return tuple((shown[0], shown[-1]) for shown in scenes)


@lru_cache(maxsize=RECENT)
def task_shown(task: str) -> Shown:
    """What the demonstrations in the first demo scene of a task show."""
    ends = task_ends(task)
    return Shown.of([pair for pair in ends if pair[0] == ends[0][0]])


@lru_cache(maxsize=RECENT)
def task_rivals(task: str) -> tuple[Intent, ...]:
    """The rivals that the demonstrations of a task leave, without the task's own intent; the simplest first."""
    return tuple(intent for intent in rivals(task_ends(task), BITS) if intent != task_intent(task))


def attribute(episodes: Iterable[EpisodeResult], *, jobs: int | None = None) -> Iterator[Attribution | Unexplained]:
    """What episodes did, as they come.

    Args:
        episodes: those about which `unfit` says nothing; solved ones too, if shares of all are wanted.
        jobs: the number of processes; None: one per core.
    """
    alike: dict[tuple[str, str, str, str], list[EpisodeResult]] = defaultdict(list)
    for episode in episodes:
        alike[episode.task, episode.variant, episode.rules, episode.body].append(episode)
    chunks: list[list[EpisodeResult]] = []
    for group in alike.values():
        group.sort(key=lambda episode: (episode.seed, episode.policy, episode.run))
        chunks += [group[start : start + CHUNK] for start in range(0, len(group), CHUNK)]
    chunks.sort(key=lambda chunk: -sum(len(episode.actions) for episode in chunk))
    work = [(chunk, task_shown(chunk[0].task), task_rivals(chunk[0].task)) for chunk in chunks]
    results = map(_attribute, work) if jobs == 1 or len(work) < 2 else map_unordered(_attribute, work, jobs)
    for result in results:
        yield from result


def unfit(
    episode: EpisodeResult, recorded: Mapping[str, Any] = MappingProxyType({}), trusted: Collection[str] = ()
) -> str | None:
    """Why an episode cannot be attributed; None if it can, as far as is known before it is replayed.

    The arguments are those of `magical_mj.evaluation.replay.obstacle`.
    """
    if not has_intent(episode.task):
        return f"{episode.task} has no intent in the language"
    if episode.shift:
        return f"it was played with the shift {episode.shift}"
    if episode.other:
        return f"it was played as a control: the policy received what describes {episode.other}"
    if "scene" in episode.given:
        return f"the policy received {episode.given}, and rivals are those that the task's own demonstrations leave"
    if episode.failure is not None:
        return "the policy failed"
    return obstacle(episode, recorded, trusted)


def _attribute(
    work: tuple[Sequence[EpisodeResult], Shown, tuple[Intent, ...]],
) -> list[Attribution | Unexplained]:
    """The work of one process: some episodes of one environment, what demonstrations show, and the rivals."""
    chunk, shown, intents = work
    judge, results = Judge(intents), []
    with closing(engine_for(chunk[0])) as engine:
        for episode in chunk:
            engine.reset(seed=None if episode.seed == engine.seed else episode.seed)
            problem = replay_problem(episode, engine)
            results.append(Unexplained(episode, problem) if problem else _attributed(episode, engine, judge, shown))
    return results


def engine_for(episode: EpisodeResult, renderer: str | None = None) -> Engine:
    """An engine at the start of an episode."""
    from magical_mj.engine import Engine  # which loads the simulator

    rules = check_rules(episode.rules)
    return Engine(episode.task, episode.variant, seed=episode.seed, rules=rules, body=episode.body, renderer=renderer)


def replay_problem(episode: EpisodeResult, engine: Engine) -> str | None:
    """Replays an episode in an engine at its start, and says how it differs from its record; None if it does not."""
    if problem := other_scene(episode, engine) or inconsistency(episode, engine.horizon):
        return problem
    try:
        for action in actions_of(episode.actions):
            engine.step(action)
    except PhysicsError as error:
        return f"it cannot be replayed: {error}"
    if abs(engine.score() - episode.score) > SCORE_TOLERANCE:
        return f"the score is {episode.score:g}, and its actions lead to {engine.score():g}"
    return None


def _attributed(episode: EpisodeResult, engine: Engine, judge: Judge, shown: Shown) -> Attribution:
    initial, final, success = engine.initial_scene, engine.scene, episode.score == 1.0
    return Attribution(
        episode,
        initial,
        final,
        ending(task_intent(episode.task), shown, initial, final, solved=success),
        moved_blocks(initial, final),
        {} if success else _shares(judge, initial, final),
        0.0 if success else remaining(episode, (initial, final)),
    )


def _shares(judge: Judge, initial: Scene, final: Scene) -> dict[int, float]:
    """The reached intents by number, each with its share: an intent of n bits has the weight 2 to the power of -n."""
    reached = np.flatnonzero(judge.reached(initial, final)).tolist()
    bits = np.array([judge.intents[index].bits for index in reached])
    weights = np.exp2(-(bits - bits.min())) if reached else bits
    return dict(zip(reached, (weights / weights.sum()).tolist(), strict=True)) if reached else {}


def remaining(episode: EpisodeResult, scenes: tuple[Scene, Scene]) -> float:
    """The length (world units) of the moves that the task's plan still wants in the second of two scenes."""
    noise = Noise(np.random.default_rng(0), 0.0)
    subgoals = task_spec(episode.task).subgoals(scenes, noise, check_rules(episode.rules))
    return sum(subgoal.left(scenes[1]) for subgoal in subgoals)
