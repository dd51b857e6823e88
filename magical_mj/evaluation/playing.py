"""Playing single episodes with policies."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import dm_env
import gymnasium

from magical_mj.envs.registration import env_id
from magical_mj.policies.failures import PolicyError, acting, instability
from magical_mj.policies.interface import Episode, begin, is_blind, letters_of
from magical_mj.policies.interface import play as play_actions
from magical_mj.scene.actions import action_number
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import EvaluationError, InvalidSceneError, PlacementError, TaskError

if TYPE_CHECKING:
    from magical_mj.envs.composer import Environment

Act = Callable[[Any], Any]
"""A policy, or a plain function from observation to action."""
Envs = gymnasium.vector.VectorEnv[Any, Any, Any]
Env: TypeAlias = "Environment | gymnasium.Env[Any, Any]"

NO_SCORE: Final = "only environments of this package have a score: make one whose id begins with magical_mj/"


@dataclass(frozen=True)
class Outcome:
    """How an episode ended.

    Attributes:
        score: in [0, 1]; 0 if the policy failed.
        actions: the actions, as a string with a letter for each step.
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
        from magical_mj.envs.composer import load  # imported late: it loads the simulator

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
        observation = _observation(reset(env, episode.seed))
        with acting():
            begin(policy, replace(episode, env=inside) if is_blind(policy) else episode)

        def answers() -> Iterator[int]:
            while True:
                with acting():
                    action = action_number(policy(observation))
                yield action

        for action, result in play_actions(env, answers()):
            actions.append(action)
            observation = _observation(result)
        score = inside.score()
    except PolicyError as error:
        failure = str(error)
    except Exception as error:  # noqa: BLE001 raised again if it is another
        failure = instability(error)
    return Outcome(score, letters_of(actions), time.perf_counter() - start, failure)


def reset(env: Env | Envs, seed: Any) -> Any:
    """What `reset` returns; raises a `TaskError` if no episode can start in the scene of a seed."""
    try:
        return env.reset(seed=seed)
    except (InvalidSceneError, PlacementError) as error:
        raise TaskError(f"no episode can start in the scene of seed {seed}: {error}") from error


def _observation(result: Any) -> Any:
    """The observation in the result of `reset` or `step` of Gymnasium; None for dm_env."""
    return None if isinstance(result, dm_env.TimeStep) else result[0]
