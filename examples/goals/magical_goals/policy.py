"""The policy: it plans in a copy of the simulation to reach the goal, and knows nothing else about the task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final

from magical_goals.inference import InferredGoal
from magical_mj.learners.settings import STATE
from magical_mj.policies.expert.driving import Lookahead
from magical_mj.policies.expert.planner import PlanFollower, Planner
from magical_mj.policies.interface import Episode
from magical_mj.utils.errors import SettingsError

TRIES: Final = 4  # manoeuvres tried in one situation
PATIENCE: Final = 2  # failures after which a block is not moved any more
BUDGET: Final = 16  # simulated steps per step of the episode; once they are used, no new plan is started


class GoalPolicy:
    """Plans to reach the goal of the task's demonstrations.

    It gets the simulation. It uses the initial and the present state, the number of remaining steps, and a copy of the
    simulation to plan in, but neither the task's score nor its plan (which the experts use).

    Attributes:
        goals: by task.
        tasks: the tasks that it can act in.
        preset: the name of the state track.
    """

    uses_simulation = True
    preset = STATE

    def __init__(self, goals: Mapping[str, InferredGoal], tasks: Sequence[str] = ()) -> None:
        self.goals, self.tasks = dict(goals), tuple(tasks or goals)

    def reset(self, episode: Episode) -> None:
        """An episode begins."""
        env, goal = episode.env, self.goals.get(episode.task)
        if goal is None:
            raise SettingsError(f"this policy was trained on {', '.join(self.tasks)}, and cannot act in {episode.task}")
        if env is None or env.horizon is None:
            raise SettingsError(
                "a policy that plans needs the simulation itself; it cannot play in vector environments"
            )
        initial = env.initial_scene

        def planner() -> Planner:
            return Planner(
                partial(goal.score, initial),
                partial(goal.subgoals, initial),
                Lookahead(env),
                tries=TRIES,
                patience=PATIENCE,
                steady=True,
            )

        self._next = PlanFollower(env, env.horizon, planner, episode.rng, BUDGET)

    def __call__(self, _: Any) -> int:
        """An action; there are no observations."""
        return self._next()
