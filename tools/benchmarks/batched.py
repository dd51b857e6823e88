"""Measures batched environments: steps per second, the time of each part, memory, and single environments to compare.

Times are wall clock, since an accelerator does the work. The profile of a step is the duration of each kernel launch,
and the size of its arrays. On an accelerator, durations are those between events on the stream. On the CPU device, a
launch returns when it is finished, so they are wall clock. Launches from a captured graph and launches of PyTorch do
not count; PyTorch's own profile has them.
"""

from __future__ import annotations

import inspect
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Final

import numpy as np
import torch
import warp as wp
from torch import Tensor
from torch.profiler import ProfilerActivity, profile

from magical_mj import batched
from magical_mj.actions import ACTIONS
from magical_mj.batched.environment import BatchedEnv
from magical_mj.envs.gymnasium_env import MagicalEnv
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.parallel import cores, map_unordered
from tools.benchmarks.single import plans

WARM_UP: Final = 3
"""Steps before the measurement. In them, kernels are compiled and the graph is captured."""
WATCHED: Final = 20
"""The number of steps with recorded launches. The solver's launches differ from step to step."""
PROFILED: Final = 5
"""The number of steps of PyTorch's profile, and of those that are timed."""
ROWS: Final = 15
"""The number of lines of its table."""
SINGLE_EPISODES: Final = 3
"""The number of episodes of the single environment on each core."""


@dataclass
class Kernel:
    """All launches of one kernel, or their mean over some steps.

    Attributes:
        part: the module of the kernel, such as "solver".
        name: the name of its function.
        launches: the number of launches.
        seconds: their total duration.
        bytes: the total size of their arrays, as if each were read or written once as a whole.
    """

    part: str
    name: str
    launches: float = 0
    seconds: float = 0.0
    bytes: float = 0


@contextmanager
def recorded_launches(device: str) -> Iterator[list[Kernel]]:
    """A context that records kernel launches. The list is filled at its end, with the longest kernel first."""
    marks: list[tuple[Any, Any, Any, int]] = []
    originals = {name: getattr(wp, name) for name in ("launch", "launch_tiled")}
    signature = inspect.signature(originals["launch"])

    def recording(launch: Any) -> Any:
        def recorded(*args: Any, **kwargs: Any) -> Any:
            arguments = signature.bind_partial(*args, **kwargs).arguments
            if np.prod(arguments["dim"]) == 0:  # Warp launches no kernel
                return launch(*args, **kwargs)
            begin = _mark(device)
            result = launch(*args, **kwargs)
            arrays = [*arguments.get("inputs", ()), *arguments.get("outputs", ())]
            marks.append((arguments["kernel"], begin, _mark(device), sum(map(size, arrays))))
            return result

        return recorded

    kernels: list[Kernel] = []
    try:
        for name, launch in originals.items():
            setattr(wp, name, recording(launch))
        yield kernels
    finally:
        for name, launch in originals.items():
            setattr(wp, name, launch)
    wp.synchronize_device(device)
    kernels += _summed(marks)


def _mark(device: str) -> Any:
    """A time mark: an event on the device's stream, or on the CPU device a time in seconds."""
    return wp.record_event(wp.Event(device, enable_timing=True)) if wp.get_device(device).is_cuda else perf_counter()


def _summed(marks: Iterable[tuple[Any, Any, Any, int]]) -> list[Kernel]:
    kernels: dict[tuple[str, str], Kernel] = {}
    for launched, begin, end, size_in_bytes in marks:
        key = launched.func.__module__.rpartition(".")[2], launched.func.__qualname__.partition(".<locals>")[0]
        kernel = kernels.setdefault(key, Kernel(*key))
        kernel.launches += 1
        kernel.seconds += end - begin if isinstance(begin, float) else wp.get_event_elapsed_time(begin, end) / 1000
        kernel.bytes += size_in_bytes
    return sorted(kernels.values(), key=lambda kernel: -kernel.seconds)


def size(value: Any) -> int:
    """The size in bytes of an array, or of all arrays in a struct or data class."""
    if isinstance(value, wp.array):
        return value.capacity
    return sum(array.capacity for array in getattr(value, "__dict__", {}).values() if isinstance(array, wp.array))


def by_part(kernels: Iterable[Kernel]) -> list[Kernel]:
    """The sums over the kernels of each part, the longest first."""
    parts: dict[str, list[Kernel]] = defaultdict(list)
    for kernel in kernels:
        parts[kernel.part].append(kernel)
    sums = [
        Kernel(
            part, "", *(sum(getattr(kernel, name) for kernel in members) for name in ("launches", "seconds", "bytes"))
        )
        for part, members in parts.items()
    ]
    return sorted(sums, key=lambda kernel: -kernel.seconds)


