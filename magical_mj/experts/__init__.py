"""Scripted experts that solve every environment from the privileged state.

An expert reads the true state of the simulation, tries manoeuvres on a copy of it, and acts with the same 18 actions as
every other agent.
"""

from __future__ import annotations

from collections.abc import Callable

from magical_mj.environment import Environment
from magical_mj.episodes import forever, play
from magical_mj.experts.expert import Expert

__all__ = ["Expert", "make_expert", "run_episode"]


def make_expert(env: Environment, task: str, seed: int = 0) -> Callable[[], int]:
    """A policy that drives `env`: each call gives the action for the present state.

    Args:
        env: an environment of the task, already reset; it may be reset again later.
        task: a task's name, or "package.module:SPEC".
        seed: the seed of the expert's random choices.
    """
    return Expert(env, task, seed)


def run_episode(env: Environment, task: str, scene_seed: int, seed: int = 0) -> float:
    """Plays one episode in the scene of `scene_seed` with an expert, and returns its score."""
    env.reset(seed=scene_seed)
    for _ in play(env, forever(Expert(env, task, seed))):
        pass
    return env.score()
