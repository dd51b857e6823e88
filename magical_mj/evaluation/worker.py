"""Plays an evaluation's units with a time limit. A unit is some episodes of one environment with one policy.

An episode that takes too long has failed. The time is checked after each action. If a call of the policy does not
return, its worker process is killed (see `magical_mj.utils.parallel`). With ``jobs=1`` there are no worker processes,
and `evaluate` waits for the call.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypeVar

import gymnasium
from gymnasium.vector import VectorEnv

from magical_mj.envs.registration import env_id
from magical_mj.evaluation.playing import LATE, Env, play_episode, play_side_by_side
from magical_mj.evaluation.scores import EpisodeResult, Key, Outcome
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.policies.interface import Episode, policy_task
from magical_mj.policies.loading import Source, check_fit, common_preset, doubts, sources
from magical_mj.rendering.backend import drawn_by
from magical_mj.shifts.registry import split_body
from magical_mj.utils.errors import SettingsError, short_repr
from magical_mj.utils.imports import resolve, with_location
from magical_mj.utils.parallel import Split, Timed, map_here

if TYPE_CHECKING:
    from magical_mj.demos.stored import Watch

T = TypeVar("T")
Finished = tuple[list[EpisodeResult], Exception | None]
"""The results of a unit, and the error that the policy raised in it."""

GRACE: Final = 1.0
"""Seconds from the time limit until a worker process is killed. It is only needed if a call does not return."""


@dataclass(frozen=True)
class Unit:
    """Episodes of one environment with one policy that are played together. A unit is repeatable and independent.

    `shift` is the label of the shift, `retry` the number of times that the episode has failed before.
    """

    policy: str
    run: int
    task: str
    variant: str
    seeds: tuple[int, ...]
    shift: str = ""
    retry: int = 0

    def key(self, seed: int) -> Key:
        """The key of one of its episodes."""
        return self.policy, self.run, self.task, self.variant, seed, self.shift


def prepared(policy: Any, settings: EvaluationSettings) -> tuple[list[Source], EvaluationSettings]:
    """The policies in the argument of `evaluate`, each loaded once to check it, and the settings with their preset.

    Later, `Source.load` raises an error if a policy's file has changed.

    Warns if the folder of a stable-baselines3 archive contains statistics of VecNormalize, which are not used, if the
    preset is chosen among several with the observation shape of a policy, and if a training has not finished.

    Raises:
        SettingsError, TaskError, UnknownNameError: if a policy cannot be loaded, or the settings do not fit it.
    """
    found, listed = sources(policy, settings.run, settings.trust), list[Source]()
    acts = [source.load() for source in found]
    preset = common_preset(acts) if settings.preset is None else settings.preset
    for source, act in zip(found, acts, strict=True):
        check_fit(act, settings.environments, preset, settings.like)
        listed.append(source.checked(act, preset))
        if settings.batched and "observations" not in listed[-1].uses:
            raise SettingsError(f"{source.name} uses no observations: it plays in single environments only")
        for doubt in doubts(listed[-1], act, preset, is_chosen=settings.preset is None):
            warnings.warn(doubt, stacklevel=4)  # the call of `evaluate`
    settings = replace(settings, preset=preset)
    settings.check_policies(listed)
    settings.shift_labels(listed)
    return listed, settings


class Player:
    """Plays units. It keeps the last environment and the last policy for the next unit.

    It can be sent to other processes before it has played a unit, but not afterwards.

    Attributes:
        policies: name and run -> the policy.
        starts: what they receive at the start of episodes.
    """

    def __init__(
        self, policies: Sequence[Source], settings: EvaluationSettings, watch: Watch = lambda _, __: None
    ) -> None:
        """Prepares what the policies receive at the start of episodes, with `watch`; see `BaseSettings.starts`."""
        self.policies = {(policy.name, policy.run): policy for policy in policies}
        self.settings = settings
        self.starts = settings.starts(policies, watch)
        self._kept: dict[str, tuple[Any, Any]] = {}

    def __call__(self, unit: Unit) -> Timed[Finished | Split[Unit]]:
        """Loads the policy and makes the environment. Returns the work that remains, with its time limit.

        That work plays the episodes, so the limit does not include loading. If one of several episodes fails, the unit
        is split to find out which.
        """
        source = self.policies[unit.policy, unit.run]
        policy = self._keep("policy", (unit.policy, unit.run), source.load)
        env, facts = self._env(unit, source), self._facts(unit, source, policy)
        task = policy_task(unit.task, policy, self.settings.like)
        episodes: list[Episode] = []
        records: list[Callable[[Outcome], EpisodeResult]] = []
        for seed in unit.seeds:
            played = Episode(unit.task, unit.variant, seed, unit.run)
            episode, own = self.starts.of(played, task, source)
            episodes.append(episode)
            scene = start_digest(unit.task, unit.variant, seed, unit.shift, self.settings.body)
            records.append(partial(EpisodeResult.of, played, scene=scene, **facts, **own))
        limit = self.settings.time_limit
        seconds = limit * len(unit.seeds)
        split: Split[Unit] | None = None
        if len(unit.seeds) > 1:
            split = Split([replace(unit, seeds=(seed,)) for seed in unit.seeds])

        def play() -> Finished | Split[Unit]:
            if isinstance(env, VectorEnv):
                outcomes = play_side_by_side(env, policy, episodes, seconds)
            else:
                outcomes = [play_episode(env, policy, episode, seconds) for episode in episodes]
            if split and any(outcome.failure for outcome in outcomes):
                return split
            results = [record(outcome) for record, outcome in zip(records, outcomes, strict=True)]
            return list(map(self.starts.finished, results)), outcomes[-1].cause

        late = Outcome(failure=LATE.format(limit), seconds=limit)
        return Timed(seconds + GRACE, play, split or ([records[0](late)], None))

    def play(self, unit: Unit) -> list[EpisodeResult]:
        """Plays a unit in this process and returns its results."""
        return [result for results, _ in map_here(self, [unit]) for result in results]

    def close(self) -> None:
        """Closes the environments."""
        for what in list(self._kept):
            self._drop(what)

    def _env(self, unit: Unit, source: Source) -> Env | VectorEnv[Any, Any, Any]:
        settings, size = self.settings, len(unit.seeds)
        instruction = "instruction" not in source.unnoticed
        alone = (unit.seeds, unit.retry) if settings.wrap else ()  # no wrapper's state reaches another episode
        key = unit.task, unit.variant, unit.shift, instruction, alone
        if settings.batched or size > 1:
            return self._keep(
                "vector",
                (*key, size),
                lambda: settings.vector_env(unit.task, unit.variant, size, unit.shift, instruction),
            )
        observed = bool(settings.wrap) or "observations" in source.uses
        return self._keep("environment", (*key, observed), lambda: single_env(unit, settings, observed, instruction))

    def _facts(self, unit: Unit, source: Source, policy: object) -> dict[str, Any]:
        """Fields of the results of a unit's episodes."""
        settings = self.settings
        return {
            "policy": unit.policy,
            "rules": settings.rules,
            "preset": settings.observed if "observations" in source.uses else getattr(policy, "preset", None),
            "gl": drawn_by(settings.renderer),
            "worlds": settings.worlds,
            "split": settings.split,
            "shift": unit.shift,
            "wrap": settings.wrap,
            "body": settings.body,
            "retry": unit.retry,
            "given": settings.given(source),
        }

    def _keep(self, what: str, key: Any, make: Callable[[], T]) -> T:
        """The object for this key. It replaces one that was kept for another key."""
        if what in self._kept and self._kept[what][0] != key:
            self._drop(what)
        if what not in self._kept:
            self._kept[what] = key, make()
        return self._kept[what][1]

    def _drop(self, what: str) -> None:
        _, dropped = self._kept.pop(what)
        if what in ("environment", "vector"):
            dropped.close()


