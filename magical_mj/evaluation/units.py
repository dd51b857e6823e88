"""Units, which are some episodes of one environment with one policy, and what the policy receives at their start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from magical_mj.evaluation.scores import EpisodeResult, Key
from magical_mj.policies.interface import Episode
from magical_mj.policies.loading import Source
from magical_mj.tasks.registry import task_spec
from magical_mj.tasks.spec import Rules

Watch = Callable[[int, int], object]
"""Called with the number of finished demonstrations, and their total number."""


@dataclass(frozen=True)
class Unit:
    """Episodes of one environment with one policy that are played together. A unit is repeatable and independent.

    `shift` is the label of the shift, `retry` the number of times that the episode has failed before.
    """

    policy: str
    run: int
    task: str
    variant: str
    seeds: tuple[int, ...]
    shift: str = ""
    retry: int = 0

    @property
    def keys(self) -> list[Key]:
        """The keys of its episodes."""
        return [(self.policy, self.run, self.task, self.variant, seed, self.shift) for seed in self.seeds]

    def steps(self, rules: Rules) -> int:
        """The number of actions of all its episodes."""
        return len(self.seeds) * task_spec(self.task).horizon(rules)


class Starts:
    """The starts of episodes: the task's name, the variant and the scene. Subclasses can give more.

    It is sent to other processes before it is used.
    """

    @property
    def recorded(self) -> dict[str, str]:
        """Facts that a resumed evaluation must keep."""
        return {}

    def of(self, unit: Unit, source: Source, task: str) -> list[tuple[Episode, dict[str, Any]]]:  # noqa: ARG002
        """For each episode, what the policy receives, and fields of its result. `task` is the name that it receives."""
        return [(Episode(task, unit.variant, seed, unit.run), {}) for seed in unit.seeds]

    def finished(self, result: EpisodeResult) -> EpisodeResult:
        """The result with what can be computed only after the episode."""
        return result
