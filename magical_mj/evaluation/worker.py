"""Playing an evaluation's units, each of some episodes of one environment with one policy, with a time limit.

An episode that takes too long has failed. This is checked after each action. A call of the policy that does not return
can only be ended with its process: worker processes are killed, see `magical_mj.utils.parallel`, and the process that
called `evaluate` waits.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Any, Final, TypeVar

import gymnasium

from magical_mj.envs.registration import env_id
from magical_mj.evaluation.rollouts import Env, Envs, late, play, play_side_by_side
from magical_mj.evaluation.scores import EpisodeResult, Key, Outcome
from magical_mj.evaluation.settings import WORLDS, EvaluationSettings
from magical_mj.policies.interface import Act, Episode, PolicyError, told_task, uses_instruction, uses_simulation
from magical_mj.policies.loading import Source
from magical_mj.rendering.backend import drawn_by
from magical_mj.shifts.registry import split_body
from magical_mj.tasks.registry import sample_scene, task_spec
from magical_mj.utils.errors import SettingsError, UntrustedNameError, short_repr
from magical_mj.utils.imports import resolve, with_place
from magical_mj.utils.parallel import Split, Timed

T = TypeVar("T")
Playing = Callable[[list[Episode], float], list[Outcome]]
"""Plays episodes within so many seconds."""
Results = Callable[[list[Outcome]], list[EpisodeResult]]
"""Makes the results of episodes from their outcomes."""

SIDE_BY_SIDE: Final = {"mujoco": 10, "warp": 100}
"""The most episodes that are played side by side; they end together, so that killed runs lose those that play."""
GRACE: Final = 1.0
"""Seconds after the time limit at which a worker process is killed: an episode whose calls return ends by itself."""


@dataclass(frozen=True)
class Unit:
    """Some episodes of one environment with one policy, played side by side: independent of all others, and repeatable.

    Attributes:
        policy, run: identify the policy.
        seeds: of the episodes.
        shift: what is shifted.
        retry: how often the episode has failed before.
    """

    policy: str
    run: int
    task: str
    variant: str
    seeds: tuple[int, ...]
    shift: str = ""
    retry: int = 0

    @property
    def keys(self) -> list[Key]:
        """The keys of its episodes."""
        return [(self.policy, self.run, self.task, self.variant, seed, self.shift) for seed in self.seeds]

    def steps(self, settings: EvaluationSettings) -> int:
        """How many actions it takes."""
        return len(self.seeds) * task_spec(self.task).horizon(settings.rules)

    def one_by_one(self) -> list[Unit]:
        """A unit for each of its episodes."""
        return [replace(self, seeds=(seed,)) for seed in self.seeds]


def plan(
    policies: Sequence[Source], settings: EvaluationSettings, done: Collection[Key], failed: Mapping[Key, int]
) -> list[Unit]:
    """The remaining units, those of long episodes first, so that all workers end at about the same time.

    `failed` are the episodes that are to be played again, and how often they have failed.
    """
    units: list[Unit] = []
    for task, variant in settings.environments:
        for source, shift in product(policies, settings.shift_labels(task, policies)):
            every = Unit(source.name, source.run, task, variant, tuple(settings.seeds), shift)
            together = settings.batched or (source.batches and not settings.wrap)
            size = SIDE_BY_SIDE[settings.simulator] if together else 1
            left = [(key, seed) for key, seed in zip(every.keys, every.seeds, strict=True) if key not in done]
            new = tuple(seed for key, seed in left if key not in failed)
            units += [replace(every, seeds=new[first : first + size]) for first in range(0, len(new), size)]
            units += [replace(every, seeds=(seed,), retry=failed[key]) for key, seed in left if key in failed]
    return sorted(units, key=lambda unit: -task_spec(unit.task).horizon(settings.rules))


@dataclass(frozen=True)
class Played:
    """The results of a unit, and the error by which the policy failed in it."""

    results: list[EpisodeResult]
    cause: Exception | None = None

    def __getstate__(self) -> dict[str, Any]:
        """For other processes, the error is text: it may not be picklable."""
        text = None if self.cause is None else PolicyError("".join(traceback.format_exception(self.cause)))
        return {"results": self.results, "cause": text}


@dataclass
class Player:
    """Plays units. It keeps the last environment and the last policy for the next unit.

    Until it has played, it can be sent to other processes.
    """

    policies: Mapping[tuple[str, int], Source]
    settings: EvaluationSettings
    _kept: dict[str, tuple[Any, Any]] = field(default_factory=dict)

    @classmethod
    def of(cls, sources: Sequence[Source], settings: EvaluationSettings) -> Player:
        """A player of these policies."""
        return cls({(source.name, source.run): source for source in sources}, settings)

    def __call__(self, unit: Unit) -> Timed[Played | Split[Unit]]:
        """Loads the policy and makes the environment, which takes time of its own; the rest plays the episodes.

        If one of several episodes fails, they are split, to find out which.
        """
        limit, several, playing = self.settings.time_limit, len(unit.seeds) > 1, self._playing(unit)
        results = self._recorder(unit)
        outcome = Outcome(failure=late(limit), seconds=limit)
        too_late = Split(unit.one_by_one()) if several else Played(results([outcome]))
        seconds = limit * len(unit.seeds)
        return Timed(seconds + GRACE, partial(self._play, unit, playing, seconds, results), too_late)

    def play(self, unit: Unit) -> list[EpisodeResult]:
        """The results of a unit that is played here and now."""
        played = self(unit).call()
        if isinstance(played, Played):
            return played.results
        return [result for one in played.pieces for result in self.play(one)]

    def close(self) -> None:
        """Closes the environments."""
        for what in list(self._kept):
            self._drop(what)

    def _playing(self, unit: Unit) -> Playing:
        """What plays episodes of a unit within so many seconds."""
        settings, place = self.settings, (unit.task, unit.variant, unit.shift)
        policy = self._policy(unit)
        reads = uses_instruction(policy)
        if settings.batched or len(unit.seeds) > 1:
            size = len(unit.seeds)
            envs = self._keep("vector", (*place, size, reads), lambda: _vector_env(unit, settings, reads))
            return lambda episodes, seconds: play_side_by_side(envs, policy, episodes, seconds)
        observed = bool(settings.wrap) or not uses_simulation(policy)
        key = (*place, observed, reads)
        env = self._keep("environment", key, lambda: single_env(unit, settings, observed, reads))
        return lambda episodes, seconds: [play(env, policy, episode, seconds) for episode in episodes]

    def _play(self, unit: Unit, playing: Playing, seconds: float, results: Results) -> Played | Split[Unit]:
        task = told_task(unit.task, self.settings.like)
        outcomes = playing([Episode(task, unit.variant, seed, unit.run) for seed in unit.seeds], seconds)
        if len(outcomes) > 1 and any(outcome.failure for outcome in outcomes):
            return Split(unit.one_by_one())
        return Played(results(outcomes), outcomes[-1].cause)

    def _recorder(self, unit: Unit) -> Results:
        """What makes the results of a unit's outcomes."""
        settings, policy = self.settings, self._policy(unit)
        facts = {
            **{name: getattr(settings, name) for name in ("rules", "split", "wrap", "body")},
            "policy": unit.policy,
            "preset": getattr(policy, "preset", None) if uses_simulation(policy) else settings.observed,
            "worlds": WORLDS[settings.simulator],
            "gl": drawn_by(settings.renderer),
            "shift": unit.shift,
            "retry": unit.retry,
        }
        episodes = [Episode(unit.task, unit.variant, seed, unit.run) for seed in unit.seeds]
        scenes = [start_digest(unit.task, unit.variant, seed, unit.shift, settings.body) for seed in unit.seeds]

        def results(outcomes: list[Outcome]) -> list[EpisodeResult]:
            played = zip(episodes, outcomes, scenes, strict=True)
            return [EpisodeResult.of(episode, outcome, scene=scene, **facts) for episode, outcome, scene in played]

        return results

    def _policy(self, unit: Unit) -> Act:
        key = unit.policy, unit.run
        return self._keep("policy", key, self.policies[key].load)

    def _keep(self, what: str, key: Any, make: Callable[[], T]) -> T:
        """The object made for this key; one that was kept for another key is replaced."""
        if what in self._kept and self._kept[what][0] != key:
            self._drop(what)
        if what not in self._kept:
            self._kept[what] = key, make()
        return self._kept[what][1]

    def _drop(self, what: str) -> None:
        _, dropped = self._kept.pop(what)
        if what != "policy":  # which may be a user's object
            dropped.close()


