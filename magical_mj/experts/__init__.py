"""Scripted experts that solve every environment from the privileged state.

An expert reads the true state of the simulation, tries manoeuvres on a copy of it, and acts with the same 18 actions as
all other agents. Tasks of suites have experts of their own. Pictures of scenes solved by experts specify goals.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from functools import lru_cache
from typing import Any, Final

import gymnasium
import numpy as np
from numpy.typing import NDArray

from magical_mj.engine import Engine
from magical_mj.experts.planner import Expert
from magical_mj.observations import CAMERAS
from magical_mj.rendering.picture import check_size
from magical_mj.scene import Scene
from magical_mj.tasks.suites import suite_of
from magical_mj.utils.errors import SettingsError, TaskError, check_name
from magical_mj.utils.imports import moved

__all__ = ["Expert", "GoalPicture", "expert_of"]

__getattr__ = moved("magical_mj.xmagical.expert", "Sweeper")

EXPERTS: Final = 10
"""The number of experts, each with another seed, that try to solve a scene for its picture."""


def expert_of(env: Engine, task: str, seed: int) -> Callable[[], Any]:
    """The expert of a task. Each call returns the action for the engine's current state.

    Raises:
        TaskError: if the task has no expert.
        SettingsError: if it cannot solve the task with the engine's body.
    """
    suite = suite_of(task)
    return Expert(env, task, seed) if suite is None else suite.expert(env, seed)


class GoalPicture(gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs):
    """Adds `info["goal"]`: a picture of the episode's scene after an expert has solved it, uint8, (size, size, 3).

    The expert plays the episode at each reset, which takes up to several seconds. Recent scenes are cached, and Demo's
    scene always is. The picture depends on the episode's scene, but not on its seed. It shows no drawn shifts.

    Args:
        env: an environment of this package, of a task with a plan.
        view: "ego" or "allo", or "scene", in 3-D.
        size: side of the picture in pixels.

    Raises:
        SettingsError: if the environment is another one, or the view or the size is invalid.
        TaskError: in `reset`, if no expert solves the scene.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], view: str = "allo", size: int = 96) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, view=view, size=size)
        super().__init__(env)
        engine = getattr(env.unwrapped, "engine", None)
        if not isinstance(engine, Engine) or engine.task is None or engine.setup.speeds:
            raise SettingsError(f"GoalPicture needs an environment whose task has a plan, not {env.unwrapped}")
        check_name("view", view, CAMERAS)
        self._engine, self._view, self._size = engine, view, check_size(size)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Starts an episode. The goal is in its info."""
        observation, info = super().reset(seed=seed, options=options)
        engine = self._engine
        where = engine.task or "", engine.variant, engine.initial_scene
        self._goal = goal_picture(*where, self._view, self._size, engine.renderer)
        return observation, info | {"goal": self._goal}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Performs an action. The goal is in its info."""
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, reward, terminated, truncated, info | {"goal": self._goal}


@lru_cache(maxsize=100)  # the number of an environment's test scenes; large pictures take megabytes
def goal_picture(
    task: str, variant: str, scene: Scene, view: str, size: int, renderer: str | None
) -> NDArray[np.uint8]:
    """The end of an expert's episode that starts in `scene` and has score 1: shape (size, size, 3), not writable."""
    with closing(Engine(task, variant, scene=scene, body=scene.robot.body, renderer=renderer)) as engine:
        for seed in range(EXPERTS):
            engine.reset(scene=scene)
            expert = Expert(engine, task, seed)
            while not engine.step(expert()):
                pass
            if engine.score() == 1.0:
                picture = engine.render(view, size)
                picture.flags.writeable = False  # all episodes in this scene share it
                return picture
    raise TaskError(f"{EXPERTS} experts tried a scene of {task}-{variant}, but none solved it")
