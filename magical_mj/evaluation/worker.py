"""Workers: they play units of work, each of some episodes of one environment with one policy, with a time limit."""

from __future__ import annotations

import functools
import secrets
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeVar

import gymnasium

from magical_mj.envs.registration import env_id
from magical_mj.evaluation.rollouts import Envs, PolicyCopies, environment_for, play, play_side_by_side
from magical_mj.evaluation.scores import EpisodeResult, Key, result_of
from magical_mj.evaluation.settings import WORLDS, EvaluationSettings
from magical_mj.evaluation.time_limit import TimeLimitedCaller, TimeLimitError
from magical_mj.policies.interface import Act, BatchPolicy, Episode, reason, uses_simulation
from magical_mj.policies.loading import Source
from magical_mj.tasks.registry import sample_scene, task_spec

T = TypeVar("T")

SEEDS_PER_UNIT: Final = 10
"""About the number of episodes in a unit: a few seconds, so that killed runs lose little, and units cost little."""
CLOSABLE: Final = ("environment", "vector")
"""What a player keeps and must close."""


@dataclass(frozen=True)
class Unit:
    """Some episodes of one environment with one policy: independent of all other units, and repeatable.

    Attributes:
        source: where the policy comes from.
        task: the task's name.
        variant: the variant's name.
        seeds: the seeds of the scenes.
        settings: the settings of the evaluation.
        evaluation: identifies the evaluation. A policy that was loaded for another one may have changed since.
    """

    source: Source
    task: str
    variant: str
    seeds: tuple[int, ...]
    settings: EvaluationSettings
    evaluation: str = ""

    @property
    def steps(self) -> int:
        """How many actions it takes."""
        return len(self.seeds) * task_spec(self.task).horizon(self.settings.rules)


def plan(listed: Sequence[Source], settings: EvaluationSettings, done: Collection[Key]) -> list[Unit]:
    """The remaining units, the longest first, so that all workers end at about the same time."""
    units = []
    size = settings.envs * max(1, round(SEEDS_PER_UNIT / settings.envs))
    evaluation = secrets.token_hex(8)
    for task, variant in settings.environments:
        for source in listed:
            seeds = range(settings.episodes)
            left = [seed for seed in seeds if (source.name, source.run, task, variant, seed) not in done]
            units += [
                Unit(source, task, variant, tuple(left[start : start + size]), settings, evaluation)
                for start in range(0, len(left), size)
            ]
    return sorted(units, key=lambda unit: -unit.steps)


def play_unit(unit: Unit) -> list[EpisodeResult]:
    """What a worker does."""
    return list(player().play(unit))


_LOCAL = threading.local()


def player() -> Player:
    """The player of this thread; a cluster's worker may have several threads."""
    if not hasattr(_LOCAL, "player"):
        _LOCAL.player = Player()
    return _LOCAL.player


