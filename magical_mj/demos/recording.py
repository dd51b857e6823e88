"""Recording: the steps of an engine become a demonstration."""

from __future__ import annotations

from contextlib import closing
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.demos.demonstration import Demonstration, Demonstrator
from magical_mj.engine import Engine
from magical_mj.policies.expert import Expert
from magical_mj.policies.interface import forever, play
from magical_mj.scene.actions import NOOP, action_number
from magical_mj.tasks.registry import sample_scene, score, task_name, variant_name
from magical_mj.utils.errors import DemonstrationError
from magical_mj.variants import check_seed

Floats = NDArray[np.float64]

ATTEMPTS: Final = 10
REST: Final = 80
"""Steps without an action after which an expert's demonstration ends, if the episode does not end before."""
STRIDE: Final = 1_000_003
"""The increment of the expert's seed between attempts, so that no two demonstrations use the same one."""


class Recorder:
    """Steps an engine and records actions and states of one episode, at whose start it must be made.

    Raises:
        DemonstrationError: if the episode has begun already.
    """

    def __init__(self, env: Engine) -> None:
        if env.steps:
            raise DemonstrationError(f"the episode began {env.steps} steps ago: reset the environment before")
        self._env = env
        self._actions: list[int] = []
        self._states = [self._state()]

    def step(self, action: Any) -> bool:
        """One action, as the engine takes it. Returns whether the episode is over.

        Raises:
            DemonstrationError: if the episode is over, or went on without this recorder.
            InvalidActionError: if the action is not one of the 18.
        """
        if self._env.over:
            raise DemonstrationError("the episode is over: reset the environment, and record with another Recorder")
        self._check_complete()
        over = self._env.step(action)
        self._actions.append(action_number(action))
        self._states.append(self._state())
        return over

    def idle(self, steps: int) -> bool:
        """Whether the last `steps` actions were all no-ops."""
        return len(self._actions) >= steps and not any(action != NOOP for action in self._actions[-steps:])

    def states(self) -> tuple[Floats, Floats]:
        """The positions and the velocities so far. Shapes (steps + 1, nq) and (steps + 1, nv)."""
        positions, velocities = zip(*self._states, strict=True)
        return np.array(positions), np.array(velocities)

    def demonstration(
        self, task: str, variant: str, scene_seed: int, demonstrator: Demonstrator, seed: int
    ) -> Demonstration:
        """The episode so far as a demonstration, with the present score by the paper's rules.

        Raises:
            InvalidSeedError: if a seed is not an integer, or negative.
            DemonstrationError: if the episode began in another scene than that of `scene_seed`, or went on without this
                recorder.
        """
        self._check_complete()
        start = self._env.initial_scene
        if start != sample_scene(task, variant, check_seed(scene_seed)):
            where = f"{task_name(task)}-{variant_name(variant)} with seed {scene_seed}"
            raise DemonstrationError(f"the episode did not begin in the scene of {where}")
        positions, velocities = self.states()
        return Demonstration(
            task=task_name(task),
            variant=variant_name(variant),
            scene_seed=check_seed(scene_seed),
            demonstrator=demonstrator,
            seed=check_seed(seed),
            scene=start,
            actions=np.array(self._actions, np.uint8),
            qpos=positions,
            qvel=velocities,
            score=score(task, start, self._env.scene),
        )

    def _check_complete(self) -> None:
        if self._env.steps != len(self._actions):
            raise DemonstrationError("the environment was reset or stepped without the recorder: make another one")

    def _state(self) -> tuple[Floats, Floats]:
        data = self._env.data
        return data.qpos.copy(), data.qvel.copy()


def demonstrate(task: str, variant: str, number: int, least_score: float = 1.0) -> Demonstration:
    """A demonstration by the expert: `number` is the seed of the scene and of the expert.

    If it does not reach `least_score`, experts with other seeds try.

    Raises:
        InvalidSeedError: if `number` is not an integer, or negative.
        DemonstrationError: if none of them reaches it.
    """
    number = check_seed(number)
    best = 0.0
    with closing(Engine(task, variant, seed=number)) as env:
        for attempt in range(ATTEMPTS):
            env.reset(seed=number)
            seed = number + attempt * STRIDE
            expert, recorder = Expert(env, task, seed), Recorder(env)
            for _ in play(recorder, forever(expert)):
                if recorder.idle(REST):
                    break
            if env.score() >= least_score:
                return recorder.demonstration(task, variant, number, "expert", seed)
            best = max(best, env.score())
    raise DemonstrationError(
        f"{ATTEMPTS} experts tried {task}-{variant_name(variant)} with seed {number}; the best reached {best:.2f}"
    )
