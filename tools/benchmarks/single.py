"""Measures single environments: steps with resets, in alternation with a bare MuJoCo loop, and then only resets.

Times are processor time in seconds, over all threads of this process. Wall time depends on other load: under load, it
gave shares of the bare loop between 58 and 100 %, but processor time gives 78 to 89. Vectors are measured in wall time,
because their purpose is to use all cores.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from time import perf_counter, process_time
from typing import Final, Literal

import mujoco
import numpy as np

import magical_mj
from magical_mj.actions import ACTIONS
from magical_mj.assets.contacts import SUBSTEPS
from magical_mj.assets.robot import controls
from magical_mj.assets.scene_model import SceneModel, new_model
from magical_mj.envs.gymnasium_env import MagicalEnv
from magical_mj.envs.presets import Preset, preset_named
from magical_mj.rendering.renderer import new_renderer
from magical_mj.scene import Scene
from magical_mj.utils.errors import MissingExtraError

Cause = Literal["rewritten", "compiled"]
"""The work of a reset: rewrite the numbers of a model with the same structure, or get a model of another structure."""

TURN: Final = 20
"""The number of steps in each turn. Environment and bare loop alternate, so that other load affects both equally."""
COMPOSER_TURNS: Final = 20
NUM_ENVS: Final = 32
"""The number of environments in a vector."""
RESETS: Final = 40
"""The number of resets that are measured without steps."""


@dataclass(frozen=True)
class Measurement:
    """The measurement of one environment. Times are processor time, in seconds.

    Attributes:
        steps: the number of steps, in whole episodes.
        seconds: the time of these steps and of the resets between them.
        bare_seconds: the time of the same number of steps of the bare loop.
        resets: the times of the resets that were measured without steps.
        vector_rate: steps per second of wall time of `NUM_ENVS` environments on all cores.
    """

    task: str
    variant: str
    preset: str
    steps: int
    seconds: float
    bare_seconds: float
    resets: Mapping[Cause, list[float]]
    vector_rate: float = 0.0

    @property
    def rate(self) -> float:
        """Steps per second, resets included."""
        return self.steps / self.seconds

    @property
    def bare_rate(self) -> float:
        """Steps per second of the bare loop."""
        return self.steps / self.bare_seconds

    @property
    def share(self) -> float:
        """The rate relative to that of the bare loop."""
        return self.rate / self.bare_rate

    def reset_quantile(self, cause: Cause, share: float) -> float | None:
        """The quantile of the times of resets of one cause in seconds. None if there were no such resets."""
        return float(np.quantile(self.resets[cause], share)) if self.resets[cause] else None


def measure(task: str, variant: str, preset: str, steps: int, renderer: str | None = None) -> Measurement:
    """Plays random episodes in the scenes of seeds 0, 1, 2... until it has taken at least `steps` steps."""
    done, seconds, bare_seconds = 0, 0.0, 0.0
    with closing(MagicalEnv(task, variant, preset, renderer=renderer)) as env:
        env.reset(seed=0)  # the first frame starts the renderer
        for seed, plan in enumerate(plans(env)):
            if done >= steps:
                break
            taken, bare_taken = _episode(env, seed, plan, preset_named(preset), renderer)
            seconds += taken
            bare_seconds += bare_taken
            done += len(plan)
    resets = _reset_times(task, variant, preset, renderer)
    together = vector_rate(task, variant, preset, steps, renderer)
    return Measurement(task, variant, preset, done, seconds, bare_seconds, resets, together)


def vector_rate(task: str, variant: str, preset: str, steps: int, renderer: str | None) -> float:
    """Steps per second of wall time of `NUM_ENVS` environments, which share the steps equally."""
    settings = {"variant": variant, "preset": preset, "renderer": renderer}
    rows = np.random.default_rng(0).integers(len(ACTIONS), size=(max(1, steps // NUM_ENVS), NUM_ENVS))
    with closing(magical_mj.make_vec(task, NUM_ENVS, **settings)) as envs:
        envs.reset(seed=0)
        start = perf_counter()
        for row in rows:
            envs.step(row)
        return rows.size / (perf_counter() - start)


def _episode(env: MagicalEnv, seed: int, plan: list[int], preset: Preset, renderer: str | None) -> tuple[float, float]:
    """The time of an episode with its reset, and of the same steps in the bare loop, in seconds.

    The bare loop is made after the first turn, because in normal use, steps follow a reset directly.
    """

    def play(actions: list[int]) -> None:
        for action in actions:
            env.step(action)

    first, *others = (plan[begin : begin + TURN] for begin in range(0, len(plan), TURN))
    start = process_time()
    env.reset(seed=seed)
    seconds = process_time() - start + _seconds(play, first)
    with closing(BareLoop(env.engine.initial_scene, preset, renderer)) as bare:
        bare_seconds = _seconds(bare.run, first)
        for actions in others:
            seconds += _seconds(play, actions)
            bare_seconds += _seconds(bare.run, actions)
    return seconds, bare_seconds


def _seconds(take: Callable[[list[int]], None], actions: list[int]) -> float:
    """The time in seconds to take these actions."""
    start = process_time()
    take(actions)
    return process_time() - start


def plans(env: MagicalEnv) -> Iterator[list[int]]:
    """Yields random actions for each episode."""
    rng = np.random.default_rng(0)
    while True:
        yield rng.integers(len(ACTIONS), size=env.engine.horizon).tolist()


def _reset_times(task: str, variant: str, preset: str, renderer: str | None) -> dict[Cause, list[float]]:
    """The time in seconds of each reset with its first picture, in the scenes of seeds 0, 1, 2..."""
    times: dict[Cause, list[float]] = {"rewritten": [], "compiled": []}
    with closing(MagicalEnv(task, variant, preset, renderer=renderer)) as env:
        for seed in range(RESETS):
            before, start = env.engine.scene_model.structure, process_time()
            env.reset(seed=seed)
            taken = process_time() - start
            times["rewritten" if env.engine.scene_model.structure == before else "compiled"].append(taken)
    return times


@cache
def composer_share() -> float | None:
    """The speed of `magical_mj.load` without pictures relative to the bare loop. None without dm_control.

    For both, the fastest of several turns counts.
    """
    try:
        env = magical_mj.load("MoveToRegion", seed=0, observations=())
    except MissingExtraError:
        return None

    def play(actions: list[int]) -> None:
        for action in actions:
            env.step(action)

    actions = np.random.default_rng(0).integers(len(ACTIONS), size=TURN).tolist()
    times: list[tuple[float, float]] = []
    with closing(env):
        for _ in range(COMPOSER_TURNS):
            env.reset(seed=0)
            with closing(BareLoop(env.initial_scene, preset_named("State"))) as bare:
                times.append((_seconds(play, actions), _seconds(bare.run, actions)))
    seconds, bare_seconds = map(min, zip(*times, strict=True))
    return bare_seconds / seconds


class BareLoop:
    """Steps the model of a scene, and draws the views of a preset with the environment's renderer.

    It has no resets, hooks, checks, scores, stacked frames or wrappers.
    """

    def __init__(self, scene: Scene, preset: Preset, renderer: str | None = None) -> None:
        world = SceneModel(scene)
        self.model = new_model(world.structure)
        self.data = mujoco.MjData(self.model)
        world.rewrite(self.model, self.data)
        mujoco.mj_resetData(self.model, self.data)  # puts the bodies at the scene's poses
        self._shown = [view for view, _ in preset.frames]
        self._size = preset.image_size
        self._renderer = new_renderer(self.model, "flat", renderer)
        self._draw()  # the first picture includes initialisation

    def run(self, actions: Iterable[int]) -> None:
        """Takes these actions and draws the views after each."""
        for action in actions:
            self.data.ctrl[:] = controls()[action]
            mujoco.mj_step(self.model, self.data, SUBSTEPS)
            self._draw()

    def _draw(self) -> None:
        for view in self._shown:
            self._renderer.draw(self.data, view, self._size)

    def close(self) -> None:
        """Frees the renderer."""
        del self._renderer