def _arguments(unit: Unit, settings: EvaluationSettings) -> dict[str, Any]:
    """How a unit's environments are made."""
    return {"rules": settings.rules, "renderer": settings.renderer, "shifts": unit.shift, "body": settings.body}


def single_env(unit: Unit, settings: EvaluationSettings, observed: bool, instruction: bool = False) -> Env:
    """The environment for a policy: Gymnasium's with the preset's observations, or the bare engine.

    With `instruction`, observations that are dicts hold the sentence that says what is to be done.
    The former has no wrappers of `gymnasium.make`, whose checks at each step would only take time, but the user's.
    """
    how = _arguments(unit, settings)
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


def _vector_env(unit: Unit, settings: EvaluationSettings, instruction: bool) -> Envs:
    number = len(unit.seeds)
    how: dict[str, Any] = {"preset": settings.observed, "autoreset_mode": gymnasium.vector.AutoresetMode.DISABLED}
    if not settings.batched:
        from magical_mj.envs.vector import make_vec  # imported late: it loads the simulator

        threads = None if settings.jobs == 1 else 1  # other processes have the other cores
        how |= {"threads": threads, "instruction": instruction, **_arguments(unit, settings)}
        return make_vec(unit.task, number, variant=unit.variant, **how)
    from magical_mj import batched  # these need PyTorch
    from magical_mj.batched.environment import Arrays

    envs = batched.make(unit.task, unit.variant, number, device=settings.device, rules=settings.rules, **how)
    return Arrays(envs)
