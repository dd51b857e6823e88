"""Episodes in Gymnasium environments of the user's own, plain ones and vectors, in every autoreset mode.

All episodes of an environment have the same length. So a vector environment is reset with one scene for each of its
environments and stepped until all have ended, together. Whether and when it would reset itself does not matter, for
it is always reset to the next scenes first.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector.utils import iterate

from magical_mj.actions import action_number
from magical_mj.errors import EvaluationError, RenderingError
from magical_mj.evaluation.episodes import LETTERS, Outcome, SeenWorld, play, reason
from magical_mj.evaluation.policies import BatchPolicy, Episode, begin

Envs = gymnasium.vector.VectorEnv[Any, Any, Any]


class Copies:
    """A policy for single observations in several episodes at once: one copy of it for each."""

    def __init__(self, policy: Callable[[Any], Any], envs: Envs) -> None:
        self._copies = [copy.deepcopy(policy) for _ in range(envs.num_envs)]
        self._space = envs.observation_space

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Begins one of the episodes with each copy."""
        for policy, episode in zip(self._copies, episodes, strict=True):
            begin(policy, episode)

    def act_batch(self, observations: Any) -> list[Any]:
        """Each copy's action for its own observation."""
        single = iterate(self._space, observations)
        return [policy(observation) for policy, observation in zip(self._copies, single, strict=True)]


def rollouts(
    env: gymnasium.Env[Any, Any] | Envs,
    policy: Callable[[Any], Any] | BatchPolicy,
    episodes: Sequence[Episode],
) -> Iterator[Outcome]:
    """Plays the episodes in an environment, or side by side in a vector environment, and yields how they end, in order.

    Args:
        env: one of the package's environments (through any wrappers), or a vector of one of them.
        policy: what acts; for plain environments it takes single observations. In a vector, a `BatchPolicy` acts for
            all environments at once, and of any other policy each environment gets a copy.
        episodes: with seeds for the scenes.

    Raises:
        RenderingError: if no pictures can be drawn here.
    """
    if isinstance(env, gymnasium.vector.VectorEnv):
        acting = policy if isinstance(policy, BatchPolicy) else Copies(policy, env)
        for start in range(0, len(episodes), env.num_envs):
            yield from play_wave(env, acting, episodes[start : start + env.num_envs])
    elif callable(policy):
        yield from (play(SeenWorld(env), policy, episode) for episode in episodes)
    else:
        raise EvaluationError(f"{type(policy).__name__} takes only batches, and the environment is a single one")


def play_wave(envs: Envs, policy: BatchPolicy, episodes: Sequence[Episode]) -> list[Outcome]:
    """Plays at most as many episodes as there are environments. What the policy does wrong costs them all."""
    start = time.perf_counter()
    count = len(episodes)
    padded = [*episodes, *[episodes[-1]] * (envs.num_envs - count)]
    words: list[str] = [""] * count
    try:
        seeds: Any = [episode.seed for episode in padded]  # the base class knows only of one seed
        observations, _ = envs.reset(seed=seeds)
        policy.reset_batch(padded)
        while True:
            actions = [action_number(action) for action in policy.act_batch(observations)]
            words = [word + LETTERS[action] for word, action in zip(words, actions, strict=False)]
            observations, _, _, ended, info = envs.step(np.array(actions))
            if ended.any():
                break
        scores = info.get("final_info", info)["eval_score"]
        if not ended.all():
            raise EvaluationError("the vector holds environments whose episodes differ in length")
    except (RenderingError, EvaluationError):
        raise
    except Exception as error:  # noqa: BLE001 a policy may raise anything
        seconds = (time.perf_counter() - start) / count
        return [Outcome(0.0, word, seconds, reason(error)) for word in words]
    seconds = (time.perf_counter() - start) / count
    return [Outcome(float(score), word, seconds) for score, word in zip(scores, words, strict=False)]
