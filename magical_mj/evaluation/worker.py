"""Plays an evaluation's units with a time limit. A unit is some episodes of one environment with one policy.

An episode that takes too long has failed. The time is checked after each action. If a call of the policy does not
return, its worker process is killed (see `magical_mj.utils.parallel`). With ``jobs=1`` there are no worker processes,
and `evaluate` waits for the call.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any, Final, TypeVar

import gymnasium
from gymnasium.vector import VectorEnv

from magical_mj.envs.registration import env_id
from magical_mj.evaluation.given import (
    Watch,
    demonstrations_given,
    digest_of,
    other_task,
    with_other_score,
    with_states,
)
from magical_mj.evaluation.rollouts import Env, late, play_episode, play_side_by_side
from magical_mj.evaluation.scores import EpisodeResult, Key, Outcome
from magical_mj.evaluation.settings import WORLDS, EvaluationSettings
from magical_mj.policies.interface import Act, Episode, PolicyError, Transitions, policy_task
from magical_mj.policies.loading import Source
from magical_mj.rendering.backend import RendererName, drawn_by
from magical_mj.shifts.registry import split_body
from magical_mj.tasks.registry import sample_scene, task_spec
from magical_mj.utils.errors import SettingsError, short_repr
from magical_mj.utils.imports import resolve, with_location
from magical_mj.utils.parallel import Split, Timed, map_here

if TYPE_CHECKING:
    from magical_mj.demos import Demonstration
    from magical_mj.demos.stored import Stored

T = TypeVar("T")

SIDE_BY_SIDE: Final = {"mujoco": 10, "warp": 100}
"""The most episodes that are played in one batch. They end together, so a killed evaluation loses the current batch."""
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

    @property
    def keys(self) -> list[Key]:
        """The keys of its episodes."""
        return [(self.policy, self.run, self.task, self.variant, seed, self.shift) for seed in self.seeds]

    def steps(self, settings: EvaluationSettings) -> int:
        """The number of actions of all its episodes."""
        return len(self.seeds) * task_spec(self.task).horizon(settings.rules)


def plan(
    policies: Sequence[Source], settings: EvaluationSettings, done: Collection[Key], failed: Mapping[Key, int]
) -> list[Unit]:
    """The remaining units. Those with long episodes come first, so that all workers end at about the same time.

    `failed` maps the episodes that must be played again to the number of their failures.
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
    """The results of a unit, and the error that the policy raised in it."""

    results: list[EpisodeResult]
    cause: Exception | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Converts the error to text, since it may not be picklable."""
        text = None if self.cause is None else PolicyError("".join(traceback.format_exception(self.cause)))
        return {"results": self.results, "cause": text}


class Player:
    """Plays units. It keeps the last environment and the last policy for the next unit.

    It can be sent to other processes before it has played a unit, but not afterwards.

    Attributes:
        policies: name and run -> the policy.
        demonstrations: task -> the demonstrations that policies receive. Empty if no policy uses any.
    """

    def __init__(
        self, policies: Sequence[Source], settings: EvaluationSettings, watch: Watch = lambda _, __: None
    ) -> None:
        """Gets the demonstrations, if a policy uses some, with `watch` and the errors of `demonstrations_given`."""
        self.policies = {(policy.name, policy.run): policy for policy in policies}
        self.settings = settings
        receive = any(policy.uses_demonstrations for policy in policies)
        self.demonstrations = demonstrations_given(settings, watch) if receive else {}
        self._kept: dict[str, tuple[Any, Any]] = {}

    @property
    def recorded(self) -> dict[str, str]:
        """The digests of the demonstrations, which a resumed evaluation must keep."""
        return {f"demonstrations of {task}": digest_of(demos) for task, demos in self.demonstrations.items()}

    def __call__(self, unit: Unit) -> Timed[Played | Split[Unit]]:
        """Loads the policy and makes the environment. Returns the work that remains, with its time limit.

        That work plays the episodes, so the limit does not include loading. If one of several episodes fails, the unit
        is split to find out which.
        """
        source = self.policies[unit.policy, unit.run]
        policy = self._keep("policy", (unit.policy, unit.run), source.load)
        env, others = self._env(unit, source), self._others(unit)
        episodes = self._episodes(unit, source, policy, others)
        recorders = self._recorders(unit, source, policy, others)
        split, several = Split([replace(unit, seeds=(seed,)) for seed in unit.seeds]), len(unit.seeds) > 1
        limit = self.settings.time_limit
        seconds = limit * len(unit.seeds)

        def play() -> Played | Split[Unit]:
            if isinstance(env, VectorEnv):
                outcomes = play_side_by_side(env, policy, episodes, seconds)
            else:
                outcomes = [play_episode(env, policy, episode, seconds) for episode in episodes]
            if several and any(outcome.failure for outcome in outcomes):
                return split
            played = [record(outcome) for record, outcome in zip(recorders, outcomes, strict=True)]
            return Played([with_other_score(result) for result in played], outcomes[-1].cause)

        outcome = Outcome(failure=late(limit), seconds=limit)
        return Timed(seconds + GRACE, play, split if several else Played([recorders[0](outcome)]))

    def play(self, unit: Unit) -> list[EpisodeResult]:
        """Plays a unit in this process and returns its results."""
        return [result for played in map_here(self, [unit]) for result in played.results]

    def close(self) -> None:
        """Closes the environments."""
        for what in list(self._kept):
            self._drop(what)

    def _env(self, unit: Unit, source: Source) -> Env | VectorEnv[Any, Any, Any]:
        settings, size = self.settings, len(unit.seeds)
        instruction = "instruction" not in source.unnoticed
        key = unit.task, unit.variant, unit.shift, instruction
        if settings.batched or size > 1:
            return self._keep("vector", (*key, size), lambda: _vector_env(unit, settings, instruction))
        observed = bool(settings.wrap) or not source.uses_simulation
        return self._keep("environment", (*key, observed), lambda: single_env(unit, settings, observed, instruction))

    def _others(self, unit: Unit) -> list[str]:
        """For each episode, the other task of the control. Empty without a control."""
        if self.settings.control is None:
            return [""] * len(unit.seeds)
        body = self.settings.body if self.settings.control == "wrong-instruction" else None
        return [other_task(unit.task, unit.variant, seed, body) for seed in unit.seeds]

    def _episodes(self, unit: Unit, source: Source, policy: Act, others: Sequence[str]) -> list[Episode]:
        """The information that the policy receives at the start of each episode. `others` is from `_others`."""
        task = policy_task(unit.task, policy, self.settings.like)
        demonstrations = self._received(unit.task, source)
        misled = self.settings.control == "wrong-instruction"
        sentences = [task_spec(other).summary if misled else "" for other in others]
        return [
            Episode(task, unit.variant, seed, unit.run, sentence, demonstrations=demonstrations)
            for seed, sentence in zip(unit.seeds, sentences, strict=True)
        ]

    def _received(self, task: str, source: Source) -> tuple[Any, ...]:
        """The demonstrations of a task in the form that the policy uses."""
        if not source.uses_demonstrations:
            return ()
        demos, settings = self.demonstrations[task], self.settings
        if source.uses_simulation:
            return self._keep("demonstrations", (task, ""), lambda: with_states(demos))
        key = task, settings.observed
        return self._keep("demonstrations", key, lambda: _observed(demos, settings.observed, settings.renderer))

    def _recorders(
        self, unit: Unit, source: Source, policy: Act, others: Sequence[str]
    ) -> list[Callable[[Outcome], EpisodeResult]]:
        """For each episode, the function that makes its result from its outcome. `others` is from `_others`."""
        settings = self.settings
        facts: dict[str, Any] = {
            **{name: getattr(settings, name) for name in ("rules", "split", "wrap", "body")},
            "policy": unit.policy,
            "preset": getattr(policy, "preset", None) if source.uses_simulation else settings.observed,
            "worlds": WORLDS[settings.simulator],
            "gl": drawn_by(settings.renderer),
            "shift": unit.shift,
            "retry": unit.retry,
            "given": settings.given(source),
            "demonstrations": digest_of(self.demonstrations[unit.task])[:16] if source.uses_demonstrations else "",
        }
        recorders: list[Callable[[Outcome], EpisodeResult]] = []
        for seed, other in zip(unit.seeds, others, strict=True):
            scene = start_digest(unit.task, unit.variant, seed, unit.shift, settings.body)
            episode = Episode(unit.task, unit.variant, seed, unit.run)
            recorders.append(partial(EpisodeResult.of, episode, scene=scene, other=other, **facts))
        return recorders

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


def _observed(
    demonstrations: Sequence[Demonstration | Stored], preset: str, renderer: RendererName | None
) -> tuple[Transitions, ...]:
    """Demonstrations as observations and actions. The arrays are read-only, since all episodes share them."""
    from magical_mj.demos.learning import stream  # imported late: it loads the simulator

    parts = tuple(stream(with_states(demonstrations), preset, drop_noop=False, renderer=renderer))
    for part in parts:
        views = part.observations.values() if isinstance(part.observations, dict) else (part.observations,)
        for array in (*views, part.actions):
            array.setflags(write=False)
    return parts


def _arguments(unit: Unit, settings: EvaluationSettings) -> dict[str, Any]:
    return {"rules": settings.rules, "renderer": settings.renderer, "shifts": unit.shift, "body": settings.body}


def single_env(unit: Unit, settings: EvaluationSettings, observed: bool, instruction: bool = False) -> Env:
    """The environment of a policy: if `observed`, the Gymnasium environment with the preset, else the engine.

    It has only the user's wrapper: those of `gymnasium.make` only add checks at each step.
    """
    how = _arguments(unit, settings)
    if observed:
        name = env_id(unit.task, unit.variant, settings.observed)
        env = gymnasium.make(name, instruction=instruction, **how).unwrapped
        return _wrapped(env, settings.wrap) if settings.wrap else env
    from magical_mj.engine import Engine  # imported late: it loads the simulator

    return Engine(unit.task, unit.variant, seed=0, **how)


def start_digest(task: str, variant: str, seed: int, shift: str, body: str) -> str:
    """The digest of an episode's initial scene."""
    if not shift:
        return sample_scene(task, variant, seed, body).digest()
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


def _vector_env(unit: Unit, settings: EvaluationSettings, instruction: bool) -> VectorEnv[Any, Any, Any]:
    number = len(unit.seeds)
    how: dict[str, Any] = {"preset": settings.observed, "autoreset_mode": gymnasium.vector.AutoresetMode.DISABLED}
    if not settings.batched:
        from magical_mj.envs.vector import make_vec  # imported late: it loads the simulator

        threads = None if settings.jobs == 1 else 1  # other worker processes use the other cores
        how |= {"threads": threads, "instruction": instruction, **_arguments(unit, settings)}
        return make_vec(unit.task, number, variant=unit.variant, **how)
    from magical_mj import batched  # imported late: it needs PyTorch
    from magical_mj.batched.environment import Arrays

    envs = batched.make(unit.task, unit.variant, number, device=settings.device, rules=settings.rules, **how)
    return Arrays(envs)
