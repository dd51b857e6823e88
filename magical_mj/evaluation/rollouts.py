"""Playing episodes with policies, one after another or side by side in a vector environment.

All episodes of an environment have the same length. So a vector environment is reset with one scene for each of its
environments and stepped until all have ended together. Its autoreset mode does not matter, since it is always reset
explicitly before the next episodes.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import gymnasium
import numpy as np
from gymnasium.spaces import Discrete
from gymnasium.vector.utils import iterate
from numpy.typing import NDArray

from magical_mj.envs.registration import env_id
from magical_mj.evaluation.scores import EpisodeResult, result_of
from magical_mj.policies.interface import (
    Act,
    BatchPolicy,
    Episode,
    PolicyError,
    begin,
    policy_errors,
    policy_name,
    reason,
    simulation_failure,
    uses_simulation,
)
from magical_mj.policies.interface import play as play_actions
from magical_mj.scene.actions import action_number
from magical_mj.tasks.registry import task_name
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import (
    EvaluationError,
    InvalidActionError,
    InvalidSceneError,
    PhysicsError,
    PlacementError,
    SettingsError,
    TaskError,
)

if TYPE_CHECKING:
    from magical_mj.engine import Engine

Envs = gymnasium.vector.VectorEnv[Any, Any, Any]
Env: TypeAlias = "Engine | gymnasium.Env[Any, Any]"

NO_SCORE: Final = "only environments of this package have a score: make one whose id begins with magical_mj/"


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
    env: gymnasium.Env[Any, Any] | Envs, policy: Act | BatchPolicy, episodes: Iterable[Episode]
) -> Iterator[EpisodeResult]:
    """Plays the episodes in an environment, or side by side in a vector environment; yields their results in order.

    Args:
        env: one of the package's environments (with or without wrappers), or a vector environment of one of them. Its
            actions are the 18.
        policy: the agent; for single environments it takes single observations. In a vector environment, a
            `BatchPolicy` acts for all environments at once; of any other policy, each environment gets a copy.
        episodes: the episodes, which hold the seeds of the scenes.

    Raises:
        EvaluationError: if the environment has other actions, or is not that of the episodes.
        RenderingError, TaskError, EvaluationError, Exception: see `play`.
        SettingsError: if the policy must be copied, and cannot be.
    """
    episodes = list(episodes)
    rules = _check_fits(env, episodes)
    if isinstance(env, gymnasium.vector.VectorEnv):
        batch = policy if isinstance(policy, BatchPolicy) else PolicyCopies(policy, env)
        for start in range(0, len(episodes), env.num_envs):
            results = play_side_by_side(env, batch, episodes[start : start + env.num_envs], rules)
            yield from (replace(result, policy=policy_name(policy)) for result in results)
    elif callable(policy):
        yield from (play(env, policy, episode) for episode in episodes)
    else:
        raise EvaluationError(f"{type(policy).__name__} takes only batches, and the environment is a single one")


def _check_fits(env: gymnasium.Env[Any, Any] | Envs, episodes: Sequence[Episode]) -> Rules:
    """The rules of an environment; raises an `EvaluationError` unless it is that of the episodes."""
    if isinstance(env, gymnasium.vector.VectorEnv):
        space, spec = env.single_action_space, env.spec
        if spec is None and isinstance(env.unwrapped, gymnasium.vector.SyncVectorEnv | gymnasium.vector.AsyncVectorEnv):
            spec = env.unwrapped.get_attr("spec")[0]  # that of its first environment
        arguments = {} if spec is None else spec.kwargs
        task, variant, rules = arguments.get("task"), arguments.get("variant"), arguments.get("rules", "paper")
    else:
        space, engine = env.action_space, simulation(env)
        task, variant, rules = engine.task, engine.variant, engine.setup.rules
    if not isinstance(space, Discrete):
        raise EvaluationError(
            f"policies give one of the 18 actions, and the environment takes {space}: make it without continuous "
            "actions, and end the policy in magical_mj.scene.actions.to_discrete(vector)"
        )
    name = None if task is None else task_name(task)
    other = [episode for episode in episodes if name is not None and (episode.task, episode.variant) != (name, variant)]
    if other:
        raise EvaluationError(f"the environment is {task} {variant}, and an episode {other[0].task} {other[0].variant}")
    return rules


def environment_for(policy: Act, task: str, variant: str, preset: str, rules: Rules) -> Env:
    """The environment that a policy plays in: Gymnasium's with the preset's observations, or the bare engine.

    The Gymnasium environment has no wrappers of `gymnasium.make`, whose checks at each step would only take time.
    """
    if uses_simulation(policy):
        from magical_mj.engine import Engine  # imported late: it loads the simulator

        return Engine(task, variant, seed=0, rules=rules)
    return gymnasium.make(env_id(task, variant, preset), rules=rules).unwrapped


def simulation(env: Env) -> Engine:
    """The engine itself, or the one inside a Gymnasium environment, which must be of this package."""
    if not isinstance(env, gymnasium.Env):
        return env
    inside = getattr(env.unwrapped, "engine", None)
    if inside is None:
        raise EvaluationError(NO_SCORE)
    return inside


def play(env: Env, policy: Act, episode: Episode) -> EpisodeResult:
    """Plays one episode. If the policy raises an error, or makes the simulation unstable, its score is 0.

    Args:
        env: one of the package's environments, with or without wrappers.
        policy: the agent. One that uses the simulation gets it in the episode.
        episode: the episode.

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
    with usual_floats():
        try:
            observation = _observation(_reset(env, episode.seed))
            with policy_errors():
                begin(policy, replace(episode, env=inside) if uses_simulation(policy) else episode)

            def chosen() -> Iterator[int]:
                while True:
                    with policy_errors():
                        action = action_number(policy(observation))
                    yield action

            for action, result in play_actions(env, chosen()):
                actions.append(action)
                observation = _observation(result)
            score = inside.score()
        except PolicyError as error:
            failure = str(error)
        except Exception as error:  # noqa: BLE001 raised again if it is another
            failure = simulation_failure(error)
    facts = {"policy": policy_name(policy), "preset": None, "rules": inside.rules}
    facts["scene"] = inside.initial_scene.digest()
    return result_of(episode, actions, score, failure, time.perf_counter() - start, **facts)


