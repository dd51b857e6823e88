"""The planner turns subgoals into actions: it tries candidate manoeuvres in the lookahead and keeps the best.

Policies follow its plans. They plan an episode, act, and plan again if the state is not the predicted one.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from magical_mj.actions import NOOP, Gripper
from magical_mj.engine import Engine
from magical_mj.experts.driving import DELAY_PROBABILITY, HumanExecution, Lookahead, SavedState
from magical_mj.experts.manoeuvres import Manoeuvre, manoeuvres, obstacles, perform
from magical_mj.experts.navigation import EMPTY, cell_costs, explore, footprint
from magical_mj.scene import Scene
from magical_mj.tasks.planning import Noise, Subgoals, scene_after
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import PlacementError, SettingsError, short_repr
from magical_mj.variants import check_seed

BUDGET: Final = 300  # simulated steps per step of the episode; then no new plan is started
CANDIDATES: Final = 8  # manoeuvres tried in one situation
SPREAD: Final = 4.0  # actions: the largest change by noise of a manoeuvre's estimated cost
COST_NOISE: Final = 5.0  # actions: the largest change by noise of a manoeuvre's cost after a trial
NOISE_GROWTH, DELAY_DECAY = 1.5, 0.7  # factors of noise and of delays after each failed plan
ROUND: Final = 3  # the noise restarts from 1 after this number of plans, because too much noise only gives bad plans
LOSS: Final = 300.0  # the cost, in actions, of losing a score of 1
FAILURE: Final = 60.0  # the cost, in actions, of a subgoal that was attempted and not reached
REACH: Final = 90  # actions: the longest path
ATTEMPTS: Final = 40  # the number of plans for an episode
EXTRA_PLANS: Final = 2  # additional plans to find one that finishes early
PAUSE: Final = 4  # actions of waiting if no subgoal is left
# actions of waiting with closed fingers. They are not no-ops, so that learners that drop no-ops keep them.
SETTLING: Final = 8


class Plan(NamedTuple):
    """A sequence of commands from one state, and the states that follow."""

    score: float
    rest: int
    """The number of remaining actions after all subgoals are reached."""
    actions: list[int]
    states: list[SavedState]
    """The states before each command and after the last one."""


class Planner:
    """Plans the rest of an episode.

    Args:
        score: the function that scores a final scene, in [0, 1].
        subgoals: the function that returns a scene's remaining subgoals. Its last argument contains the blocks that
            should not be moved.
        lookahead: the copy of the simulation for trying manoeuvres.
        tries: the number of manoeuvres that are tried in one situation.
        patience: after this number of failures, a block is not moved again in this plan.
        steady: execute plans without the pauses and delays of a person.
    """

    def __init__(
        self,
        score: Callable[[Scene], float],
        subgoals: Callable[[Scene, Noise, Collection[int]], Subgoals],
        lookahead: Lookahead,
        *,
        tries: int = CANDIDATES,
        patience: float = math.inf,
        steady: bool = False,
    ) -> None:
        self._score, self._subgoals, self._lookahead = score, subgoals, lookahead
        self._tries, self._patience, self._steady = tries, patience, steady

    def plan(self, steps: int, budget: int, rng: np.random.Generator) -> Plan:
        """The best of several plans for the next `steps` actions: the first with the full score, if there is one.

        Among plans with the full score, one that finishes early is preferred to one that still moves at the end.

        Args:
            steps: the number of remaining actions.
            budget: after this number of simulated steps, no new plan is started.
            rng: varies the plans. After each failure, execution becomes more precise, and noise grows for `ROUND`
                plans.
        """
        end = self._lookahead.count + budget
        best = self._attempt(steps, Noise(rng, 1.0), self._execution(rng, DELAY_PROBABILITY))
        for failed in range(1, ATTEMPTS):
            good = best.score == 1.0 and (best.rest or failed > EXTRA_PLANS)
            if good or self._lookahead.count > end:
                break
            plan = self._attempt(
                steps,
                Noise(rng, NOISE_GROWTH ** (failed % ROUND)),
                self._execution(rng, DELAY_PROBABILITY * DELAY_DECAY**failed),
            )
            best = max(best, plan, key=lambda plan: (plan.score, plan.rest))
        return best

    def _execution(self, rng: np.random.Generator, delay_probability: float) -> HumanExecution:
        return HumanExecution(rng, 0.0, 1) if self._steady else HumanExecution(rng, delay_probability)

    def _attempt(self, steps: int, noise: Noise, execution: HumanExecution) -> Plan:
        lookahead, todo = self._lookahead, ()
        states = list(lookahead.pending)
        lookahead.restore(states[-1])  # with a delay, the first states follow from commands that are given already
        failures: Counter[int | None] = Counter()
        stuck: set[int] = set()
        waited, settling = 0, SETTLING + execution.pause()
        while (left := steps + 1 - len(states)) > 0:
            scene, here = lookahead.scene(), lookahead.state
            todo = tuple(subgoal for subgoal in todo if subgoal.left(scene))
            # a manoeuvre can push other blocks away, and then the rest of the plan does not lead to the full score
            if not todo or self._score(scene_after(scene, todo)) < 1.0:
                try:
                    todo = self._subgoals(scene, noise, stuck)
                except PlacementError:  # the blocks leave no free space: this attempt fails
                    todo = ()
            option = self._best(here, scene, todo, left, noise)
            lookahead.restore(here)
            if option is None:
                for _ in range(min(PAUSE, left)):
                    lookahead.act(Gripper.CLOSE if waited < settling else Gripper.OPEN)
                    waited += 1
            else:
                waited = 0
                for _ in range(min(execution.pause(), left)):
                    lookahead.act(Gripper.OPEN)
                lookahead.execution = execution
                perform(lookahead, option, left)
                lookahead.execution = None
                block = option.subgoal.block
                failures[block] += option.subgoal.left(lookahead.scene()) > 0
                if block is not None and block not in stuck and failures[block] >= self._patience:
                    stuck.add(block)
                    todo = ()
            states += lookahead.states
        return Plan(self._score(lookahead.scene()), waited, lookahead.commands, states)

    def _best(self, here: SavedState, scene: Scene, todo: Subgoals, left: int, noise: Noise) -> Manoeuvre | None:
        """The best of the most promising manoeuvres, tried from a state. None if no subgoal is left."""
        if not todo:
            return None
        lookahead = self._lookahead
        options: list[Manoeuvre] = []
        # a stick is wide, so paths with room for its whole outline are options as well
        for discs in (EMPTY,) if lookahead.body.fingers else (EMPTY, footprint(lookahead.body)):
            costs = cell_costs(obstacles(scene), discs)
            tree = explore(scene.robot.pose, costs, min(left, REACH))
            for subgoal in todo:
                options += manoeuvres(tree, costs, scene, subgoal, noise, lookahead.body)
        options.sort(key=lambda option: option.estimate - option.subgoal.cost(scene) + noise(SPREAD))
        best, best_cost = None, math.inf
        for option in options[: self._tries]:
            handicap = noise(COST_NOISE)
            lookahead.restore(here)
            # stops where it costs as much as the best manoeuvre so far
            perform(lookahead, option, int(min(left, best_cost - handicap)))
            failed = option.subgoal.left(lookahead.scene()) > 0
            cost = handicap + len(lookahead.trace) + self._rest(todo) + FAILURE * failed
            if cost < best_cost and lookahead.trace:
                best, best_cost = option, cost
        return best

    def _rest(self, todo: Subgoals) -> float:
        """The approximate number of actions for the subgoals from the current state."""
        scene = self._lookahead.scene()
        return sum(subgoal.cost(scene) for subgoal in todo) + LOSS * (1 - self._score(scene_after(scene, todo)))


class PlanFollower:
    """A policy that drives one engine, which may be reset. Each call returns the action for its current state.

    When an episode starts, it creates a planner and a random generator, and plans. It plans again whenever the state is
    not the predicted one. The budget is the number of simulated steps per step of the episode. When it is used up, no
    new plan is started.
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
        """The action for the current state."""
        left = self._horizon - self._env.steps
        if left <= 0:
            return NOOP
        state = self._env.save()
        known = self._step < len(self._plan.actions)
        if not known or not np.array_equal(state, self._plan.states[self._step].simulation):
            self._plan = self._planner().plan(left, self._budget * self._horizon, self._rng())
            self._step = 0
        self._step += 1
        return self._plan.actions[self._step - 1]


