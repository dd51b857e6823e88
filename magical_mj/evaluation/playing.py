"""Playing episodes with policies, one after another or side by side, and handling policies that fail.

All episodes of an environment have the same length. So a vector environment is reset with one scene for each of its
environments and stepped until all have ended together. Its autoreset mode does not matter, since it is always reset
explicitly before the next episodes.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import dm_env
import gymnasium
import numpy as np
from gymnasium.vector.utils import iterate
from numpy.typing import NDArray

from magical_mj.actions import action_number
from magical_mj.episodes import Episode, begin, is_blind, word_of
from magical_mj.episodes import play as play_actions
from magical_mj.errors import (
    EvaluationError,
    InvalidActionError,
    InvalidSceneError,
    PlacementError,
    RenderingError,
    SettingsError,
    TaskError,
)
from magical_mj.evaluation.policies import BatchPolicy
from magical_mj.registration import env_id
from magical_mj.rendering.backend import check_opengl
from magical_mj.tasks.spec import Rules

if TYPE_CHECKING:
    from magical_mj.environment import Environment

Act = Callable[[Any], Any]
"""A policy, or a plain function from observation to action."""
Envs = gymnasium.vector.VectorEnv[Any, Any, Any]
Env: TypeAlias = "Environment | gymnasium.Env[Any, Any]"

REASON_LENGTH: Final = 300
NO_SCORE: Final = "only environments of this package have a score: make one whose id begins with magical_mj/"


@dataclass(frozen=True)
class Outcome:
    """How an episode ended.

    Attributes:
        score: in [0, 1]; 0 if the policy failed.
        actions: the actions, as a word with a letter for each step.
        seconds: the duration of the episode, wall clock.
        failure: why the policy failed; None if it did not.
    """

    score: float
    actions: str
    seconds: float
    failure: str | None = None


def environment_for(policy: Act, task: str, variant: str, preset: str, rules: Rules) -> Env:
    """The environment that a policy plays in: Gymnasium's with the preset's observations, or the bare simulation.

    The Gymnasium environment has no wrappers of `gymnasium.make`, whose checks at each step would only take time.
    """
    if is_blind(policy):
        check_opengl()
        from magical_mj.environment import load  # imported late: it loads the simulator

        return load(task, variant, seed=0, observations=(), rules=rules)
    return gymnasium.make(env_id(task, variant, preset), rules=rules).unwrapped


def simulation(env: Env) -> Environment:
    """The dm_env environment itself, or the one inside a Gymnasium environment, which must be of this package."""
    if not isinstance(env, gymnasium.Env):
        return env
    inside = getattr(env.unwrapped, "dm_env", None)
    if inside is None:
        raise EvaluationError(NO_SCORE)
    return inside


class _PolicyError(Exception):
    """An error that a policy has raised."""


@contextmanager
def _acting() -> Iterator[None]:
    """Where errors are failures of the policy, unless they say that they are not."""
    try:
        yield
    except (RenderingError, TaskError):
        raise
    except (Exception, SystemExit) as error:  # a policy may raise anything
        raise _PolicyError(reason(error)) from error


def _instability(error: Exception) -> str:
    """One line about a simulation that a policy's actions made unstable; raises any other error again."""
    from dm_control.rl.control import PhysicsError  # imported late: it loads the simulator

    if not isinstance(error, PhysicsError | FloatingPointError):
        raise error
    return reason(error)


def play(env: Env, policy: Act, episode: Episode) -> Outcome:
    """Plays one episode. If the policy raises an error, or makes the simulation unstable, its score is 0.

    Args:
        env: one of the package's environments, with or without wrappers.
        policy: the agent.
        episode: the episode. Policies that use no observations get the environment in it.

    Raises:
        RenderingError, TaskError: if no pictures can be drawn on this machine, or the task has no scene for the seed
            or an invalid score, which is not the policy's fault.
        EvaluationError: if it is no environment of this package.
        Exception: whatever else the environment raises.
    """
    start = time.perf_counter()
    actions: list[int] = []
    score, failure = 0.0, None
    inside = simulation(env)
    try:
        observation = _observation(_reset(env, episode.seed))
        with _acting():
            begin(policy, replace(episode, env=inside) if is_blind(policy) else episode)

        def answers() -> Iterator[int]:
            while True:
                with _acting():
                    action = action_number(policy(observation))
                yield action

        for action, result in play_actions(env, answers()):
            actions.append(action)
            observation = _observation(result)
        score = inside.score()
    except _PolicyError as error:
        failure = str(error)
    except Exception as error:  # noqa: BLE001 raised again if it is another
        failure = _instability(error)
    return Outcome(score, word_of(actions), time.perf_counter() - start, failure)