def single_env(unit: Unit, settings: EvaluationSettings, observed: bool, instruction: bool = False) -> Env:
    """The environment of a policy: if `observed`, the Gymnasium environment with the preset, else the engine.

    It has only the user's wrapper: those of `gymnasium.make` only add checks at each step.
    """
    how: Any = {"rules": settings.rules, "renderer": settings.renderer, "body": settings.body, "shifts": unit.shift}
    if observed:
        name = env_id(unit.task, unit.variant, settings.observed)
        env = gymnasium.make(name, instruction=instruction, **how).unwrapped
        return _wrapped(env, settings.wrap) if settings.wrap else env
    from magical_mj.engine import Engine  # imported late: it loads the simulator

    return Engine(unit.task, unit.variant, seed=0, **how)


def start_digest(task: str, variant: str, seed: int, shift: str, body: str) -> str:
    """The digest of an episode's initial scene."""
    from magical_mj.engine.episode import Setup  # imported late: it loads the simulator

    strengths, body = split_body(shift, task, body)
    return Setup(task, variant, body=body).scene_and_shifts(strengths, seed)[0].digest()


def _wrapped(env: gymnasium.Env[Any, Any], wrap: str) -> gymnasium.Env[Any, Any]:
    try:
        outer: Any = resolve(wrap)(env)
    except (Exception, SystemExit) as error:
        raise SettingsError(f"the wrapper {wrap} cannot be used: {with_location(error)}") from error
    if (
        not isinstance(outer, gymnasium.Env)
        or outer.unwrapped is not env.unwrapped
        or outer.action_space != env.action_space
    ):
        raise SettingsError(
            f"the wrapper {wrap} must return a Gymnasium environment around its argument, with the same 18 actions, "
            f"not {short_repr(outer)}"
        )
    return outer
