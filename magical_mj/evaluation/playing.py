"""Rollouts of policies: one episode after another, or several at a time in a vector environment.

All episodes of an environment have the same length. So a vector environment is reset with one scene for each of its
environments and stepped until all have ended together. Its autoreset mode does not matter, since it is always reset
explicitly before the next episodes.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import cycle
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import gymnasium
import numpy as np
from gymnasium.spaces import Discrete
from gymnasium.vector.utils import iterate
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, TimeLimit
from numpy.typing import NDArray

from magical_mj.actions import action_number
from magical_mj.evaluation.scores import EpisodeResult, Outcome
from magical_mj.policies.interface import (
    NEUTRAL,
    Act,
    BatchPolicy,
    Episode,
    PolicyError,
    act,
    begin,
    is_over,
    policy_errors,
    policy_name,
    policy_task,
    reason,
    uses_of,
)
from magical_mj.shifts.registry import Effect, check_noticed, parse_shifts
from magical_mj.tasks.registry import split_of, task_name, task_spec
from magical_mj.utils.errors import (
    EvaluationError,
    InvalidActionError,
    InvalidSceneError,
    PhysicsError,
    PlacementError,
    SettingsError,
    StateError,
    TaskError,
)
from magical_mj.utils.imports import reference_to
from magical_mj.wrappers import ScoreAtTheEnd

if TYPE_CHECKING:
    from magical_mj.engine import Engine

Envs = gymnasium.vector.VectorEnv[Any, Any, Any]
Env: TypeAlias = "Engine | gymnasium.Env[Any, Any]"

USUAL_WRAPPERS: Final = (OrderEnforcing, PassiveEnvChecker, TimeLimit, ScoreAtTheEnd)
LATE: Final = "TimeLimitError: no end within {:g} s"
"""The failure of an episode that took longer than this."""
NO_SCORE: Final = "only environments of this package have a score: make one with an id that begins with magical_mj/"


class PolicyCopies:
    """A batch policy that consists of copies of a policy for single observations, one for each episode."""

    def __init__(self, policy: Act, envs: Envs) -> None:
        try:
            self._copies = [copy.deepcopy(policy) for _ in range(envs.num_envs)]
        except Exception as error:
            raise SettingsError(
                f"{type(policy).__name__} cannot be copied for parallel episodes ({reason(error)}): give it the "
                "methods reset_batch and act_batch, or play in a single environment"
            ) from error
        self._space = envs.observation_space

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Resets each copy for one of the episodes."""
        for policy, episode in zip(self._copies, episodes, strict=True):
            begin(policy, episode)

    def act_batch(self, observations: Any) -> list[Any]:
        """The action of each copy for its observation."""
        single = iterate(self._space, observations)
        return [policy(observation) for policy, observation in zip(self._copies, single, strict=True)]


def rollouts(
    env: gymnasium.Env[Any, Any] | Envs, policy: Act | BatchPolicy, episodes: Iterable[Episode]
) -> Iterator[EpisodeResult]:
    """Plays the episodes in an environment, or several at a time in a vector environment. Yields results in order.

    Args:
        env: one of the package's environments (with or without wrappers), or a vector environment of one of them. Its
            action space must be the 18 discrete actions.
        policy: the agent. In a single environment, it takes single observations, or batches of one. In a vector
            environment, a `BatchPolicy` acts for all environments at once; any other policy is copied for each
            environment.
        episodes: the episodes, which hold the seeds of the scenes.

    Raises:
        EvaluationError: if the environment has other actions, or is not the environment of the episodes.
        RenderingError, TaskError, EvaluationError, Exception: see `play`.
        SettingsError: if the policy must be copied, but cannot be; or if shifts change the instruction, but the policy
            does not read it.
    """
    episodes = list(episodes)
    facts: dict[str, Any] = {"policy": policy_name(policy), **_checked_facts(env, policy, episodes)}
    if isinstance(env, gymnasium.vector.VectorEnv):
        for start in range(0, len(episodes), env.num_envs):
            wave = episodes[start : start + env.num_envs]
            outcomes = play_side_by_side(
                env, policy, [replace(episode, task=policy_task(episode.task, policy)) for episode in wave]
            )
            for episode, outcome in zip(wave, outcomes, strict=True):
                yield EpisodeResult.of(episode, outcome, split=split_of(episode.seed), **facts)
    else:
        for episode in episodes:
            outcome = play_episode(env, policy, replace(episode, task=policy_task(episode.task, policy)))
            scene = engine_of(env).initial_scene.digest()
            yield EpisodeResult.of(episode, outcome, scene=scene, split=split_of(episode.seed), **facts)