def play_side_by_side(
    envs: Envs, policy: BatchPolicy, episodes: Sequence[Episode], rules: Rules = "paper"
) -> list[EpisodeResult]:
    """Plays at most one episode per environment. All of them have failed if one would have in `play`."""
    start = time.perf_counter()
    count = len(episodes)
    padded = [*episodes, *[episodes[-1]] * (envs.num_envs - count)]
    taken: list[NDArray[np.int64]] = []
    scores, failure = np.zeros(count), None
    with usual_floats():
        try:
            observations, _ = _reset(envs, [episode.seed for episode in padded])
            with policy_errors():
                policy.reset_batch(padded)

            def chosen() -> Iterator[Any]:
                while True:
                    with policy_errors():
                        actions = [action_number(action) for action in policy.act_batch(observations)]
                        if len(actions) != len(padded):
                            raise InvalidActionError(f"{len(actions)} actions for {len(padded)} environments")
                    yield np.array(actions)

            for actions, result in play_actions(envs, chosen()):
                taken.append(actions)
                observations, _, _, ended, info = result
                scores = _scores(ended, info)
        except PolicyError as error:
            failure = str(error)
        except Exception as error:  # noqa: BLE001 raised again if it is another
            failure = simulation_failure(error)
    seconds = (time.perf_counter() - start) / count
    return [
        result_of(
            episode,
            [actions[place] for actions in taken],
            scores[place],
            failure,
            seconds,
            policy=policy_name(policy),
            preset=None,
            rules=rules,
        )
        for place, episode in enumerate(episodes)
    ]


def _scores(ended: NDArray[np.bool_], info: Any) -> Any:
    """The scores after a step of a vector environment, shape (n,), from what the step returned."""
    if not isinstance(info, Mapping):
        raise EvaluationError(f"infos must be a dict, not {type(info).__name__}: leave out the wrapper")
    info = info.get("final_info", info)  # the former if the next episodes have begun
    if np.any(info.get("broken", False)):  # of batched worlds
        raise PhysicsError("the state of a simulation is not finite any more")
    if ended.any() and not ended.all():
        raise EvaluationError("the vector holds environments whose episodes differ in length")
    if "eval_score" not in info:
        raise EvaluationError(NO_SCORE)
    return info["eval_score"]


def usual_floats() -> np.errstate:
    """A context with numpy's own settings: results depend on no ``np.seterr`` of the caller."""
    return np.errstate(divide="warn", over="warn", under="ignore", invalid="warn")


def _reset(env: Env | Envs, seed: Any) -> Any:
    """What `reset` returns; raises a `TaskError` if no episode can start in the scene of a seed."""
    try:
        return env.reset(seed=seed)
    except (InvalidSceneError, PlacementError) as error:
        raise TaskError(f"no episode can start in the scene of seed {seed}: {error}") from error


def _observation(result: Any) -> Any:
    """The observation in the result of `reset` or `step` of Gymnasium; None for an engine's."""
    return result[0] if isinstance(result, tuple) else None
