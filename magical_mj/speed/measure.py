"""Measures one environment: steps including resets, alternating with the bare loop, and then resets alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from time import perf_counter
from typing import Final, Literal

import numpy as np

from magical_mj.envs.gymnasium_env import MagicalEnv
from magical_mj.envs.presets import Preset, preset_named
from magical_mj.scene.actions import ACTIONS
from magical_mj.speed.bare import BareLoop

Cause = Literal["rewritten", "compiled"]
"""What a reset does: rewrite the numbers of a model with the same structure, or get a model of another structure."""

TURN: Final = 20
"""The number of steps after which environment and bare loop alternate, so that other load affects both equally."""
RESETS: Final = 40
"""Resets that are measured alone."""


@dataclass(frozen=True)
class Measurement:
    """The measurement of one environment. Times are wall clock, in seconds.

    Attributes:
        steps: the number of steps, in whole episodes.
        seconds: the time of these steps and of the resets between them.
        bare_seconds: the time of the same number of steps of the bare loop.
        resets: the times of the resets that were measured alone.
    """

    task: str
    variant: str
    preset: str
    steps: int
    seconds: float
    bare_seconds: float
    resets: Mapping[Cause, list[float]]

    @property
    def rate(self) -> float:
        """Steps per second, resets included."""
        return self.steps / self.seconds

    @property
    def bare_rate(self) -> float:
        """Steps per second of the bare loop."""
        return self.steps / self.bare_seconds

    @property
    def ratio(self) -> float:
        """The rate as a share of the bare loop's."""
        return self.rate / self.bare_rate

    def reset_quantile(self, cause: Cause, share: float) -> float | None:
        """The quantile of the times of resets of one cause, in seconds; None if there were none."""
        return float(np.quantile(self.resets[cause], share)) if self.resets[cause] else None


def measure(task: str, variant: str, preset: str, steps: int) -> Measurement:
    """Plays random episodes in the scenes of seeds 0, 1, 2... until at least `steps` steps are done."""
    done, seconds, bare_seconds = 0, 0.0, 0.0
    with closing(MagicalEnv(task, variant, preset)) as env:
        env.reset(seed=0)  # the first frame starts OpenGL
        for seed, plan in enumerate(plans(env)):
            if done >= steps:
                break
            taken, bare_taken = episode(env, seed, plan, preset_named(preset))
            seconds += taken
            bare_seconds += bare_taken
            done += len(plan)
    resets = reset_times(task, variant, preset)
    return Measurement(task, variant, preset, done, seconds, bare_seconds, resets)


def episode(env: MagicalEnv, seed: int, plan: list[int], preset: Preset) -> tuple[float, float]:
    """Seconds of an episode with its reset, and of its steps in the bare loop.

    The bare loop is made after the first turn, since in normal use nothing happens between a reset and its first steps.
    """

    def play(actions: list[int]) -> None:
        for action in actions:
            env.step(action)

    first, *others = (plan[begin : begin + TURN] for begin in range(0, len(plan), TURN))
    start = perf_counter()
    env.reset(seed=seed)
    seconds = perf_counter() - start + _seconds(play, first)
    with closing(BareLoop(env.dm_env.initial_scene, preset)) as bare:
        bare_seconds = _seconds(bare.run, first)
        for actions in others:
            seconds += _seconds(play, actions)
            bare_seconds += _seconds(bare.run, actions)
    return seconds, bare_seconds


def _seconds(take: Callable[[list[int]], None], actions: list[int]) -> float:
    """How long it takes to take these actions."""
    start = perf_counter()
    take(actions)
    return perf_counter() - start


def plans(env: MagicalEnv) -> Iterator[list[int]]:
    """Random actions for one episode after another."""
    rng = np.random.default_rng(0)
    while True:
        yield rng.integers(len(ACTIONS), size=env.dm_env.horizon).tolist()


def reset_times(task: str, variant: str, preset: str) -> dict[Cause, list[float]]:
    """Seconds of each reset, with the first picture, in the scenes of seeds 0, 1, 2..."""
    times: dict[Cause, list[float]] = {"rewritten": [], "compiled": []}
    with closing(MagicalEnv(task, variant, preset)) as env:
        for seed in range(RESETS):
            before, start = env.dm_env.task.world.structure, perf_counter()
            env.reset(seed=seed)
            taken = perf_counter() - start
            times["rewritten" if env.dm_env.task.world.structure == before else "compiled"].append(taken)
    return times
