"""The expert: it plans an episode, acts, and plans again if the state is not the predicted one."""

from __future__ import annotations

from typing import Final

import numpy as np

from magical_mj.actions import NOOP
from magical_mj.environment import Environment
from magical_mj.experts.lookahead import Lookahead, state_of
from magical_mj.experts.planner import Plan, Planner
from magical_mj.registry import task_spec
from magical_mj.variants import check_seed

BUDGET: Final = 150  # simulated steps per step of the episode; once they are used, no new plan is started


class Expert:
    """A policy that drives one environment; each call gives the action for the environment's present state.

    It plans when an episode starts, and again whenever the state is not the one that its plan predicted.

    Args:
        env: an environment of the task, already reset.
        task: a task's name, or "package.module:SPEC".
        seed: the seed of the expert's random choices.

    Raises:
        UnknownNameError: if there is no such task.
        TaskError: if it has no plan.
        InvalidSceneError: if the environment's scene is not one of the task.
        InvalidSeedError: if the seed is not an integer, or negative.
    """

    def __init__(self, env: Environment, task: str, seed: int = 0) -> None:
        self._spec = task_spec(task)
        self._spec.check_plan()
        self._spec.check(env.initial_scene)
        self._env, self._seed = env, check_seed(seed)
        self._plan = Plan(0.0, 0, [], [])
        self._step = 0

    @property
    def expected_score(self) -> float:
        """The score that the present plan reaches; 0 before there is a plan."""
        return self._plan.score

    def __call__(self) -> int:
        """The action for the present state."""
        left = (self._env.horizon or self._spec.horizon()) - self._env.task.steps
        if left <= 0:
            return NOOP
        state = state_of(self._env)
        if self._step >= len(self._plan.actions) or not np.array_equal(state, self._plan.states[self._step]):
            self._replan(left)
        self._step += 1
        return self._plan.actions[self._step - 1]

    def _replan(self, left: int) -> None:
        planner = Planner(self._spec, self._env.initial_scene, Lookahead(self._env))
        rng = np.random.default_rng(self._seed)
        self._plan = planner.plan(left, BUDGET * self._spec.horizon(), rng)
        self._step = 0
