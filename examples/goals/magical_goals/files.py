"""Goals as readable JSON: goals.json in a run's folder."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from magical_goals.arrangements import Grouped, InLine, Together
from magical_goals.inference import InferredGoal
from magical_goals.places import Near
from magical_goals.policy import GoalPolicy
from magical_goals.regions import Belonging, RobotInside
from magical_goals.relation import Relation
from magical_mj.utils import files
from magical_mj.utils.errors import MagicalError, TrainingError

GOALS: Final = "goals.json"
"""In a run's folder."""
SHOWN: Final = 5
"""The number of alternatives that are listed for each task, for comparison only."""
RELATIONS: Final[Mapping[str, type[Relation]]] = MappingProxyType(
    {kind.__name__: kind for kind in (Belonging, RobotInside, Near, InLine, Grouped, Together)}
)
"""By name in the file."""


def to_json(goals_of: Mapping[str, Sequence[InferredGoal]]) -> str:
    """The goals of each task, the best first. Only the best one is read again."""
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
        raise TrainingError(f"these are no goals as a training writes them: {type(error).__name__}: {error}") from error


def load_goals(folder: Path | str) -> GoalPolicy:
    """The policy in a run's folder.

    Raises:
        TrainingError: if there is none, or the file is damaged.
    """
    path = Path(folder) / GOALS
    try:
        return GoalPolicy(from_json(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, TrainingError) as error:
        raise TrainingError(f"cannot read {path}: {error}") from error


def save_goals(folder: Path, written: str) -> None:
    """Writes the file with what `to_json` made, in place of the one that may be there."""
    files.write(folder / GOALS, written, overwrite=True)


def _goal(entry: Mapping[str, Any]) -> InferredGoal:
    fields = dict(entry["relation"])
    relation = RELATIONS[fields.pop("kind")](**{name: _frozen(value) for name, value in fields.items()})
    limits = tuple(float(limit) for limit in entry["limits"])
    if len(limits) != relation.measures or not all(math.isfinite(limit) for limit in limits):
        raise ValueError(f"the relation {relation} needs {relation.measures} finite limits, not {limits}")
    return InferredGoal(relation, limits, float(entry["saved_bits"]))


def _frozen(value: Any) -> Any:
    """Lists as the tuples that they were."""
    return tuple(_frozen(item) for item in value) if isinstance(value, list) else value
