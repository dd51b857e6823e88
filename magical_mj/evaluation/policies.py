"""Policies: what an agent must offer to be evaluated, and the three that need no training."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from magical_mj.actions import ACTIONS, NOOP
from magical_mj.errors import SettingsError

if TYPE_CHECKING:
    from magical_mj.environment import Environment


@dataclass(frozen=True)
class Episode:
    """What a policy is told about the episode that begins.

    Attributes:
        task: the task's name.
        variant: the variant's name.
        seed: the episode starts in `sample_scene(task, variant, seed)`.
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
    faster, and `reset` gets the simulation instead. Attributes `preset` and `tasks` say which observations it was
    trained on and in which tasks it can act; others are then refused before anything is played.
    """

    def reset(self, episode: Episode) -> None:
        """Called before each episode. Nothing may be carried over from one to the next."""

    def __call__(self, observation: Any) -> Any:
        """The action, an integer in 0..17, for an observation of the preset."""


@runtime_checkable
class BatchPolicy(Protocol):
    """An agent that acts in several episodes at once; used with vector environments."""

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Called before the episodes, which begin together."""

    def act_batch(self, observations: Any) -> Sequence[Any]:
        """An action for each environment, for the stacked observations that vector environments give."""
        ...


class Noop:
    """Does nothing."""

    blind = True

    def reset(self, episode: Episode) -> None:
        """Nothing to do here either."""

    def __call__(self, observation: Any) -> int:
        """An action; the observation does not matter."""
        del observation
        return NOOP


class Random:
    """Draws each action independently and uniformly."""

    blind = True

    def reset(self, episode: Episode) -> None:
        """Starts the episode's own sequence."""
        self._rng = episode.rng()

    def __call__(self, observation: Any) -> int:
        """An action; the observation does not matter."""
        del observation
        return int(self._rng.integers(len(ACTIONS)))


class Expert:
    """The scripted demonstrator, which looks at the state of the simulation."""

    blind = True

    def reset(self, episode: Episode) -> None:
        """Makes an expert for this episode."""
        from magical_mj.experts import make_expert

        if episode.env is None:
            raise SettingsError("the expert needs the simulation itself; it cannot play in vector environments")
        self._next = make_expert(episode.env, episode.task, episode.run)

    def __call__(self, observation: Any) -> int:
        """An action; the observation does not matter."""
        del observation
        return self._next()


BUILT_IN: dict[str, Callable[[], Policy]] = {"expert": Expert, "random": Random, "noop": Noop}
"""By the names that the command line knows them by."""


def begin(policy: Callable[[Any], Any], episode: Episode) -> None:
    """Tells the policy, if it wants to know, that an episode begins."""
    reset = getattr(policy, "reset", None)
    if reset is not None:
        reset(episode)


def is_blind(policy: object) -> bool:
    """Whether the policy looks at no observations."""
    return bool(getattr(policy, "blind", False))


def check_fit(policy: object, pairs: Sequence[tuple[str, str]], preset: str) -> None:
    """Raises a `SettingsError` if the policy was made for other tasks than those of the pairs, or another preset."""
    made_for = getattr(policy, "preset", preset)
    if made_for != preset:
        raise SettingsError(f"the policy was trained on the preset {made_for}, not {preset}: give --preset {made_for}")
    tasks = getattr(policy, "tasks", None)
    others = sorted({task for task, _ in pairs} - set(tasks)) if tasks is not None else []
    if others:
        raise SettingsError(f"the policy cannot act in {', '.join(others)}: give --tasks {','.join(tasks or ())}")