def _checked_facts(
    env: gymnasium.Env[Any, Any] | Envs, policy: Act | BatchPolicy, episodes: Sequence[Episode]
) -> dict[str, Any]:
    """The facts about the environment that played, as fields of `EpisodeResult`. Several environments must agree."""
    each = _conditions(env)
    space = env.single_action_space if isinstance(env, gymnasium.vector.VectorEnv) else env.action_space
    unread: frozenset[Effect] = frozenset() if "instruction" in uses_of(policy) else frozenset({"instruction"})
    for conditions in each:
        check_noticed(parse_shifts(conditions["shift"]), policy_name(policy), unread)
    if not isinstance(space, Discrete):
        raise EvaluationError(
            f"policies return one of the 18 actions, but the environment takes {space}: make it without continuous "
            "actions, and let the policy return magical_mj.actions.to_discrete(vector)"
        )
    for episode, played in zip(episodes, cycle(each), strict=False):
        task, variant = task_name(played["task"]), played["variant"]
        if (episode.task, episode.variant) != (task, variant):
            raise EvaluationError(
                f"the environment is {task} {variant}, but an episode has {episode.task} {episode.variant}"
            )
    facts = [{name: value for name, value in one.items() if name not in ("task", "variant")} for one in each]
    for other in facts[1:]:
        if differing := [name for name, value in facts[0].items() if other[name] != value]:
            raise EvaluationError(
                f"the environments of the vector differ in {', '.join(differing)}, and results have one value for "
                "all: play them one after another"
            )
    kind = facts[0].pop("kind", "")
    return {**facts[0], "wrap": _wrapper(env) or ("" if kind.startswith("magical_mj.") else kind)}


def _conditions(env: gymnasium.Env[Any, Any] | Envs) -> list[dict[str, Any]]:
    """The `conditions` of an environment, or of each environment of a vector."""
    inside: Any = env.unwrapped
    try:
        if not isinstance(env, gymnasium.vector.VectorEnv):
            return [inside.conditions]
        return list(inside.get_attr("conditions") if hasattr(inside, "get_attr") else inside.conditions)
    except AttributeError:
        raise EvaluationError(NO_SCORE) from None


def _wrapper(env: object) -> str:
    """The outermost wrapper that `gymnasium.make` did not add, around a vector or in it. Empty if there is none."""
    while isinstance(env, gymnasium.Wrapper | gymnasium.vector.VectorWrapper):
        if not isinstance(env, USUAL_WRAPPERS):
            return reference_to(type(env))
        env = env.env
    inner = {_wrapper(each) for each in getattr(env, "envs", ())}
    if isinstance(env, gymnasium.vector.AsyncVectorEnv):
        usual = {reference_to(kind) for kind in USUAL_WRAPPERS}
        specs = filter(None, env.get_attr("spec"))
        points = [[each.entry_point for each in spec.additional_wrappers] for spec in specs]
        inner = {next((point for point in reversed(each) if point not in usual), "") for each in points}
    return ", ".join(sorted(filter(None, inner)))


def engine_of(env: Env) -> Engine:
    """The engine of a Gymnasium environment of this package, or `env` itself if it is an engine."""
    engine = getattr(env.unwrapped, "engine", None) if isinstance(env, gymnasium.Env) else env
    if engine is None:
        raise EvaluationError(NO_SCORE)
    return engine


