"""From subgoals to actions: candidate manoeuvres are tried by lookahead, and the best is kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from magical_mj.actions import ACTIONS, Gripper
from magical_mj.experts.lookahead import Lookahead, Snapshot, State
from magical_mj.experts.manoeuvres import manoeuvres, obstacles, perform
from magical_mj.experts.navigation import explore, toll
from magical_mj.planning import Noise, done
from magical_mj.planning.subgoals import Subgoals
from magical_mj.scene import Scene
from magical_mj.tasks import TaskSpec

TRIES: Final = 8  # manoeuvres tried in one situation
SPREAD: Final = 16.0  # actions by which noise makes a manoeuvre more or less promising
TASTE: Final = 30.0  # and better or worse, once tried
SMOOTH: Final = 0.8  # share of the cells of the ground that noise leaves as easy as they are
CALMING: Final = 0.6  # of the strength of the noise remains after each plan that failed
LOSS: Final = 300.0  # actions that a score of 1 is worth
FAILURE: Final = 60.0  # actions that a subgoal begun and not reached costs
REACH: Final = 90  # actions, the longest way to anything
ATTEMPTS: Final = 20  # plans for an episode
PAUSE: Final = 4  # actions of waiting when there is nothing to do


class Plan(NamedTuple):
    """Actions from one state on, and where they lead."""

    score: float
    actions: list[int]
    states: list[State]
    """Before each action, and after the last."""


class Planner:
    """Plans the rest of an episode.

    Args:
        spec: the task.
        initial: the scene at the start of the episode.
        world: the copy of the simulation in which manoeuvres are tried.
    """

    def __init__(self, spec: TaskSpec, initial: Scene, world: Lookahead) -> None:
        self._spec, self._initial, self._world = spec, initial, world

    def _score(self, scene: Scene) -> float:
        return self._spec.score(self._initial, scene, "paper")

    def plan(self, steps: int, budget: int, rng: np.random.Generator) -> Plan:
        """The best of several plans for the next `steps` actions: the first that gives the full score, if any does.

        Args:
            steps: how many actions are left.
            budget: no new plan is begun after so many simulated steps.
            rng: varies the plans; the less, the more have failed.
        """
        start, end = self._world.save(), self._world.count + budget
        best = self._attempt(start, steps, Noise(rng, 1.0))
        for failed in range(1, ATTEMPTS):
            if best.score == 1.0 or self._world.count > end:
                break
            best = max(best, self._attempt(start, steps, Noise(rng, CALMING**failed)), key=lambda plan: plan.score)
        return best

    def _attempt(self, start: Snapshot, steps: int, noise: Noise) -> Plan:
        world, todo = self._world, ()
        world.restore(start)
        actions: list[int] = []
        states = [world.state]
        while len(actions) < steps:
            scene, left = world.scene(), steps - len(actions)
            todo = tuple(subgoal for subgoal in todo if subgoal.left(scene))
            if not todo or self._score(done(scene, todo)) < 1.0:
                todo = self._spec.subgoals(self._initial, scene, noise)
            here = world.save()
            if not todo or not self._do_best(here, scene, todo, left, noise):
                world.restore(here)
                for _ in range(min(PAUSE, left)):
                    world.act(gripper_of(actions))
            actions += world.trace
            states += world.states
        return Plan(self._score(world.scene()), actions, states)

    def _do_best(self, here: Snapshot, scene: Scene, todo: Subgoals, left: int, noise: Noise) -> bool:
        """Tries the most promising manoeuvres and leaves the world after the best; whether there is one."""
        world = self._world
        tolls = toll(obstacles(scene), loaded=False)
        tolls[(tolls >= 0) & (noise(1.0, tolls.shape) > SMOOTH)] += 1
        ways = explore(scene.robot.pose, tolls, min(left, REACH))
        options = [option for subgoal in todo for option in manoeuvres(ways, scene, subgoal, noise)]
        options.sort(key=lambda option: option.estimate - option.subgoal.cost(scene) + noise(SPREAD))
        best, best_cost = None, math.inf
        for option in options[:TRIES]:
            handicap = noise(TASTE)
            world.restore(here)
            perform(world, option, int(min(left, best_cost - handicap)))
            failed = option.subgoal.left(world.scene()) > 0
            cost = handicap + len(world.trace) + self._rest(todo) + FAILURE * failed
            if cost < best_cost and world.trace:
                best, best_cost = world.save(), cost
        if best is not None:
            world.remember(best)
        return best is not None

    def _rest(self, todo: Subgoals) -> float:
        """About how many actions are left after the present state."""
        scene = self._world.scene()
        return sum(subgoal.cost(scene) for subgoal in todo) + LOSS * (1 - self._score(done(scene, todo)))


def gripper_of(actions: Sequence[int]) -> Gripper:
    """How the fingers are after these actions.

    Whoever waits keeps them so: opened fingers might push something away. And learners who leave out the no-ops would
    never see a robot wait that has closed them.
    """
    return ACTIONS[actions[-1]].gripper if actions else Gripper.OPEN
