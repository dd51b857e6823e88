"""Policies that follow plans: they plan an episode, act, and plan again if the state is not the predicted one."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np

from magical_mj.engine import Engine
from magical_mj.policies.expert.lookahead import Lookahead, state_of
from magical_mj.policies.expert.planner import Plan, Planner
from magical_mj.scene.actions import NOOP
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import SettingsError, short_repr
from magical_mj.variants import check_seed

BUDGET: Final = 300  # simulated steps per step of the episode; once they are used, no new plan is started


class PlanFollower:
    """A policy that drives one engine; each call gives the action for the engine's present state.

    It plans when an episode starts, and again whenever the state is not the one that its plan predicted.

    Args:
        env: an engine. It may be reset again.
        horizon: the number of steps of an episode.
        planner: makes the planner of the present episode.
        rng: makes the random generator of a plan.
        budget: simulated steps per step of the episode; once they are used, no new plan is started.
    """

    def __init__(
        self,
        env: Engine,
        horizon: int,
        planner: Callable[[], Planner],
        rng: Callable[[], np.random.Generator],
        budget: int,
    ) -> None:
        self._env, self._horizon, self._planner, self._rng, self._budget = env, horizon, planner, rng, budget
        self._plan = Plan(0.0, 0, [], [])
        self._step = 0

    def __call__(self) -> int:
        """The action for the present state."""
        left = self._horizon - self._env.steps
        if left <= 0:
            return NOOP
        state = state_of(self._env)
        if self._step >= len(self._plan.actions) or not np.array_equal(state, self._plan.states[self._step]):
            self._plan = self._planner().plan(left, self._budget * self._horizon, self._rng())
            self._step = 0
        self._step += 1
        return self._plan.actions[self._step - 1]


class Expert(PlanFollower):
    """The expert: it plans with the task's own score and subgoals.

    Args:
        env: an engine of the task.
        task: a task's name, or "package.module:SPEC".
        seed: the seed of the expert's random choices.

    Raises:
        UnknownNameError: if there is no such task.
        TaskError: if it has no plan.
        InvalidSceneError: if the engine's scene is not one of the task.
        InvalidSeedError: if the seed is not an integer, or negative.
        SettingsError: if it is no engine.
    """

    def __init__(self, env: Engine, task: str, seed: int = 0) -> None:
        if not isinstance(env, Engine):
            raise SettingsError(
                f"an expert drives a magical_mj.Engine, not {short_repr(env)}; "
                "in Gymnasium's environments that is env.unwrapped.engine"
            )
        spec = task_spec(task)
        spec.check_plan()
        spec.check(env.initial_scene)
        seed = check_seed(seed)

        def planner() -> Planner:
            initial, rules = env.initial_scene, env.setup.rules
            return Planner(
                lambda scene: spec.checked_score(initial, scene, rules),
                lambda scene, noise, _: spec.subgoals(initial, scene, noise, rules),
                Lookahead(env),
            )

        super().__init__(env, env.horizon or spec.horizon(), planner, partial(np.random.default_rng, seed), BUDGET)