def play_episode(env: Env, policy: Act | BatchPolicy, episode: Episode, seconds: float = math.inf) -> Outcome:
    """Plays one episode. If the policy fails, its score is 0.

    A policy fails if it raises an error, makes the simulation unstable, or has not finished within `seconds`. The time
    is checked after each action. A policy that uses the simulation receives the engine as `Episode.env`. It fails if it
    changes the engine's state, since its actions alone would not lead to the same score.

    Raises:
        RenderingError: if no pictures can be drawn on this machine.
        TaskError: if the task has no scene for the seed, or an invalid score.
        EvaluationError: if the environment is not one of this package, or a wrapper ends the episode too early.
        Exception: any other error of the environment.
    """
    engine, over = engine_of(env), False
    given = engine if "simulation" in uses_of(policy) else None
    with _attempt(seconds) as (outcome, check_time):
        observation = _observation(_reset(env, episode.seed))
        replacement = episode.instruction
        with policy_errors(), _unchanged(given):
            episode = replace(episode, instruction=_sentence(policy, episode, replacement or engine.instruction))
            begin(policy, replace(episode, env=given))
        while not over:
            with policy_errors(), _unchanged(given):
                action = action_number(act(policy, _with_instruction(observation, replacement)))
            check_time()
            result = env.step(action)
            outcome.actions.append(action)
            observation, over = _observation(result), is_over(result)
        _check_whole(outcome.actions, env)
        outcome.score = engine.score()
        outcome.others_moved = engine.side_effects()
    return outcome


def play_side_by_side(
    envs: Envs, policy: Act | BatchPolicy, episodes: Sequence[Episode], seconds: float = math.inf
) -> list[Outcome]:
    """Plays at most one episode per environment. If one fails as described in `play`, all are marked failed."""
    count = len(episodes)
    batch = policy if isinstance(policy, BatchPolicy) else PolicyCopies(policy, envs)
    episodes = [*episodes, *[episodes[-1]] * (envs.num_envs - count)]
    scores, over = np.zeros(count), False
    with _attempt(seconds) as (whole, check_time):
        observations, _ = _reset(envs, [episode.seed for episode in episodes])
        replacements = tuple(filter(None, (episode.instruction for episode in episodes)))
        sentences = replacements or _instructions(envs, episodes)
        begun = [
            replace(each, instruction=_sentence(policy, each, text))
            for each, text in zip(episodes, sentences, strict=True)
        ]
        with policy_errors():
            batch.reset_batch(begun)
        while not over:
            with policy_errors():
                seen = _with_instruction(observations, replacements)
                actions = np.array([action_number(action) for action in batch.act_batch(seen)])
                if len(actions) != envs.num_envs:
                    raise InvalidActionError(f"{len(actions)} actions for {envs.num_envs} environments")
            check_time()
            result = envs.step(actions)
            whole.actions.append(actions)
            observations, over = result[0], is_over(result)
            scores = _scores(*result[3:])
        _check_whole(whole.actions, envs)
    whole.seconds /= count
    return [replace(whole, actions=[row[i] for row in whole.actions], score=scores[i]) for i in range(count)]


def _sentence(policy: object, episode: Episode, sentence: str) -> str:
    """The instruction for a policy. Empty if the task's name is hidden, unless the policy uses instructions."""
    return "" if episode.task == NEUTRAL and "instruction" not in uses_of(policy) else sentence


def _with_instruction(observation: Any, replacement: str | tuple[str, ...]) -> Any:
    """The observation with another instruction, or one for each environment. If it is empty, unchanged."""
    if replacement and isinstance(observation, Mapping) and "instruction" in observation:
        return {**observation, "instruction": replacement}
    return observation


def _instructions(envs: Envs, episodes: Sequence[Episode]) -> Sequence[str]:
    """The instruction (a sentence) of the current episode in each environment."""
    worlds: Any = envs.unwrapped
    if not hasattr(worlds, "get_attr"):  # batched environments, which have no shifts
        return ["" if episode.task == NEUTRAL else task_spec(episode.task).instruction for episode in episodes]
    try:
        return worlds.get_attr("instruction")
    except AttributeError:
        raise EvaluationError(NO_SCORE) from None


