"""Plays an evaluation's units with a time limit. A unit is some episodes of one environment with one policy.

An episode that takes too long has failed. The time is checked after each action. If a call of the policy does not
return, its process must be killed, which only worker processes are (see `magical_mj.utils.parallel`). With ``jobs=1``,
the process that called `evaluate` waits for the call.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any, Final, TypeVar

import gymnasium

from magical_mj.envs.registration import env_id
from magical_mj.evaluation.given import (
    Watch,
    demonstrations_given,
    digest_of,
    other_task,
    with_other_score,
    with_states,
)
from magical_mj.evaluation.rollouts import Env, Envs, late, play_episode, play_side_by_side
from magical_mj.evaluation.scores import EpisodeResult, Key, Outcome
from magical_mj.evaluation.settings import WORLDS, EvaluationSettings
from magical_mj.policies.interface import (
    Act,
    Episode,
    PolicyError,
    Transitions,
    policy_task,
    uses_demonstrations,
    uses_instruction,
    uses_simulation,
)
from magical_mj.policies.loading import Source
from magical_mj.rendering.backend import RendererName, drawn_by
from magical_mj.shifts.registry import split_body
from magical_mj.tasks.registry import sample_scene, task_spec
from magical_mj.utils.errors import SettingsError, short_repr
from magical_mj.utils.imports import resolve, with_location
from magical_mj.utils.parallel import Split, Timed

if TYPE_CHECKING:
    from magical_mj.demos import Demonstration
    from magical_mj.demos.stored import Stored

T = TypeVar("T")
Playing = Callable[[list[Episode], float], list[Outcome]]
"""Plays episodes with a time limit in seconds."""
Results = Callable[[list[Outcome]], list[EpisodeResult]]
"""Makes the results of episodes from their outcomes."""

SIDE_BY_SIDE: Final = {"mujoco": 10, "warp": 100}
"""The most episodes that are played in one batch. They end together, so a killed evaluation loses the current batch."""
GRACE: Final = 1.0
"""Seconds from the time limit until a worker process is killed. If the policy's calls return, none needs to be."""