class Player:
    """Plays units on a thread that can be abandoned, and keeps the last environment and policy for the next unit."""

    def __init__(self) -> None:
        self._evaluation = ""
        self._forget()

    def play(self, unit: Unit) -> Iterator[EpisodeResult]:
        """Plays the unit's episodes, one after another or side by side.

        Raises:
            SettingsError: if the policy cannot be loaded.
            RenderingError: if no pictures can be drawn here.
        """
        if unit.evaluation != self._evaluation:
            self.release()
            self._evaluation = unit.evaluation
        envs = unit.settings.envs
        for start in range(0, len(unit.seeds), envs):
            seeds = unit.seeds[start : start + envs]
            episodes = [Episode(unit.task, unit.variant, seed, unit.source.run) for seed in seeds]
            policy = self._policy_of(unit)
            preset = getattr(policy, "preset", None) if uses_simulation(policy) else unit.settings.preset
            for result in self._results(unit, episodes):
                scene = sample_scene(unit.task, unit.variant, result.seed).digest()
                facts = {"preset": preset, "scene": scene, "worlds": WORLDS[unit.settings.simulator]}
                yield replace(result, policy=unit.source.name, rules=unit.settings.rules, **facts)

    def release(self) -> None:
        """Closes the environments and drops the policy; later units get new ones."""
        if self._caller.abandoned:  # its thread may still use them
            self._forget()
            return
        for what in list(self._kept):
            self._drop(what)

    def _results(self, unit: Unit, episodes: list[Episode]) -> list[EpisodeResult]:
        policy = self._policy_of(unit)
        if unit.settings.envs > 1 and not uses_simulation(policy):
            try:
                limit = unit.settings.time_limit * len(episodes)
                wave = self._caller.call(lambda: play_side_by_side(*self._vector(unit, policy), episodes), limit)
            except TimeLimitError:
                self._forget()
            else:
                if not any(result.failure for result in wave):
                    return wave
        return [self._single(unit, episode) for episode in episodes]  # to find out which episodes fail

    def _single(self, unit: Unit, episode: Episode) -> EpisodeResult:
        policy, settings = self._policy_of(unit), unit.settings
        make = functools.partial(environment_for, policy, unit.task, unit.variant, settings.preset, settings.rules)
        env = None if settings.batched else self._keep("environment", _env_key(unit, policy), make)

        def playing() -> EpisodeResult:
            if env is None:
                return play_side_by_side(*self._vector(unit, policy), [episode])[0]
            return play(env, policy, episode)

        try:
            return self._caller.call(playing, settings.time_limit)
        except TimeLimitError as error:
            self._forget()
            facts = {"policy": unit.source.name, "preset": settings.preset, "rules": settings.rules}
            return result_of(episode, (), 0.0, reason(error), settings.time_limit, **facts)

    def _policy_of(self, unit: Unit) -> Act:
        return self._keep("policy", _policy_key(unit), lambda: self._caller.call(unit.source.load, None))

    def _vector(self, unit: Unit, policy: Act) -> tuple[Envs, BatchPolicy]:
        names = ("envs", "simulator", "device")
        key = (*_env_key(unit, policy), *(getattr(unit.settings, name) for name in names))
        envs = self._keep("vector", key, lambda: _vector_env(unit))
        if isinstance(policy, BatchPolicy):
            return envs, policy
        return envs, self._keep("copies", (key, _policy_key(unit)), lambda: PolicyCopies(policy, envs))

    def _keep(self, what: str, key: Any, make: Callable[[], T]) -> T:
        """The object made for this key; one that was kept for another key is replaced."""
        if what in self._kept and self._kept[what][0] != key:
            self._drop(what)
        if what not in self._kept:
            self._kept[what] = key, make()
        return self._kept[what][1]

    def _drop(self, what: str) -> None:
        """Closes an environment. Policies are not closed, since they may be users' objects."""
        _, thing = self._kept.pop(what)
        if what in CLOSABLE:
            thing.close()

    def _forget(self) -> None:
        """Drops environment and policy: an episode that did not end may still be using them."""
        self._kept: dict[str, tuple[Any, Any]] = {}
        self._caller = TimeLimitedCaller()


def _policy_key(unit: Unit) -> tuple[str, str, int]:
    """Of one policy in one evaluation, of which two may take turns; policies themselves may not be comparable."""
    return unit.evaluation, unit.source.name, unit.source.run


def _env_key(unit: Unit, policy: Act) -> tuple[Any, ...]:
    return unit.task, unit.variant, unit.settings.rules, None if uses_simulation(policy) else unit.settings.preset


def _vector_env(unit: Unit) -> Envs:
    if unit.settings.batched:
        return _batch(unit)
    kwargs: dict[str, Any] = {"autoreset_mode": gymnasium.vector.AutoresetMode.DISABLED}
    name = f"magical_mj:{env_id(unit.task, unit.variant, unit.settings.preset)}"
    return gymnasium.make_vec(name, unit.settings.envs, "sync", vector_kwargs=kwargs, rules=unit.settings.rules)


def _batch(unit: Unit) -> Envs:
    from magical_mj import batched  # these need PyTorch
    from magical_mj.batched.environment import Arrays

    settings = unit.settings
    envs = batched.make(
        *(unit.task, unit.variant, settings.envs),
        preset=settings.preset,
        device=settings.device,
        rules=settings.rules,
        autoreset_mode=gymnasium.vector.AutoresetMode.DISABLED,
    )
    return Arrays(envs)
