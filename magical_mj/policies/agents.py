"""The built-in agents, which need no training."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

from magical_mj.policies.interface import Episode, Policy
from magical_mj.scene.actions import ACTIONS, NOOP
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import SettingsError


class NoopAgent:
    """Does nothing."""

    uses_simulation = True

    def reset(self, episode: Episode) -> None:
        """Nothing to do here either."""

    def __call__(self, _: Any) -> int:
        """An action; the observation does not matter."""
        return NOOP


class RandomAgent:
    """Draws each action independently and uniformly."""

    uses_simulation = True

    def reset(self, episode: Episode) -> None:
        """Starts the episode's own sequence."""
        self._rng = episode.rng()

    def __call__(self, _: Any) -> int:
        """An action; the observation does not matter."""
        return int(self._rng.integers(len(ACTIONS)))


class ExpertAgent:
    """The scripted expert, which uses the state of the simulation; its seed is the number of the run."""

    uses_simulation = True
    needs_plan = True

    def reset(self, episode: Episode) -> None:
        """Makes an expert for this episode."""
        from magical_mj.policies.expert import expert_of

        if episode.env is None:
            raise SettingsError("the expert needs the simulation itself; it cannot play in vector environments")
        own = episode.env.task
        task = own if own is not None and task_spec(own).plan is not None else episode.task
        self._next = expert_of(episode.env, task, episode.run)

    def __call__(self, _: Any) -> int:
        """An action; the observation does not matter."""
        return self._next()


AGENTS: Final[Mapping[str, type[Policy]]] = MappingProxyType(
    {"expert": ExpertAgent, "random": RandomAgent, "noop": NoopAgent}
)
"""The agents by name."""
