"""The policies, which plan in a copy of the simulation to reach an intent, and their file in a run's folder."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from magical_goals.inference import Goal, best_intent, infer
from magical_mj.engine import Engine
from magical_mj.experts.driving import Lookahead
from magical_mj.experts.planner import PlanFollower, Planner
from magical_mj.intents import Intent, parse
from magical_mj.intents.ambiguity import Ends, ends_of
from magical_mj.intents.plans import plan
from magical_mj.learners.settings import STATE
from magical_mj.policies.interface import NOOP, Episode
from magical_mj.scene import Scene
from magical_mj.utils.errors import MagicalError, SettingsError, TrainingError

CANDIDATES: Final = 4  # manoeuvres tried in one situation
BUDGET: Final = 16  # simulated steps per step of the episode; after them, no new plan is started

GOALS: Final = "goals.json"
"""The policy's file in a run's folder."""
SHOWN: Final = 60
"""The number of intents that are kept for each task: some may be undefined in a scene, and others are compared."""


class GoalPolicy:
    """Plans to reach the intent of the task's demonstrations.

    It has access to the simulation. It uses the initial and the current state, the number of remaining steps, and a
    copy of the simulation for planning. It uses neither the task's score nor its plan (which the experts use).

    Attributes:
        goals: task -> its intents, the most probable one first.
        tasks: the tasks that it can play.
        preset: the name of the preset of states.
    """

    uses_simulation = True
    preset = STATE

    def __init__(self, goals: Mapping[str, Sequence[Goal]], tasks: Sequence[str] = ()) -> None:
        self.goals, self.tasks = dict(goals), tuple(tasks or goals)

    def reset(self, episode: Episode) -> None:
        """Begins an episode."""
        goals = self.goals.get(episode.task)
        if goals is None:
            raise SettingsError(f"this policy was trained on {', '.join(self.tasks)} and cannot play {episode.task}")
        self._next = follower(goals, episode)

    def __call__(self, _: Any) -> int:
        """The next action. The policy ignores observations."""
        return self._next()


class InferredGoal:
    """Infers the intent from the demonstrations that it is given at test time, and plans to reach it.

    It has the same access to the simulation as `GoalPolicy`, and uses the first and the last scene of each
    demonstration.
    """

    uses_simulation = True
    uses_demonstrations = True

    def __init__(self) -> None:
        self._inferred: dict[tuple[Ends, ...], list[Goal]] = {}

    def reset(self, episode: Episode) -> None:
        """Begins an episode."""
        demonstrations: tuple[Any, ...] = episode.demonstrations
        ends = tuple(map(ends_of, demonstrations))
        if ends not in self._inferred:
            self._inferred[ends] = infer(ends)[:SHOWN]
        self._next = follower(self._inferred[ends], episode)

    def __call__(self, _: Any) -> int:
        """The next action. The policy ignores observations."""
        return self._next()


def follower(goals: Sequence[Goal], episode: Episode) -> Callable[[], int]:
    """A function that returns the next action towards the `best_intent`, or no-ops if there is none."""
    env = episode.env
    if env is None or env.horizon is None:
        raise SettingsError("a planning policy needs the simulation itself and cannot play in vector environments")
    initial = env.initial_scene
    intent = best_intent(goals, initial)
    if intent is None:
        return lambda: NOOP
    return PlanFollower(env, env.horizon, partial(_planner, intent, initial, env), episode.rng, BUDGET)


def _planner(intent: Intent, initial: Scene, env: Engine) -> Planner:
    return Planner(
        partial(intent.score, initial),
        lambda scene, noise, _: tuple(plan(intent, initial, scene, noise)),
        Lookahead(env),
        tries=CANDIDATES,
        steady=True,
    )


def to_json(goals_of: Mapping[str, Sequence[Goal]]) -> str:
    """The intents of each task with the bits that they save, the best first."""
    table = {
        task: {"goal": goals[0].intent.sentence, "intents": {str(goal.intent): goal.saved for goal in goals[:SHOWN]}}
        for task, goals in goals_of.items()
    }
    return json.dumps(table, indent=2) + "\n"


def from_json(text: str) -> dict[str, list[Goal]]:
    """The intents of each task.

    Raises:
        TrainingError: if the text is not valid.
    """
    try:
        return {task: _goals(entry["intents"]) for task, entry in json.loads(text).items()}
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


def _goals(saved: Mapping[str, float]) -> list[Goal]:
    goals = [Goal(parse(text), float(bits)) for text, bits in saved.items()]
    if not goals or not all(math.isfinite(goal.saved) for goal in goals):
        raise ValueError("each task needs intents, with finite numbers of bits")
    return goals
