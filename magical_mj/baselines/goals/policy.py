"""The policy: it plans in a copy of the simulation towards the goal, and knows nothing else of the task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final

from magical_mj.baselines.goals.inference import Goal
from magical_mj.baselines.settings import STATE
from magical_mj.episodes import Episode
from magical_mj.errors import SettingsError
from magical_mj.experts.expert import PlanFollower
from magical_mj.experts.lookahead import Lookahead
from magical_mj.experts.planner import Planner

TRIES: Final = 4  # manoeuvres tried in one situation
PATIENCE: Final = 2  # failures to move a block, after which it is left where it is
BUDGET: Final = 16  # simulated steps for each step of an episode, after which no new plan is begun


class GoalPolicy:
    """Pursues the goal of each task's demonstrations.

    It is given the simulation, and uses of it: where everything is and was at the beginning, how many steps are left,
    and a copy to plan in. Neither the task's score nor its plan, which experts follow.

    Attributes:
        goals: by task.
        tasks: for which there are goals.
        preset: the state track's.
    """

    blind = True
    preset = STATE

    def __init__(self, goals: Mapping[str, Goal], tasks: Sequence[str] = ()) -> None:
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

    def __call__(self, observation: Any) -> int:
        """An action; there are no observations."""
        del observation
        return self._next()
