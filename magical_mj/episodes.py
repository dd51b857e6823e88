"""Episodes: what a policy is told about one, the loop that plays one, and how its actions are written down."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

import dm_env
import numpy as np

if TYPE_CHECKING:
    from magical_mj.environment import Environment

Action = TypeVar("Action")

LETTERS: Final = "abcdefghijklmnopqr"
"""One for each of the 18 actions: the actions of an episode are kept as a word."""


@dataclass(frozen=True)
class Episode:
    """What a policy is told about the episode that begins.

    Attributes:
        task: the task's name.
        variant: the variant's name.
        seed: of the scene: the episode starts in `sample_scene(task, variant, seed)`.
        run: which of several runs of a method this policy is.
        env: the simulation itself, for policies that say `blind = True`; None for all others.
    """

    task: str
    variant: str
    seed: int
    run: int = 0
    env: Environment | None = None

    def rng(self) -> np.random.Generator:
        """A generator for the policy's own draws: the same wherever and whenever this episode is played."""
        return np.random.default_rng([self.run, self.seed, zlib.crc32(f"{self.task}-{self.variant}".encode())])


class Policy(Protocol):
    """An agent. A plain function from observation to action will do as well.

    A class attribute `blind = True` says that the policy looks at no observations: none are made, which is much
    faster, and `reset` gets the simulation instead. Attributes `preset`, `tasks` and `observation_space` say which
    observations it was trained on and in which tasks it can act; others are then refused before anything is played.
    """

    def reset(self, episode: Episode) -> None:
        """Called before each episode. Nothing may be carried over from one to the next."""

    def __call__(self, observation: Any) -> Any:
        """The action, an integer in 0..17, for an observation of the preset."""


def play(env: Any, actions: Iterable[Action]) -> Iterator[tuple[Action, Any]]:
    """Takes actions in an episode that has begun, until it ends or there are no more of them.

    Args:
        env: what has the `step` of dm_env or of Gymnasium. In a vector environment, the episodes end together.
        actions: to be taken. They may be thought of one by one, for each is asked for only when the last step and
            what the caller does with it are done.

    Yields:
        Each action, and what the environment's step returned.
    """
    for action in actions:
        result = env.step(action)
        yield action, result
        if _ended(result):
            return


def forever(act: Callable[[], Action]) -> Iterator[Action]:
    """One action after another, for `play`."""
    while True:
        yield act()


def _ended(result: Any) -> bool:
    if isinstance(result, dm_env.TimeStep):
        return result.last()
    _, _, terminated, truncated, _ = result
    return bool(np.any(terminated) or np.any(truncated))


def begin(policy: Callable[[Any], Any], episode: Episode) -> None:
    """Tells the policy, if it wants to know, that an episode begins."""
    reset = getattr(policy, "reset", None)
    if reset is not None:
        reset(episode)


def is_blind(policy: object) -> bool:
    """Whether the policy looks at no observations."""
    return bool(getattr(policy, "blind", False))


def word_of(actions: Iterable[int]) -> str:
    """Actions as a word."""
    return "".join(LETTERS[action] for action in actions)


def actions_of(word: str) -> list[int]:
    """The actions of an episode that was kept as a word."""
    return [LETTERS.index(letter) for letter in word]