@dataclass(frozen=True)
class BatchedMeasurement:
    """The measurement of a batch of one task and variant. Times are wall clock, in seconds.

    Attributes:
        rate: environment steps per second in total, with observations and resets.
        step_seconds: time of one step of the batch in which no episode ends.
        physics_seconds: the part of it that the simulation takes.
        observation_seconds: the part of it that observations take. The rest is checks, scores and infos.
        reset_seconds: time of a reset of the batch.
        kernels: the launches of one control step with its observations, without a graph: the mean of some steps.
        profile: PyTorch's table of all operations and kernels of some steps, graphs included, the longest first.
        bytes: the size of all arrays of these launches, per environment.
        env_bytes: the memory of the simulation, per environment.
    """

    task: str
    variant: str
    preset: str
    num_envs: int
    rate: float
    step_seconds: float
    physics_seconds: float
    observation_seconds: float
    reset_seconds: float
    kernels: list[Kernel]
    profile: str
    bytes: float
    env_bytes: int


def measure_batched(task: str, variant: str, num_envs: int, preset: str, device: str) -> BatchedMeasurement:
    """Measures an episode of random actions in the batch, with the reset after it, and then each part separately."""
    with closing(
        batched.make(task, variant, num_envs, preset=preset, device=device, workers=_workers(num_envs))
    ) as env:
        generator = torch.Generator().manual_seed(0)
        actions = torch.randint(len(ACTIONS), (task_spec(task).horizon(), num_envs), generator=generator).to(device)
        env.reset(seed=0)
        for step in range(WARM_UP):
            env.step(actions[step])
        kernels = _kernels(env, actions[WARM_UP : WARM_UP + WATCHED])
        env.reset()
        step_seconds = _seconds(device, lambda: env.step(actions[0]), PROFILED)
        table = _profile(env, actions[:PROFILED])
        env.reset()

        def play() -> None:
            for row in actions:
                env.step(row)  # observations are not kept: those of a whole episode would fill the memory

        seconds, steps = _seconds(device, play), torch.zeros(num_envs, dtype=torch.int64)
        return BatchedMeasurement(
            task=task,
            variant=variant,
            preset=preset,
            num_envs=num_envs,
            rate=num_envs * len(actions) / seconds,
            step_seconds=step_seconds,
            physics_seconds=_seconds(device, lambda: env.physics.step(actions[0]), PROFILED),
            observation_seconds=_seconds(device, lambda: env.observer.observe(env.physics, steps), PROFILED),
            reset_seconds=_seconds(device, lambda: env.reset(seed=0)),
            kernels=kernels,
            profile=table,
            bytes=sum(kernel.bytes for kernel in kernels) / num_envs,
            env_bytes=sum(map(size, vars(env.physics.data).values())) // num_envs,
        )


def _kernels(env: BatchedEnv, actions: Tensor) -> list[Kernel]:
    """The launches of a control step with its observations, averaged over these actions."""
    with recorded_launches(env.device) as recorded:
        for row in actions:
            env.physics.step(row, graph=False)
            env.observer.observe(env.physics, torch.zeros(len(row), dtype=torch.int64))
    count = len(actions)
    return [
        Kernel(kernel.part, kernel.name, kernel.launches / count, kernel.seconds / count, kernel.bytes / count)
        for kernel in recorded
    ]


def _profile(env: BatchedEnv, actions: Tensor) -> str:
    """The longest operations and kernels of these steps, in a table."""
    cuda = wp.get_device(env.device).is_cuda
    kinds = [ProfilerActivity.CPU, *([ProfilerActivity.CUDA] if cuda else [])]
    with profile(activities=kinds) as watched:
        for row in actions:
            env.step(row)
        wp.synchronize_device(env.device)
    order = "self_cuda_time_total" if cuda else "self_cpu_time_total"
    return watched.key_averages().table(sort_by=order, row_limit=ROWS, max_name_column_width=60)


def _workers(num_envs: int) -> int:
    return min(8, max(1, cores() - 1)) if num_envs > 64 else 0


def _seconds(device: str, work: Callable[[], object], times: int = 1) -> float:
    """The mean time of some calls."""
    wp.synchronize_device(device)
    start = perf_counter()
    for _ in range(times):
        work()
    wp.synchronize_device(device)
    return (perf_counter() - start) / times


def single_rate(task: str, variant: str, preset: str) -> float:
    """The total steps per second of single environments in simultaneous processes, one per core."""
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
