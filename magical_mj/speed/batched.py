"""Measures batched worlds: steps per second, the time of each part, memory, and single environments to compare with."""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Final

import torch
import warp as wp

from magical_mj import batched
from magical_mj.actions import ACTIONS
from magical_mj.assets.contacts import SUBSTEPS
from magical_mj.batched.environment import BatchedEnv
from magical_mj.gym_env import MagicalEnv
from magical_mj.presets import Preset, preset_named
from magical_mj.registry import task_spec
from magical_mj.speed.launches import Kernel, recorded_launches
from magical_mj.speed.measure import episode, plans
from magical_mj.speed.roofline import Work, newton_operations, step_seconds

WARM_UP: Final = 3
"""Steps before the clock starts: kernels are compiled, the graph is captured."""
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
        kernels: of one control step with its observations, launched one by one; see `launches`.
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

    @property
    def predicted(self) -> float:
        """Steps per second that the model of `roofline` expects of an H200, resets aside."""
        return self.worlds / step_seconds(self.work, self.worlds)


def measure_batched(task: str, variant: str, worlds: int, preset: str, device: str) -> BatchedMeasurement:
    """Measures one episode of random actions in all worlds, with the reset after it, and then each part separately."""
    env = batched.make(task, variant, worlds, preset=preset, device=device, workers=_workers(worlds))
    generator = torch.Generator().manual_seed(0)
    actions = torch.randint(len(ACTIONS), (task_spec(task).horizon(), worlds), generator=generator).to(device)
    env.reset(seed=0)
    for step in range(WARM_UP):
        env.step(actions[step])
    kernels, work = _work(env, preset_named(preset), device)
    env.reset()
    seconds = _seconds(device, lambda: [env.step(row) for row in actions])
    measured = BatchedMeasurement(
        task=task,
        variant=variant,
        preset=preset,
        worlds=worlds,
        rate=worlds * len(actions) / seconds,
        physics_seconds=_seconds(device, lambda: env._physics.step(actions[0])),
        observation_seconds=_seconds(device, lambda: env._observer.look(env._physics)),
        reset_seconds=_seconds(device, lambda: env.reset(seed=0)),
        kernels=kernels,
        work=work,
        world_bytes=_bytes(env._physics._data, worlds),
    )
    env.close()
    return measured


def _work(env: BatchedEnv, shown: Preset, device: str) -> tuple[list[Kernel], Work]:
    """The launches of a control step with its observations, and what they amount to."""
    physics = env._physics
    with recorded_launches(device) as kernels:
        physics._substeps()
        env._observer.look(physics)
    rows, iterations = (float(values.double().mean()) for values in physics.solved)
    solver = SUBSTEPS * newton_operations(physics.model.nv, rows, iterations)
    painting = PIXEL_OPERATIONS * len(shown.frames) * shown.image_size**2
    total = sum(kernel.bytes for kernel in kernels) / env.num_envs
    return kernels, Work(sum(kernel.launches for kernel in kernels), total, solver + painting)


def _workers(worlds: int) -> int:
    return min(8, max(1, (os.cpu_count() or 2) - 1)) if worlds > 64 else 0


def _seconds(device: str, work: Callable[[], object]) -> float:
    wp.synchronize_device(device)
    start = perf_counter()
    work()
    wp.synchronize_device(device)
    return perf_counter() - start


def _bytes(data: Any, worlds: int) -> int:
    """Bytes of all arrays of the simulation, per world."""
    total = 0
    for entry in dataclasses.fields(data):
        value = getattr(data, entry.name)
        if isinstance(value, wp.array):
            total += value.capacity
        elif dataclasses.is_dataclass(value):
            total += sum(item.capacity for item in vars(value).values() if isinstance(item, wp.array))
    return total // worlds


def single_rate(task: str, variant: str, preset: str) -> float:
    """Steps per second of the single environments, one process on each core, all at once."""
    cores = os.cpu_count() or 1
    with ProcessPoolExecutor(cores, mp_context=multiprocessing.get_context("spawn")) as pool:
        jobs = [pool.submit(_single, task, variant, preset) for _ in range(cores)]
        return sum(job.result() for job in jobs)


def _single(task: str, variant: str, preset: str) -> float:
    env = MagicalEnv(task, variant, preset)
    env.reset(seed=0)
    steps, seconds = 0, 0.0
    for seed, plan in zip(range(SINGLE_EPISODES), plans(env), strict=False):
        seconds += episode(env, seed, plan, preset_named(preset))[0]
        steps += len(plan)
    env.close()
    return steps / seconds
