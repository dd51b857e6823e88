"""The policy, which plans in a copy of the simulation to reach the goal, and its file, goals.json in a run's folder."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from magical_goals.arrangements import Grouped, InLine, Together
from magical_goals.inference import InferredGoal
from magical_goals.regions import Belonging, Near, RobotInside
from magical_goals.relation import Relation
from magical_mj.learners.settings import STATE
from magical_mj.policies.expert.driving import Lookahead
from magical_mj.policies.expert.planner import PlanFollower, Planner
from magical_mj.policies.interface import Episode
from magical_mj.utils.errors import MagicalError, SettingsError, TrainingError

CANDIDATES: Final = 4  # manoeuvres tried in one situation
PATIENCE: Final = 2  # after this number of failures, a block is left alone
BUDGET: Final = 16  # simulated steps per step of the episode; after them, no new plan is started

GOALS: Final = "goals.json"
"""The policy's file in a run's folder."""
SHOWN: Final = 5
"""The number of alternatives that are listed for each task, for comparison only."""
RELATIONS: Final[Mapping[str, type[Relation]]] = MappingProxyType(
    {kind.__name__: kind for kind in (Belonging, RobotInside, Near, InLine, Grouped, Together)}
)
"""The relations by their names in the file."""


class GoalPolicy:
    """Plans to reach the goal of the task's demonstrations.

    It has access to the simulation. It uses the initial and the current state, the number of remaining steps, and a
    copy of the simulation for planning. It uses neither the task's score nor its plan (which the experts use).

    Attributes:
        goals: task -> goal.
        tasks: the tasks that it can play.
        preset: the name of the preset of states.
    """

    uses_simulation = True
    preset = STATE

    def __init__(self, goals: Mapping[str, InferredGoal], tasks: Sequence[str] = ()) -> None:
        self.goals, self.tasks = dict(goals), tuple(tasks or goals)

    def reset(self, episode: Episode) -> None:
        """Begins an episode."""
        env, goal = episode.env, self.goals.get(episode.task)
        if goal is None:
            raise SettingsError(f"this policy was trained on {', '.join(self.tasks)} and cannot play {episode.task}")
        if env is None or env.horizon is None:
            raise SettingsError("a planning policy needs the simulation itself and cannot play in vector environments")
        initial = env.initial_scene

        def planner() -> Planner:
            return Planner(
                partial(goal.score, initial),
                partial(goal.subgoals, initial),
                Lookahead(env),
                tries=CANDIDATES,
                patience=PATIENCE,
                steady=True,
            )

        self._next = PlanFollower(env, env.horizon, planner, episode.rng, BUDGET)

    def __call__(self, _: Any) -> int:
        """The next action. The policy has no observations."""
        return self._next()


def to_json(goals_of: Mapping[str, Sequence[InferredGoal]]) -> str:
    """The goals of each task, the best first. `from_json` reads only the best one."""
    table = {
        task: {
            "goal": str(goals[0]),
            "relation": {"kind": type(goals[0].relation).__name__, **asdict(goals[0].relation)},
            "limits": goals[0].limits,
            "saved_bits": goals[0].saved,
            "instead": {str(goal): round(goal.saved, 1) for goal in goals[1 : 1 + SHOWN]},
        }
        for task, goals in goals_of.items()
    }
    return json.dumps(table, indent=2) + "\n"


def from_json(text: str) -> dict[str, InferredGoal]:
    """The goal of each task.

    Raises:
        TrainingError: if the text is not valid.
    """
    try:
        return {task: _goal(entry) for task, entry in json.loads(text).items()}
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError, MagicalError) as error:
        raise TrainingError(f"the goals are invalid: {type(error).__name__}: {error}") from error


def load_goals(folder: Path | str) -> GoalPolicy:
    """The policy in a run's folder.

    Raises:
        TrainingError: if the file is missing or damaged.
    """
    path = Path(folder) / GOALS
    try:
        return GoalPolicy(from_json(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, TrainingError) as error:
        raise TrainingError(f"cannot read {path}: {error}") from error


def _goal(entry: Mapping[str, Any]) -> InferredGoal:
    fields = dict(entry["relation"])
    relation = RELATIONS[fields.pop("kind")](**{name: _frozen(value) for name, value in fields.items()})
    limits = tuple(float(limit) for limit in entry["limits"])
    if len(limits) != relation.measures or not all(math.isfinite(limit) for limit in limits):
        raise ValueError(f"the relation {relation} needs {relation.measures} finite limits, not {limits}")
    return InferredGoal(relation, limits, float(entry["saved_bits"]))


def _frozen(value: Any) -> Any:
    """Converts lists back to tuples."""
    return tuple(_frozen(item) for item in value) if isinstance(value, list) else value
