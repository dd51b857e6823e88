"""Playing one episode: the environments that policies see, and what becomes of policies that fail."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

import gymnasium

import magical_mj
from magical_mj.actions import action_number
from magical_mj.errors import RenderingError
from magical_mj.evaluation.policies import Episode, begin

if TYPE_CHECKING:
    from magical_mj.environment import Environment
    from magical_mj.gym_env import MagicalEnv

LETTERS: Final = "abcdefghijklmnopqr"
"""One for each of the 18 actions: episodes are kept as words."""
REASON_LENGTH: Final = 300


@dataclass(frozen=True)
class Outcome:
    """How an episode ended.

    Attributes:
        score: in [0, 1]; 0 if the policy failed.
        actions: what was done, one of `LETTERS` for each step.
        seconds: of the whole episode.
        failure: why the policy failed; None if it did not.
    """

    score: float
    actions: str
    seconds: float
    failure: str | None = None


class World(Protocol):
    """One environment, as episodes are played in it."""

    @property
    def env(self) -> Environment | None:
        """The simulation itself, for policies that look at no observations."""
        ...

    def reset(self, seed: int) -> Any:
        """The first observation of the scene of `seed`."""
        ...

    def step(self, action: int) -> tuple[Any, bool]:
        """The next observation, and whether it is the last."""
        ...

    def score(self) -> float:
        """Of the present state."""
        ...

    def close(self) -> None:
        """Frees the environment."""


class BlindWorld:
    """The simulation without observations, for policies that look at none."""

    def __init__(self, task: str, variant: str, rules: Any) -> None:
        self.env = magical_mj.load(task, variant, seed=0, observations=(), rules=rules)

    def reset(self, seed: int) -> None:
        """Starts the scene of `seed`."""
        self.env.reset(seed=seed)

    def step(self, action: int) -> tuple[None, bool]:
        """One action."""
        return None, self.env.step(action).last()

    def score(self) -> float:
        """Of the present state."""
        return self.env.score()

    def close(self) -> None:
        """Frees the simulation."""
        self.env.close()


class SeenWorld:
    """The Gymnasium environment with a preset's observations."""

    env: None = None

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        self._env: gymnasium.Env[Any, Any] = env
        self._score = 0.0

    def reset(self, seed: int) -> Any:
        """The first observation of the scene of `seed`."""
        return self._env.reset(seed=seed)[0]

    def step(self, action: int) -> tuple[Any, bool]:
        """The next observation, and whether it is the last."""
        observation, _, terminated, truncated, info = self._env.step(action)
        self._score = float(info["eval_score"])
        return observation, terminated or truncated

    def score(self) -> float:
        """Of the last step."""
        return self._score

    def close(self) -> None:
        """Frees the environment."""
        self._env.close()


def seen_world(task: str, variant: str, preset: str, rules: Any) -> SeenWorld:
    """The registered environment without Gymnasium's wrappers, which check at each step what the tests have checked."""
    env: MagicalEnv = gymnasium.make(magical_mj.env_id(task, variant, preset), rules=rules).unwrapped  # type: ignore[assignment]
    return SeenWorld(env)


def play(world: World, policy: Callable[[Any], Any], episode: Episode) -> Outcome:
    """Plays one episode; whatever the policy does wrong is its failure, and costs it the score.

    Raises:
        RenderingError: if no pictures can be drawn here, which is not the policy's fault.
    """
    start = time.perf_counter()
    actions: list[str] = []
    score, failure, last = 0.0, None, False
    try:
        observation = world.reset(episode.seed)
        begin(policy, episode)
        while not last:
            action = action_number(policy(observation))
            actions.append(LETTERS[action])
            observation, last = world.step(action)
        score = world.score()
    except RenderingError:
        raise
    except Exception as error:  # noqa: BLE001 a policy may raise anything
        failure = reason(error)
    return Outcome(score, "".join(actions), time.perf_counter() - start, failure)


def reason(error: BaseException) -> str:
    """One line about an error."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:REASON_LENGTH]


def actions_of(word: str) -> list[int]:
    """The actions of an episode that was kept as a word."""
    return [LETTERS.index(letter) for letter in word]
