"""Measures one environment: steps with their resets, the bare loop in turn with them, and the resets alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Final, Literal

import numpy as np

from magical_mj.actions import ACTIONS
from magical_mj.gym_env import MagicalEnv
from magical_mj.presets import Preset, preset
from magical_mj.speed.bare import BareLoop

Cause = Literal["rewritten", "compiled"]
"""What a reset does: write other numbers into a model of the same structure, or compile a new one."""

TURN: Final = 20
"""Steps after which environment and bare loop take turns, so that both suffer alike from a busy machine."""
RESETS: Final = 40
"""Resets that are measured alone."""


@dataclass(frozen=True)
class Measurement:
    """What was measured of one environment. Seconds, by the wall clock.

    Attributes:
        steps: that were taken, in whole episodes.
        seconds: for them and for the resets between them.
        bare_seconds: for as many steps of the bare loop.
        resets: seconds of each of the resets that were measured alone.
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
        """Seconds in which this share of the resets of one cause were done; None if there were none."""
        return float(np.quantile(self.resets[cause], share)) if self.resets[cause] else None


def measure(task: str, variant: str, preset_name: str, steps: int) -> Measurement:
    """Plays random episodes in the scenes of seeds 0, 1, 2... until at least `steps` steps are done."""
    env = MagicalEnv(task, variant, preset_name)
    env.reset(seed=0)  # the first frame starts OpenGL
    done, seconds, bare_seconds = 0, 0.0, 0.0
    for seed, plan in enumerate(plans(env)):
        if done >= steps:
            break
        taken, bare_taken = episode(env, seed, plan, preset(preset_name))
        seconds += taken
        bare_seconds += bare_taken
        done += len(plan)
    resets = reset_times(task, variant, preset_name)
    env.close()
    return Measurement(task, variant, preset_name, done, seconds, bare_seconds, resets)


def episode(env: MagicalEnv, seed: int, plan: list[int], shown: Preset) -> tuple[float, float]:
    """Seconds of an episode with its reset, and of its steps in the bare loop.

    The bare loop is made after the first turn: in use, too, nothing comes between a reset and the steps after it.
    """

    def play(actions: list[int]) -> None:
        for action in actions:
            env.step(action)

    first, *others = (plan[begin : begin + TURN] for begin in range(0, len(plan), TURN))
    start = perf_counter()
    env.reset(seed=seed)
    seconds = perf_counter() - start + _seconds(play, first)
    bare = BareLoop(env.dm_env.initial_scene, shown)
    bare_seconds = _seconds(bare.run, first)
    for actions in others:
        seconds += _seconds(play, actions)
        bare_seconds += _seconds(bare.run, actions)
    bare.close()
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


def reset_times(task: str, variant: str, preset_name: str) -> dict[Cause, list[float]]:
    """Seconds of each reset, with the first picture, in the scenes of seeds 0, 1, 2..."""
    env = MagicalEnv(task, variant, preset_name)
    times: dict[Cause, list[float]] = {"rewritten": [], "compiled": []}
    for seed in range(RESETS):
        before, start = env.dm_env.task.world.structure, perf_counter()
        env.reset(seed=seed)
        taken = perf_counter() - start
        times["rewritten" if env.dm_env.task.world.structure == before else "compiled"].append(taken)
    env.close()
    return times
