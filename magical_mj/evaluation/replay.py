"""Replays of stored episodes in worker processes: they check the scores, or compute them by other rules.

`obstacle` decides which episodes can be replayed. Everything that replays or shows stored episodes calls it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace as changed
from functools import partial
from itertools import chain
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from magical_mj.evaluation.base import UNOFFICIAL
from magical_mj.evaluation.scores import SCORE_TOLERANCE, EpisodeResult
from magical_mj.policies.interface import LETTERS, actions_of
from magical_mj.protocol import PROTOCOL
from magical_mj.scene.bodies import check_body_name
from magical_mj.shifts.registry import BODY, SHIFT_PROTOCOL, code_digests, names_in, shift_label, split_body
from magical_mj.tasks import KNOWN
from magical_mj.tasks.registry import check_rules, code_digest, task_spec
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import MagicalError, PhysicsError
from magical_mj.utils.imports import check_named
from magical_mj.utils.parallel import map_unordered

if TYPE_CHECKING:
    from magical_mj.engine import Engine

CHUNK: Final = 50
"""The number of episodes that a worker replays before it reports."""

Recorded = tuple[Any, EpisodeResult]
"""An identifier that the caller chooses, such as the name of an entry, and an episode."""
Replayed = tuple[Any, EpisodeResult, str | None]
"""The identifier, the episode (by other rules if requested), and how the replay differs from its record, or None."""


def obstacle(
    episode: EpisodeResult, recorded: Mapping[str, Any] = MappingProxyType({}), trusted: Collection[str] = ()
) -> str | None:
    """Why this version cannot replay an episode from its seed and its actions. None if it can.

    The answer depends on the simulator, the wrapper, the task, the rules, the body, the shift, and the protocol. It
    does not depend on the renderer: replays draw no pictures, and films draw new ones.

    Args:
        episode: the stored episode.
        recorded: the known settings of its evaluation (``run.json``).
        trusted: references such as "mine:SPEC" that the episode may contain; see docs/trust.md.

    Raises:
        UntrustedNameError: if the episode contains another reference to a task, body or shift.
    """
    if episode.worlds != "single":
        return f"it was played in batched environments: {UNOFFICIAL}"
    if episode.wrap:
        return f"it was played in the wrapper {episode.wrap}, which may have changed its actions and states"
    for name, number in {"protocol": PROTOCOL, "shift_protocol": SHIFT_PROTOCOL}.items():
        if recorded.get(name) not in (None, number) and (name == "protocol" or episode.shift):
            return f"it follows {name.replace('_', ' ')} {recorded[name]}, but this version plays {number}"
    for name in (episode.task, episode.body, *names_in(episode.shift)):
        check_named(name, "an episode", trusted)
    try:
        check_rules(episode.rules)
        task_spec(episode.task)
        check_body_name(split_body(episode.shift, episode.task, episode.body)[1])
        own = {} if episode.task in KNOWN else {episode.task: code_digest(episode.task)}
        own |= code_digests(f"{episode.shift}+{shift_label({BODY: episode.body})}")
        for name, digest in own.items():
            if recorded.get(f"code of {name}") not in (None, digest):
                return f"the code of {name} has changed since it was played"
    except (MagicalError, ImportError) as error:
        return str(error)
    return None


def replay(
    recorded: Iterable[Recorded], *, rules: Rules | None = None, jobs: int | None = None, trusted: Collection[str] = ()
) -> Iterator[Replayed]:
    """Replays episodes in worker processes, and compares their scenes and scores with the records.

    Args:
        recorded: the episodes.
        rules: score them again by these rules, after as many steps as an episode has by them. None: by their own rules.
        jobs: the number of processes. None: one per core.
        trusted: see `obstacle`.

    Returns:
        The episodes in order of completion. If an episode has an `obstacle`, it is reported as its difference.
    """
    refused: list[Replayed] = []
    playable: list[Recorded] = []
    for source, episode in recorded:
        if problem := obstacle(episode, trusted=trusted):
            refused.append((source, episode, f"{episode.title}: it cannot be replayed: {problem}"))
        else:
            playable.append((source, episode))
    chunks, work = in_chunks(playable), partial(_replay, rules=rules)
    results = map(work, chunks) if jobs == 1 or len(chunks) == 1 else map_unordered(work, chunks, jobs)
    return chain(refused, chain.from_iterable(results))


def in_chunks(recorded: Iterable[Recorded]) -> list[list[Recorded]]:
    """Chunks of episodes of one environment, sorted by seed, so that each scene is compiled once. The longest first."""
    alike: dict[tuple[str, ...], list[Recorded]] = defaultdict(list)
    for source, episode in recorded:
        alike[episode.task, episode.variant, episode.rules, episode.shift, episode.body].append((source, episode))
    chunks: list[list[Recorded]] = []
    for episodes in alike.values():
        episodes.sort(key=lambda recorded: (recorded[1].seed, str(recorded[0])))
        chunks += [episodes[start : start + CHUNK] for start in range(0, len(episodes), CHUNK)]
    return sorted(chunks, key=lambda chunk: -sum(len(episode.actions) for _, episode in chunk))


def _replay(chunk: Sequence[Recorded], rules: Rules | None) -> list[Replayed]:
    """Replays episodes of one environment in this process."""
    results = []
    with closing(engine_for(chunk[0][1])) as engine:
        for source, episode in chunk:
            engine.reset(seed=None if episode.seed == engine.seed else episode.seed)  # None keeps the scene
            rescored, difference = _rescored(episode, engine, rules)
            results.append((source, rescored, f"{episode.title}: {difference}" if difference else None))
    return results


def engine_for(episode: EpisodeResult, renderer: str | None = None) -> Engine:
    """An engine at the start of an episode, which has no `obstacle`."""
    from magical_mj.engine import Engine  # imported late: it loads the simulator

    how: dict[str, Any] = {"rules": check_rules(episode.rules), "shifts": episode.shift, "body": episode.body}
    return Engine(episode.task, episode.variant, seed=episode.seed, renderer=renderer, **how)


def _rescored(episode: EpisodeResult, engine: Engine, rules: Rules | None) -> tuple[EpisodeResult, str | None]:
    """Replays an episode in an engine at its start. Returns it scored by `rules`, and the problem, or None."""
    if rules is None:
        return episode, replay_problem(episode, engine)
    spec, scores = task_spec(episode.task), list[float]()
    steps = spec.horizon(rules, episode.body)

    def note(step: int) -> None:
        if step == steps:
            scores.append(spec.checked_score(engine.scored_scenes, rules))

    problem = replay_problem(episode, engine, note)
    if problem is None and engine.horizon is not None and steps > engine.horizon:
        problem = f"it has {engine.horizon} actions, but needs {steps} by the rules {rules!r}: play it again by these"
    if problem is not None:
        return episode, problem
    if not scores:  # the policy failed
        return changed(episode, rules=rules), None
    return changed(episode, rules=rules, score=scores[0], steps=steps, actions=episode.actions[:steps]), None


def replay_problem(
    episode: EpisodeResult, engine: Engine, watch: Callable[[int], object] = lambda _: None
) -> str | None:
    """Replays an episode in an engine at its start, and says how it differs from its record. None if it does not.

    `watch` is called after each step with its number. If the policy failed, nothing is replayed.
    """
    if problem := other_scene(episode, engine) or inconsistency(episode, engine.horizon):
        return problem
    if episode.failure is not None:
        return None
    try:
        for step, action in enumerate(actions_of(episode.actions), start=1):
            engine.step(action)
            watch(step)
    except PhysicsError as error:
        return f"it cannot be replayed: {error}"
    if abs(engine.score() - episode.score) > SCORE_TOLERANCE:
        return f"the score is {episode.score:g}, but its actions lead to {engine.score():g}"
    return None


def other_scene(episode: EpisodeResult, engine: Engine) -> str | None:
    """How the recorded scene of an episode differs from the engine's initial scene. None if equal or not recorded."""
    digest = engine.initial_scene.digest()
    if episode.scene in (None, digest):
        return None
    return f"it was played in the scene {episode.scene}, but the seed's scene is {digest}"


def inconsistency(episode: EpisodeResult, horizon: int | None) -> str | None:
    """What is wrong with an episode's failure, actions or length. None if nothing is. Episodes have `horizon` steps."""
    if episode.failure is not None:
        return None if episode.score == 0 else f"the policy failed, but its score is {episode.score:g} instead of 0"
    if set(episode.actions) - set(LETTERS):
        return "its actions are not all among the 18"
    if len(episode.actions) != horizon:
        return f"it has {len(episode.actions)} actions, but episodes have {horizon}"
    return None