@contextmanager
def _unchanged(engine: Engine | None) -> Iterator[None]:
    """A context for calls of a policy that has this engine. Raises a `StateError` if they change its episode."""
    if engine is None:
        yield
        return
    limit, state = engine.limit, engine.get_state()
    yield
    if (engine.limit, engine.get_state()) != (limit, state):
        engine.limit = limit  # which later episodes would have as well
        raise StateError("the policy changed the episode in episode.env: let it try actions in episode.env.clone()")


@contextmanager
def _attempt(seconds: float) -> Iterator[tuple[Outcome, Callable[[], None]]]:
    """A context that suppresses errors of the policy and of an unstable simulation, and records them in the outcome.

    It yields the outcome, and a function that raises an error if more than `seconds` have passed. It sets numpy's error
    handling, so that results do not depend on the caller's ``np.seterr``.
    """
    outcome, start = Outcome(), time.perf_counter()

    def check_time() -> None:
        if time.perf_counter() - start > seconds:
            raise PolicyError(LATE.format(seconds))

    with np.errstate(divide="warn", over="warn", under="ignore", invalid="warn"):
        try:
            yield outcome, check_time
        except PolicyError as error:
            outcome.failure, outcome.cause = str(error), error
        except PhysicsError as error:
            outcome.failure = reason(error)
    outcome.seconds = time.perf_counter() - start


def _scores(ended: NDArray[np.bool_], info: Any) -> Any:
    """The scores after a step of a vector environment, shape (n,), from the values that the step returned."""
    if not isinstance(info, Mapping):
        raise EvaluationError(f"infos must be a dict, not {type(info).__name__}: leave out the wrapper")
    info = info.get("final_info", info)  # present if the next episodes have begun
    if np.any(info.get("broken", False)):  # only batched environments have it
        raise PhysicsError("the state of a simulation is not finite any more")
    if ended.any() and not ended.all():
        raise EvaluationError("the environments of the vector differ in the length of their episodes")
    if "eval_score" not in info:
        raise EvaluationError(NO_SCORE)
    return info["eval_score"]


def _check_whole(actions: Sequence[Any], env: Env | Envs) -> None:
    """Raises an `EvaluationError` unless each action of the policy was one step of the environment, up to its end."""
    inside: Any = env.unwrapped if isinstance(env, gymnasium.Env | gymnasium.vector.VectorEnv) else env
    limits = inside.get_attr("limit") if hasattr(inside, "get_attr") else [getattr(inside, "limit", 0)]
    if len(actions) >= min(limits):
        return
    if getattr(getattr(inside, "engine", None), "over", False):
        raise EvaluationError(
            f"a wrapper made {min(limits)} steps from {len(actions)} actions, and results need an action for each "
            "step: leave it out, and repeat actions in the policy instead"
        )
    raise EvaluationError(f"a wrapper ended the episode after {len(actions)} of {min(limits)} steps: leave it out")


def _reset(env: Env | Envs, seed: Any) -> Any:
    """The result of a reset with a seed, or with a list of seeds. Checks that no wrapper has kept them to itself."""
    try:
        result = env.reset(seed=seed)
    except (InvalidSceneError, PlacementError) as error:
        raise TaskError(f"no episode can start in the scene of seed {seed}: {error}") from error
    inside: Any = env.unwrapped if isinstance(env, gymnasium.Env | gymnasium.vector.VectorEnv) else None
    got = seed
    if isinstance(inside, gymnasium.Env):
        got = inside.np_random_seed
    elif hasattr(inside, "get_attr"):
        got = list(inside.get_attr("np_random_seed"))
    if got != seed:
        raise EvaluationError(
            f"a wrapper did not pass the seed {seed} on, so that the episode started in another scene: its reset must "
            "call super().reset(seed=seed, options=options)"
        )
    return result


def _observation(result: Any) -> Any:
    """The observation in the result of Gymnasium's `reset` or `step`. None if the result is an engine's."""
    return result[0] if isinstance(result, tuple) else None
