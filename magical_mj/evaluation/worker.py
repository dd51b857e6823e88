"""Workers: they play units of work, each of some episodes of one environment with one policy, with a time limit."""

from __future__ import annotations

import ctypes
import queue
import secrets
import threading
import traceback
import weakref
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, wait
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, Final, TypeVar

import gymnasium

from magical_mj.envs.registration import env_id
from magical_mj.evaluation.rollouts import Env, Envs, play, play_side_by_side
from magical_mj.evaluation.scores import EpisodeResult, Key, Outcome
from magical_mj.evaluation.settings import WORLDS, EvaluationSettings
from magical_mj.policies.interface import (
    Act,
    BatchPolicy,
    Episode,
    PolicyError,
    reason,
    told_task,
    uses_instruction,
    uses_simulation,
)
from magical_mj.policies.loading import Source
from magical_mj.rendering.backend import drawn_by
from magical_mj.shifts.registry import split_body
from magical_mj.tasks.registry import sample_scene, task_spec
from magical_mj.utils.errors import SettingsError, UntrustedNameError, short_repr
from magical_mj.utils.imports import resolve, with_place

T = TypeVar("T")

SEEDS_PER_UNIT: Final = {"mujoco": 10, "warp": 100}
"""The most episodes in a unit: a few seconds, so that killed runs lose little, and units cost little; or one batch."""
GRACE: Final = 1.0
"""Seconds that a call has to end after it was stopped."""


@dataclass(frozen=True)
class Unit:
    """Some episodes of one environment with one policy: independent of all other units, and repeatable.

    `evaluation` identifies the evaluation: a policy that was loaded for another one may have changed since.
    """

    source: Source
    task: str
    variant: str
    seeds: tuple[int, ...]
    settings: EvaluationSettings
    evaluation: str = ""
    shift: str = ""

    @cached_property
    def keys(self) -> list[Key]:
        """The keys of its episodes."""
        source = self.source
        return [(source.name, source.run, self.task, self.variant, seed, self.shift) for seed in self.seeds]

    @cached_property
    def steps(self) -> int:
        """How many actions it takes."""
        return len(self.seeds) * task_spec(self.task).horizon(self.settings.rules)


def plan(policies: Sequence[Source], settings: EvaluationSettings, done: Collection[Key]) -> list[Unit]:
    """The remaining units, the longest first, so that all workers end at about the same time."""
    units = []
    size = SEEDS_PER_UNIT[settings.simulator]
    evaluation = secrets.token_hex(8)
    for task, variant in settings.environments:
        for source, shift in product(policies, settings.shift_labels(task, policies)):
            every = Unit(source, task, variant, tuple(settings.seeds), settings, evaluation, shift)
            left = tuple(seed for key, seed in zip(every.keys, every.seeds, strict=True) if key not in done)
            units += [replace(every, seeds=left[start : start + size]) for start in range(0, len(left), size)]
    return sorted(units, key=lambda unit: -unit.steps)


def play_here(units: Iterable[Unit]) -> Generator[tuple[list[EpisodeResult], Exception | None]]:
    """Plays units in this process; yields each result, and the error by which the policy failed."""
    with closing(Player()) as player:
        for unit in units:
            yield from (([result], player.cause) for result in player.play(unit))


_LOCAL = threading.local()
"""The player of this thread; a cluster's worker may have several threads."""


def play_unit(unit: Unit) -> tuple[list[EpisodeResult], Exception | None]:
    """What a worker does: plays episodes, and tells by which error the policy failed in the last one."""
    evaluation, player = getattr(_LOCAL, "player", ("", None))
    if player is None or evaluation != unit.evaluation:
        if player is not None:
            player.close()
        player = Player()
        _LOCAL.player = unit.evaluation, player
    results = list(player.play(unit))
    if player.cause is None:
        return results, None
    return results, PolicyError("".join(traceback.format_exception(player.cause)))  # others may not be picklable