def _reset(env: Env | Envs, seed: Any) -> Any:
    """What `reset` returns; raises a `TaskError` if no episode can start in the scene of a seed."""
    try:
        return env.reset(seed=seed)
    except (InvalidSceneError, PlacementError) as error:
        raise TaskError(f"no episode can start in the scene of seed {seed}: {error}") from error


def _observation(result: Any) -> Any:
    """The observation in the result of `reset` or `step` of Gymnasium; None for dm_env."""
    return None if isinstance(result, dm_env.TimeStep) else result[0]


def reason(error: BaseException) -> str:
    """One line about an error, which can be encoded: Python shows bytes of file names as characters that cannot."""
    try:
        said = str(error)
    except Exception:  # noqa: BLE001 a policy's exceptions may be broken, too
        said = "an error without a message"
    text = " ".join(f"{type(error).__name__}: {said}".split())
    return text.encode(errors="backslashreplace").decode()[:REASON_LENGTH]


class PolicyCopies:
    """A batch policy made of copies of a policy for single observations, one for each episode."""

    def __init__(self, policy: Act, envs: Envs) -> None:
        try:
            self._copies = [copy.deepcopy(policy) for _ in range(envs.num_envs)]
        except Exception as error:
            raise SettingsError(
                f"{type(policy).__name__} cannot be copied for episodes side by side ({reason(error)}): give it the "
                "methods reset_batch and act_batch, or play one episode at a time (envs=1)"
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
    env: gymnasium.Env[Any, Any] | Envs, policy: Act | BatchPolicy, episodes: Sequence[Episode]
) -> Iterator[Outcome]:
    """Plays the episodes in an environment, or side by side in a vector environment; yields their outcomes in order.

    Args:
        env: one of the package's environments (with or without wrappers), or a vector environment of one of them.
        policy: the agent; for single environments it takes single observations. In a vector environment, a
            `BatchPolicy` acts for all environments at once; of any other policy, each environment gets a copy.
        episodes: the episodes, which hold the seeds of the scenes.

    Raises:
        RenderingError, TaskError, EvaluationError, Exception: see `play`.
        SettingsError: if the policy must be copied, and cannot be.
    """
    if isinstance(env, gymnasium.vector.VectorEnv):
        acting = policy if isinstance(policy, BatchPolicy) else PolicyCopies(policy, env)
        for start in range(0, len(episodes), env.num_envs):
            yield from play_side_by_side(env, acting, episodes[start : start + env.num_envs])
    elif callable(policy):
        yield from (play(env, policy, episode) for episode in episodes)
    else:
        raise EvaluationError(f"{type(policy).__name__} takes only batches, and the environment is a single one")


def play_side_by_side(envs: Envs, policy: BatchPolicy, episodes: Sequence[Episode]) -> list[Outcome]:
    """Plays at most one episode per environment. All of them have failed if one would have in `play`."""
    start = time.perf_counter()
    count = len(episodes)
    padded = [*episodes, *[episodes[-1]] * (envs.num_envs - count)]
    taken: list[NDArray[np.int64]] = []
    scores, failure = np.zeros(count), None
    try:
        observations, _ = _reset(envs, [episode.seed for episode in padded])
        with _acting():
            policy.reset_batch(padded)

        def answers() -> Iterator[Any]:
            while True:
                with _acting():
                    actions = [action_number(action) for action in policy.act_batch(observations)]
                    if len(actions) != len(padded):
                        raise InvalidActionError(f"{len(actions)} actions for {len(padded)} environments")
                yield np.array(actions)

        for actions, result in play_actions(envs, answers()):
            taken.append(actions)
            observations, _, _, ended, info = result
            info = info.get("final_info", info)  # the former if the next episodes have begun
            if np.any(info.get("broken", False)):  # of batched worlds
                raise FloatingPointError("the state of a simulation is not finite any more")
            if ended.any() and not ended.all():
                raise EvaluationError("the vector holds environments whose episodes differ in length")
            if "eval_score" not in info:
                raise EvaluationError(NO_SCORE)
            scores = info["eval_score"]
    except _PolicyError as error:
        failure, scores = str(error), np.zeros(count)
    except Exception as error:  # noqa: BLE001 raised again if it is another
        failure, scores = _instability(error), np.zeros(count)
    seconds = (time.perf_counter() - start) / count
    words = [word_of(actions[place] for actions in taken) for place in range(count)]
    return [Outcome(float(score), word, seconds, failure) for score, word in zip(scores, words, strict=False)]