@dataclass(frozen=True)
class Unit:
    """Episodes of one environment with one policy that are played together. A unit is repeatable and independent.

    Attributes:
        policy, run: identify the policy.
        seeds: the seeds of the episodes.
        shift: the label of the shift.
        retry: how many times the episode has failed before.
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

    def one_by_one(self) -> list[Unit]:
        """A unit for each of its episodes."""
        return [replace(self, seeds=(seed,)) for seed in self.seeds]


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


@dataclass
class Player:
    """Plays units. It keeps the last environment and the last policy for the next unit.

    It can be sent to other processes before it has played a unit, but not afterwards.

    Attributes:
        policies: name and run -> the policy.
        settings: the settings of the evaluation.
        demonstrations: task -> the demonstrations that policies receive. Empty if no policy uses any.
    """

    policies: Mapping[tuple[str, int], Source]
    settings: EvaluationSettings
    demonstrations: Mapping[str, Sequence[Demonstration | Stored]] = field(default_factory=dict)
    _kept: dict[str, tuple[Any, Any]] = field(default_factory=dict)

    @classmethod
    def of(cls, sources: Sequence[Source], settings: EvaluationSettings, watch: Watch = lambda _, __: None) -> Player:
        """A player of these policies. `watch` is that of `demonstrations_given`.

        Raises:
            SettingsError, DemonstrationError: as `demonstrations_given`, if a policy uses demonstrations.
        """
        shown = any(source.shown for source in sources)
        return cls(
            {(source.name, source.run): source for source in sources},
            settings,
            demonstrations_given(settings, watch) if shown else {},
        )

    @property
    def recorded(self) -> dict[str, str]:
        """The digests of the demonstrations, which a resumed evaluation must keep."""
        return {f"demonstrations of {task}": digest_of(demos) for task, demos in self.demonstrations.items()}

    def __call__(self, unit: Unit) -> Timed[Played | Split[Unit]]:
        """Loads the policy and makes the environment. Returns the work that remains, with its time limit.

        That work plays the episodes, so the limit does not include loading. If one of several episodes fails, the unit
        is split to find out which.
        """
        limit, several, playing = self.settings.time_limit, len(unit.seeds) > 1, self._playing(unit)
        others = self._others(unit)
        episodes, results = self._episodes(unit, others), self._recorder(unit, others)
        outcome = Outcome(failure=late(limit), seconds=limit)
        too_late = Split(unit.one_by_one()) if several else Played(results([outcome]))
        seconds = limit * len(unit.seeds)
        return Timed(seconds + GRACE, partial(self._play, unit, playing, episodes, seconds, results), too_late)

    def play(self, unit: Unit) -> list[EpisodeResult]:
        """Plays a unit in this process and returns its results."""
        played = self(unit).call()
        if isinstance(played, Played):
            return played.results
        return [result for one in played.pieces for result in self.play(one)]

    def close(self) -> None:
        """Closes the environments."""
        for what in list(self._kept):
            self._drop(what)

    def _playing(self, unit: Unit) -> Playing:
        """The function that plays the episodes of a unit."""
        settings, environment = self.settings, (unit.task, unit.variant, unit.shift)
        policy = self._policy(unit)
        reads = uses_instruction(policy)
        if settings.batched or len(unit.seeds) > 1:
            size = len(unit.seeds)
            envs = self._keep("vector", (*environment, size, reads), lambda: _vector_env(unit, settings, reads))
            return lambda episodes, seconds: play_side_by_side(envs, policy, episodes, seconds)
        observed = bool(settings.wrap) or not uses_simulation(policy)
        key = (*environment, observed, reads)
        env = self._keep("environment", key, lambda: single_env(unit, settings, observed, reads))
        return lambda episodes, seconds: [play_episode(env, policy, episode, seconds) for episode in episodes]

    def _episodes(self, unit: Unit, others: Sequence[str]) -> list[Episode]:
        """The information that the policy receives at the start of each episode. `others` is from `_others`."""
        policy, settings = self._policy(unit), self.settings
        task, shown = policy_task(unit.task, policy, settings.like), self._shown(unit.task, policy)
        misled = settings.control == "wrong-instruction"
        sentences = [task_spec(other).summary if misled else "" for other in others]
        return [
            Episode(task, unit.variant, seed, unit.run, sentence, demonstrations=shown)
            for seed, sentence in zip(unit.seeds, sentences, strict=True)
        ]

    def _shown(self, task: str, policy: Act) -> tuple[Any, ...]:
        """The demonstrations of a task in the form that the policy uses."""
        if not uses_demonstrations(policy):
            return ()
        demos, settings = self.demonstrations[task], self.settings
        if uses_simulation(policy):
            return self._keep("demonstrations", (task, ""), lambda: with_states(demos))
        key = task, settings.observed
        return self._keep("demonstrations", key, lambda: _observed(demos, settings.observed, settings.renderer))

    def _others(self, unit: Unit) -> list[str]:
        """For each episode, the other task of the control. Empty without a control."""
        if self.settings.control is None:
            return [""] * len(unit.seeds)
        body = self.settings.body if self.settings.control == "wrong-instruction" else None
        return [other_task(unit.task, unit.variant, seed, body) for seed in unit.seeds]

    def _play(
        self, unit: Unit, playing: Playing, episodes: list[Episode], seconds: float, results: Results
    ) -> Played | Split[Unit]:
        outcomes = playing(episodes, seconds)
        if len(outcomes) > 1 and any(outcome.failure for outcome in outcomes):
            return Split(unit.one_by_one())
        return Played(results(outcomes), outcomes[-1].cause)

    def _recorder(self, unit: Unit, others: Sequence[str]) -> Results:
        """The function that makes the results of a unit from its outcomes. `others` is from `_others`."""
        settings, policy = self.settings, self._policy(unit)
        facts = {
            **{name: getattr(settings, name) for name in ("rules", "split", "wrap", "body")},
            "policy": unit.policy,
            "preset": getattr(policy, "preset", None) if uses_simulation(policy) else settings.observed,
            "worlds": WORLDS[settings.simulator],
            "gl": drawn_by(settings.renderer),
            "shift": unit.shift,
            "retry": unit.retry,
            "given": settings.given(shown=uses_demonstrations(policy), reads=uses_instruction(policy)),
            "demonstrations": digest_of(self.demonstrations[unit.task])[:16] if uses_demonstrations(policy) else "",
        }
        episodes = [Episode(unit.task, unit.variant, seed, unit.run) for seed in unit.seeds]
        scenes = [start_digest(unit.task, unit.variant, seed, unit.shift, settings.body) for seed in unit.seeds]

        def results(outcomes: list[Outcome]) -> list[EpisodeResult]:
            played = zip(episodes, outcomes, scenes, others, strict=True)
            return [
                with_other_score(EpisodeResult.of(episode, outcome, scene=scene, other=other, **facts))
                for episode, outcome, scene, other in played
            ]

        return results

    def _policy(self, unit: Unit) -> Act:
        key = unit.policy, unit.run
        return self._keep("policy", key, self.policies[key].load)

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
    shown: Sequence[Demonstration | Stored], preset: str, renderer: RendererName | None
) -> tuple[Transitions, ...]:
    """Demonstrations as observations and actions. The arrays are read-only, since all episodes share them."""
    from magical_mj.demos.learning import stream  # imported late: it loads the simulator

    parts = tuple(stream(with_states(shown), preset, drop_noop=False, renderer=renderer))
    for part in parts:
        views = part.observations.values() if isinstance(part.observations, dict) else (part.observations,)
        for array in (*views, part.actions):
            array.setflags(write=False)
    return parts


def _arguments(unit: Unit, settings: EvaluationSettings) -> dict[str, Any]:
    """The common arguments of all kinds of environments of a unit."""
    return {"rules": settings.rules, "renderer": settings.renderer, "shifts": unit.shift, "body": settings.body}


def single_env(unit: Unit, settings: EvaluationSettings, observed: bool, instruction: bool = False) -> Env:
    """The environment of a policy: if `observed`, the Gymnasium environment with the preset, else the engine.

    With `instruction`, observations that are dicts contain the instruction, a sentence. The Gymnasium environment has
    only the user's wrapper. Those of `gymnasium.make` only add checks at each step.
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
    return Setup(task, variant, body=body).begin(strengths, seed)[0].digest()


def _wrapped(env: gymnasium.Env[Any, Any], wrap: str) -> gymnasium.Env[Any, Any]:
    """The environment in the user's wrapper."""
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


def _vector_env(unit: Unit, settings: EvaluationSettings, instruction: bool) -> Envs:
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