class Player:
    """Plays an evaluation's units on a thread that can be abandoned.

    It keeps the last environment and policy for the next unit.

    Attributes:
        cause: the error by which the policy failed in the last episode.
    """

    def __init__(self) -> None:
        self.cause: Exception | None = None
        self._forget()

    def play(self, unit: Unit) -> Iterator[EpisodeResult]:
        """Plays the unit's episodes: side by side if the policy acts in batches, else one after another."""
        settings, source = unit.settings, unit.source
        task, policy = told_task(unit.task, settings.like), self._policy(unit)
        episodes = [Episode(task, unit.variant, seed, source.run) for seed in unit.seeds]
        facts = {
            **{name: getattr(settings, name) for name in ("rules", "split", "wrap", "body")},
            "policy": source.name,
            "preset": getattr(policy, "preset", None) if uses_simulation(policy) else settings.observed,
            "worlds": WORLDS[settings.simulator],
            "gl": drawn_by(settings.renderer),
            "shift": unit.shift,
        }
        for episode, outcome in zip(episodes, self._outcomes(unit, episodes), strict=True):
            self.cause = outcome.cause
            scene = start_digest(unit.task, unit.variant, episode.seed, unit.shift, settings.body)
            yield EpisodeResult.of(replace(episode, task=unit.task), outcome, scene=scene, **facts)

    def close(self) -> None:
        """Closes the environments, unless an abandoned call may still use them."""
        if not self._caller.abandoned:
            for what in list(self._kept):
                self._drop(what)

    def _outcomes(self, unit: Unit, episodes: list[Episode]) -> Iterator[Outcome]:
        policy, settings = self._policy(unit), unit.settings
        batches = settings.batched or (isinstance(policy, BatchPolicy) and not settings.wrap)
        if batches and len(episodes) > 1 and not uses_simulation(policy):
            outcomes = self._play(unit, episodes, in_vector=True)
            if not any(outcome.failure for outcome in outcomes):
                yield from outcomes
                return
        for episode in episodes:  # one by one also finds out which of a batch fail
            yield from self._play(unit, [episode], in_vector=settings.batched)

    def _play(self, unit: Unit, episodes: list[Episode], *, in_vector: bool) -> list[Outcome]:
        """The outcomes of the episodes, which all failed if playing them takes too long."""
        policy, place = self._policy(unit), (unit.task, unit.variant, unit.shift)  # a new one, after a time limit
        reads = uses_instruction(policy)
        if in_vector:
            key = (*place, len(unit.seeds), reads)
            envs = lambda: self._keep("vector", key, lambda: _vector_env(unit, reads))  # noqa: E731
            playing = lambda: play_side_by_side(envs(), policy, episodes)  # noqa: E731
        else:
            observed = bool(unit.settings.wrap) or not uses_simulation(policy)
            key = (*place, observed, reads)
            env = self._keep("environment", key, lambda: single_env(unit, observed, reads))
            playing = lambda: [play(env, policy, episode) for episode in episodes]  # noqa: E731
        seconds = unit.settings.time_limit * len(episodes)
        try:
            return self._caller.call(playing, seconds)
        except TimeLimitError as error:
            self._forget()
            return [Outcome(failure=reason(error), seconds=seconds)] * len(episodes)

    def _policy(self, unit: Unit) -> Act:
        key = unit.source.name, unit.source.run
        return self._keep("policy", key, lambda: self._caller.call(unit.source.load, None))

    def _keep(self, what: str, key: Any, make: Callable[[], T]) -> T:
        """The object made for this key; one that was kept for another key is replaced."""
        if what in self._kept and self._kept[what][0] != key:
            self._drop(what)
        if what not in self._kept:
            self._kept[what] = key, make()
        return self._kept[what][1]

    def _drop(self, what: str) -> None:
        _, thing = self._kept.pop(what)
        if what != "policy":  # which may be a user's object
            thing.close()

    def _forget(self) -> None:
        """Drops environment and policy: an episode that did not end may still be using them."""
        self._kept: dict[str, tuple[Any, Any]] = {}
        self._caller = TimeLimitedCaller()


def arguments(unit: Unit) -> dict[str, Any]:
    """How a unit's environments are made."""
    settings = unit.settings
    return {"rules": settings.rules, "renderer": settings.renderer, "shifts": unit.shift, "body": settings.body}


