"""Measures batched worlds: steps per second, the time of each part, memory, and single environments to compare with."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from time import perf_counter
from typing import Final

import torch
import warp as wp
from torch import Tensor

from magical_mj import batched
from magical_mj.assets.contacts import SUBSTEPS
from magical_mj.batched.environment import BatchedEnv
from magical_mj.envs.gymnasium_env import MagicalEnv
from magical_mj.envs.presets import Preset, preset_named
from magical_mj.scene.actions import ACTIONS
from magical_mj.speed.launches import Kernel, recorded_launches, size
from magical_mj.speed.measure import plans
from magical_mj.speed.roofline import Work, newton_operations, step_seconds
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.parallel import cores, map_unordered

WARM_UP: Final = 3
"""Steps before the clock starts: kernels are compiled, the graph is captured."""
WATCHED: Final = 20
"""Steps of an episode whose launches are recorded; how many the solver needs differs from step to step."""
PIXEL_OPERATIONS: Final = 1200
"""Of painting a pixel, by a rough count: four samples, each held against some thirty edges by ten operations."""
SINGLE_EPISODES: Final = 3
"""Episodes of the single environment on each core."""


@dataclass(frozen=True)
class BatchedMeasurement:
    """The measurement of one environment with one number of worlds. Times are wall clock, in seconds.

    Attributes:
        rate: environment steps per second in total, with observations and resets.
        physics_seconds: time of one control step of all worlds.
        observation_seconds: time of their observations.
        reset_seconds: time of a reset of all worlds.
        kernels: of one control step with its observations, launched one by one: the mean of some steps; see `launches`.
        work: what they amount to.
        world_bytes: memory of one world's simulation.
    """

    task: str
    variant: str
    preset: str
    worlds: int
    rate: float
    physics_seconds: float
    observation_seconds: float
    reset_seconds: float
    kernels: list[Kernel]
    work: Work
    world_bytes: int

    def expected(self, worlds: int) -> float:
        """Steps per second that the model of `roofline` expects of an H200 with so many worlds, resets aside."""
        return worlds / step_seconds(self.work, worlds)


def measure_batched(task: str, variant: str, worlds: int, preset: str, device: str) -> BatchedMeasurement:
    """Measures one episode of random actions in all worlds, with the reset after it, and then each part separately."""
    with closing(batched.make(task, variant, worlds, preset=preset, device=device, workers=_workers(worlds))) as env:
        generator = torch.Generator().manual_seed(0)
        actions = torch.randint(len(ACTIONS), (task_spec(task).horizon(), worlds), generator=generator).to(device)
        env.reset(seed=0)
        for step in range(WARM_UP):
            env.step(actions[step])
        kernels, work = _work(env, preset_named(preset), actions[WARM_UP : WARM_UP + WATCHED])
        env.reset()

        def play() -> None:
            for row in actions:
                env.step(row)  # whose observations are not kept: those of a whole episode would fill the accelerator

        seconds = _seconds(device, play)
        return BatchedMeasurement(
            task=task,
            variant=variant,
            preset=preset,
            worlds=worlds,
            rate=worlds * len(actions) / seconds,
            physics_seconds=_seconds(device, lambda: env.physics.step(actions[0])),
            observation_seconds=_seconds(device, lambda: env.observer.look(env.physics)),
            reset_seconds=_seconds(device, lambda: env.reset(seed=0)),
            kernels=kernels,
            work=work,
            world_bytes=sum(map(size, vars(env.physics.data).values())) // worlds,
        )


def _work(env: BatchedEnv, shown: Preset, actions: Tensor) -> tuple[list[Kernel], Work]:
    """The launches of a control step with its observations, on average over these actions, and what they amount to."""
    solver = 0.0
    with recorded_launches(env.device) as recorded:
        for row in actions:
            env.physics.step(row, graph=False)
            env.observer.look(env.physics)
            rows, iterations = (float(values.double().mean()) for values in env.physics.solved)
            solver += SUBSTEPS * newton_operations(env.physics.model.nv, rows, iterations)
    count = len(actions)
    kernels = [
        Kernel(one.part, one.name, one.launches / count, one.seconds / count, one.bytes / count) for one in recorded
    ]
    painting = PIXEL_OPERATIONS * len(shown.frames) * shown.image_size**2
    total = sum(kernel.bytes for kernel in kernels) / env.num_envs
    return kernels, Work(sum(kernel.launches for kernel in kernels), total, solver / count + painting)


def _workers(worlds: int) -> int:
    return min(8, max(1, cores() - 1)) if worlds > 64 else 0


def _seconds(device: str, work: Callable[[], object]) -> float:
    wp.synchronize_device(device)
    start = perf_counter()
    work()
    wp.synchronize_device(device)
    return perf_counter() - start


def single_rate(task: str, variant: str, preset: str) -> float:
    """Steps per second of the single environments, one process on each core, all at once."""
    return sum(map_unordered(_single, [(task, variant, preset)] * cores()))


def _single(environment: tuple[str, str, str]) -> float:
    with closing(MagicalEnv(*environment)) as env:
        env.reset(seed=0)  # the first frame starts OpenGL
        steps, start = 0, perf_counter()
        for seed, plan in zip(range(SINGLE_EPISODES), plans(env), strict=False):
            env.reset(seed=seed)
            for action in plan:
                env.step(action)
            steps += len(plan)
        return steps / (perf_counter() - start)