class Expert(PlanFollower):
    """The expert. It plans with the task's own score and subgoals.

    `seed` determines its random choices.

    Raises:
        UnknownNameError, TaskError: if the task does not exist, or has no plan.
        InvalidSceneError: if the engine's scene is not one of the task.
        InvalidSeedError: if the seed is not an integer, or negative.
        SettingsError: if `env` is not an engine, or the expert cannot solve the task with its body.
    """

    def __init__(self, env: Engine, task: str, seed: int = 0) -> None:
        if not isinstance(env, Engine):
            raise SettingsError(
                f"an expert drives a magical_mj.Engine, not {short_repr(env)}; "
                "in Gymnasium environments, use env.unwrapped.engine"
            )
        spec = task_spec(task)
        spec.check_plan()
        spec.check_expert_body(env.initial_scene.robot.body)
        spec.check(env.initial_scene)
        if spec.trajectory and not env.setup.spec.trajectory:
            raise SettingsError(f"the score of {task} depends on the scenes of all steps: use an engine of this task")
        seed = check_seed(seed)

        def planner() -> Planner:
            ahead, rules = Lookahead(env), env.setup.rules
            return Planner(
                lambda scene: spec.checked_score(ahead.scenes_to(scene), rules),
                lambda scene, noise, _: spec.subgoals(ahead.scenes_to(scene), noise, rules),
                ahead,
            )

        super().__init__(env, env.horizon or spec.horizon(), planner, partial(np.random.default_rng, seed), BUDGET)