def single_env(unit: Unit, observed: bool, instruction: bool = False) -> Env:
    """The environment for a policy: Gymnasium's with the preset's observations, or the bare engine.

    With `instruction`, observations that are dicts hold the sentence that says what is to be done.
    The former has no wrappers of `gymnasium.make`, whose checks at each step would only take time, but the user's.
    """
    settings, how = unit.settings, arguments(unit)
    if observed:
        name = env_id(unit.task, unit.variant, settings.observed)
        env = gymnasium.make(name, instruction=instruction, **how).unwrapped
        return _wrapped(env, settings.wrap) if settings.wrap else env
    from magical_mj.engine import Engine  # imported late: it loads the simulator

    return Engine(unit.task, unit.variant, seed=0, **how)


def start_digest(task: str, variant: str, seed: int, shift: str, body: str) -> str:
    """The digest of the scene in which an episode starts."""
    if not shift:
        return sample_scene(task, variant, seed, body).digest()
    from magical_mj.engine.engine import Setup  # imported late: it loads the simulator

    strengths, body = split_body(shift, task, body)
    return Setup(task, variant, body=body).begin(strengths, seed)[0].digest()


def _wrapped(env: gymnasium.Env[Any, Any], wrap: str) -> gymnasium.Env[Any, Any]:
    """The environment in the user's wrapper."""
    try:
        outer: Any = resolve(wrap)(env)
    except UntrustedNameError:
        raise
    except (Exception, SystemExit) as error:
        raise SettingsError(f"the wrapper {wrap} cannot be used: {with_place(error)}") from error
    if (
        not isinstance(outer, gymnasium.Env)
        or outer.unwrapped is not env.unwrapped
        or outer.action_space != env.action_space
    ):
        raise SettingsError(
            f"the wrapper {wrap} must return a Gymnasium environment around the one that it is given, with its 18 "
            f"actions, not {short_repr(outer)}"
        )
    return outer


def _vector_env(unit: Unit, instruction: bool) -> Envs:
    settings, number = unit.settings, len(unit.seeds)
    how: dict[str, Any] = {"preset": settings.observed, "autoreset_mode": gymnasium.vector.AutoresetMode.DISABLED}
    if not settings.batched:
        from magical_mj.envs.vector import make_vec  # imported late: it loads the simulator

        threads = None if settings.jobs == 1 else 1  # other processes have the other cores
        how |= {"threads": threads, "instruction": instruction, **arguments(unit)}
        return make_vec(unit.task, number, variant=unit.variant, **how)
    from magical_mj import batched  # these need PyTorch
    from magical_mj.batched.environment import Arrays

    envs = batched.make(unit.task, unit.variant, number, device=settings.device, rules=settings.rules, **how)
    return Arrays(envs)


class TimeLimitError(Exception):
    """A call took too long."""


class _Stop(BaseException):
    """Raised inside a call that took too long; not an `Exception`, so that handlers in the call do not catch it."""


class TimeLimitedCaller:
    """A thread that makes calls one after another, with a time limit.

    An alarm signal would need no thread, but works only in the main thread, which cluster workers may not use. A call
    that runs Python code is stopped; one that is stuck outside Python is abandoned.

    Attributes:
        abandoned: whether a call may still be running whose result nobody waits for: then this object must not be used
            again.
    """

    def __init__(self) -> None:
        self.abandoned = False
        self._calls: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._thread = threading.Thread(target=_work, args=(self._calls,), daemon=True, name="magical_mj episodes")
        self._thread.start()
        weakref.finalize(self, self._calls.put, None)  # nobody will call any more

    def call(self, function: Callable[[], T], seconds: float | None) -> T:
        """Returns or raises what the function does, or a `TimeLimitError` after this time; None means no limit."""
        result: Future[T] = Future()
        self._calls.put((function, result))
        try:
            wait([result], seconds)
        finally:  # Ctrl-C, or a signal's handler, may have raised something
            if not result.done():
                self.abandoned = True
                ident = self._thread.ident or 0
                ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(ident), ctypes.py_object(_Stop))
                self._thread.join(GRACE)
        if self.abandoned:
            raise TimeLimitError(f"no end within {seconds:g} s")
        return result.result()


def _work(calls: queue.SimpleQueue[Any]) -> None:
    """The thread's function. It holds neither its caller nor past calls, so that all end when nobody holds them."""
    while (call := calls.get()) is not None:
        function, result = call
        try:
            result.set_result(function())
        except _Stop:
            return
        except BaseException as error:  # noqa: BLE001 the caller gets it
            result.set_exception(error)
        del call, function, result
