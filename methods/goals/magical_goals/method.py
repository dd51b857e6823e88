"""Goal inference as a training with one update."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from magical_goals.inference import Goal, infer
from magical_goals.policy import GOALS, GoalPolicy, from_json, to_json
from magical_mj.intents.ambiguity import ends_of
from magical_mj.learners.data import chosen
from magical_mj.learners.learner import Method
from magical_mj.learners.settings import STATE, TrainingSettings
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError


class GoalInference(Method):
    """Infers the intent of each task from the first and last states of its demonstrations; see `infer`."""

    parts: ClassVar[tuple[str, ...]] = ()

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
        _check_states(settings)
        self.updates = 1
        self._written = to_json({})
        self._policy = GoalPolicy({}, settings.tasks)

    @classmethod
    def check(cls, settings: TrainingSettings) -> None:
        """Also checks that observations are states."""
        super().check(settings)
        _check_states(settings)

    def update(self) -> Mapping[str, float]:
        """Infers all intents. Returns the minima of the saved bits, and of the lead over the second-best goal."""
        goals_of: dict[str, list[Goal]] = {}
        for task in self.settings.tasks:
            goals_of[task] = infer([ends_of(demonstration) for demonstration in chosen(self.settings, task)])
        self._pursue(to_json(goals_of))
        saved = [[*(goal.saved for goal in goals), 0.0] for goals in goals_of.values()]
        return {"saved_bits": min(bits[0] for bits in saved), "ahead_bits": min(bits[0] - bits[1] for bits in saved)}

    def policy(self) -> GoalPolicy:
        """The policy that plans to reach the intent of each task."""
        return self._policy

    def save_policy(self, folder: Path) -> None:
        """Writes goals.json, and replaces an existing one."""
        files.write(folder / GOALS, self._written, overwrite=True)

    def get_state(self) -> dict[str, Any]:
        """The text of goals.json."""
        return {"goals": self._written}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restores inferred goals."""
        self._pursue(state["goals"])

    def _pursue(self, written: str) -> None:
        self._written = written
        self._policy.goals.update(from_json(written))


def _check_states(settings: TrainingSettings) -> None:
    if not settings.states:
        raise SettingsError(f"goals are inferred from states, not from images: give --preset {STATE}")
