"""What a step of batched worlds consists of: its kernel launches, how long each takes and how much memory it is given.

On an accelerator, events on the stream are timed; on the CPU device, where a launch returns when it is done, the wall
clock. Launches from a captured graph, and those of PyTorch, are not seen.
"""

from __future__ import annotations

import inspect
from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
import warp as wp


@dataclass
class Kernel:
    """All launches of one kernel, or their mean over some steps.

    Attributes:
        part: the module that it is from, such as "solver".
        name: the function's.
        launches: how many.
        seconds: all of them together.
        bytes: of all arrays that they were given, as if each were read or written once as a whole.
    """

    part: str
    name: str
    launches: float = 0
    seconds: float = 0.0
    bytes: float = 0


@contextmanager
def recorded_launches(device: str) -> Iterator[list[Kernel]]:
    """Records what is launched within; the list is filled at its end, the longest first."""
    marks: list[tuple[Any, Any, Any, int]] = []
    originals = {name: getattr(wp, name) for name in ("launch", "launch_tiled")}
    signature = inspect.signature(originals["launch"])

    def recording(launch: Any) -> Any:
        def recorded(*args: Any, **kwargs: Any) -> Any:
            given = signature.bind_partial(*args, **kwargs).arguments
            if np.prod(given["dim"]) == 0:  # nothing to do: Warp launches nothing
                return launch(*args, **kwargs)
            begin = _mark(device)
            result = launch(*args, **kwargs)
            arrays = [*given.get("inputs", ()), *given.get("outputs", ())]
            marks.append((given["kernel"], begin, _mark(device), sum(map(size, arrays))))
            return result

        return recorded

    found: list[Kernel] = []
    try:
        for name, launch in originals.items():
            setattr(wp, name, recording(launch))
        yield found
    finally:
        for name, launch in originals.items():
            setattr(wp, name, launch)
    wp.synchronize_device(device)
    found += _summed(marks)


def _mark(device: str) -> Any:
    """A moment: an event on the device's stream, or a time in seconds."""
    return wp.record_event(wp.Event(device, enable_timing=True)) if wp.get_device(device).is_cuda else perf_counter()


def _summed(marks: Iterable[tuple[Any, Any, Any, int]]) -> list[Kernel]:
    kernels: dict[tuple[str, str], Kernel] = {}
    for kernel, begin, end, given in marks:
        key = kernel.func.__module__.rpartition(".")[2], kernel.func.__qualname__.partition(".<locals>")[0]
        one = kernels.setdefault(key, Kernel(*key))
        one.launches += 1
        one.seconds += end - begin if isinstance(begin, float) else wp.get_event_elapsed_time(begin, end) / 1000
        one.bytes += given
    return sorted(kernels.values(), key=lambda one: -one.seconds)


def size(value: Any) -> int:
    """Bytes of an array, or of those in a struct or a data class."""
    if isinstance(value, wp.array):
        return value.capacity
    return sum(one.capacity for one in getattr(value, "__dict__", {}).values() if isinstance(one, wp.array))


def by_part(kernels: Iterable[Kernel]) -> list[Kernel]:
    """The sums over the kernels of each part, the longest first."""
    parts: dict[str, list[Kernel]] = defaultdict(list)
    for kernel in kernels:
        parts[kernel.part].append(kernel)
    sums = [
        Kernel(part, "", *(sum(getattr(one, name) for one in found) for name in ("launches", "seconds", "bytes")))
        for part, found in parts.items()
    ]
    return sorted(sums, key=lambda one: -one.seconds)
