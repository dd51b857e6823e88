"""Playing episodes side by side in a vector environment; `rollouts` plays in single ones as well.

All episodes of an environment have the same length. So a vector environment is reset with one scene for each of its
environments and stepped until all have ended together. Its autoreset mode does not matter, since it is always reset
explicitly before the next episodes.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Discrete
from gymnasium.vector.utils import iterate
from numpy.typing import NDArray

from magical_mj.evaluation.playing import NO_SCORE, Act, Envs, Outcome, play, reset, simulation
from magical_mj.policies.failures import PolicyError, acting, instability, reason
from magical_mj.policies.interface import Episode, begin, letters_of
from magical_mj.policies.interface import play as play_actions
from magical_mj.policies.requirements import BatchPolicy
from magical_mj.scene.actions import action_number
from magical_mj.tasks.registry import task_name
from magical_mj.utils.errors import EvaluationError, InvalidActionError, SettingsError


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
) -> Iterator[Outcome]:
    """Plays the episodes in an environment, or side by side in a vector environment; yields their outcomes in order.

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
    _check_fits(env, episodes)
    if isinstance(env, gymnasium.vector.VectorEnv):
        batch = policy if isinstance(policy, BatchPolicy) else PolicyCopies(policy, env)
        for start in range(0, len(episodes), env.num_envs):
            yield from play_side_by_side(env, batch, episodes[start : start + env.num_envs])
    elif callable(policy):
        yield from (play(env, policy, episode) for episode in episodes)
    else:
        raise EvaluationError(f"{type(policy).__name__} takes only batches, and the environment is a single one")


def _check_fits(env: gymnasium.Env[Any, Any] | Envs, episodes: Sequence[Episode]) -> None:
    if isinstance(env, gymnasium.vector.VectorEnv):
        space, spec = env.single_action_space, env.spec
        if spec is None and isinstance(env.unwrapped, gymnasium.vector.SyncVectorEnv | gymnasium.vector.AsyncVectorEnv):
            spec = env.unwrapped.get_attr("spec")[0]  # that of its first environment
        made = {} if spec is None else spec.kwargs
        task, variant = made.get("task"), made.get("variant")
    else:
        space, settings = env.action_space, simulation(env).task.settings
        task, variant = settings.task, settings.variant
    if not isinstance(space, Discrete):
        raise EvaluationError(
            f"policies give one of the 18 actions, and the environment takes {space}: make it without continuous "
            "actions, and end the policy in magical_mj.scene.actions.to_discrete(vector)"
        )
    other = [one for one in episodes if task is not None and (one.task, one.variant) != (task_name(task), variant)]
    if other:
        raise EvaluationError(f"the environment is {task} {variant}, and an episode {other[0].task} {other[0].variant}")


def play_side_by_side(envs: Envs, policy: BatchPolicy, episodes: Sequence[Episode]) -> list[Outcome]:
    """Plays at most one episode per environment. All of them have failed if one would have in `play`."""
    start = time.perf_counter()
    count = len(episodes)
    padded = [*episodes, *[episodes[-1]] * (envs.num_envs - count)]
    taken: list[NDArray[np.int64]] = []
    scores, failure = np.zeros(count), None
    try:
        observations, _ = reset(envs, [episode.seed for episode in padded])
        with acting():
            policy.reset_batch(padded)

        def answers() -> Iterator[Any]:
            while True:
                with acting():
                    actions = [action_number(action) for action in policy.act_batch(observations)]
                    if len(actions) != len(padded):
                        raise InvalidActionError(f"{len(actions)} actions for {len(padded)} environments")
                yield np.array(actions)

        for actions, result in play_actions(envs, answers()):
            taken.append(actions)
            observations, _, _, ended, info = result
            if not isinstance(info, Mapping):
                raise EvaluationError(f"infos must be a dict, not {type(info).__name__}: leave out the wrapper")
            info = info.get("final_info", info)  # the former if the next episodes have begun
            if np.any(info.get("broken", False)):  # of batched worlds
                raise FloatingPointError("the state of a simulation is not finite any more")
            if ended.any() and not ended.all():
                raise EvaluationError("the vector holds environments whose episodes differ in length")
            if "eval_score" not in info:
                raise EvaluationError(NO_SCORE)
            scores = info["eval_score"]
    except PolicyError as error:
        failure, scores = str(error), np.zeros(count)
    except Exception as error:  # noqa: BLE001 raised again if it is another
        failure, scores = instability(error), np.zeros(count)
    seconds = (time.perf_counter() - start) / count
    letters = [letters_of(actions[place] for actions in taken) for place in range(count)]
    return [Outcome(float(score), played, seconds, failure) for score, played in zip(scores, letters, strict=False)]
