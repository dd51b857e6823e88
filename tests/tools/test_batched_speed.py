"""What `python -m tools.benchmarks --batched` counts, not how fast anything is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest
import warp as wp

from tools.benchmarks.__main__ import _batched_lines
from tools.benchmarks.batched import BatchedMeasurement, Kernel, by_part, recorded_launches, size

pytestmark = [pytest.mark.xdist_group("warp"), pytest.mark.filterwarnings("default")]


@wp.kernel
def double(values: wp.array(dtype=float)):  # noqa: ANN201 (Warp reads the annotations)
    """Doubles numbers."""
    index = wp.tid()
    values[index] = 2.0 * values[index]


def test_launches_are_counted_with_their_memory() -> None:
    before = wp.launch, wp.launch_tiled
    values = wp.ones(8, dtype=float, device="cpu")
    with recorded_launches("cpu") as kernels:
        wp.launch(double, dim=8, inputs=[values], device="cpu")
        wp.launch(double, 8, outputs=[values], device="cpu")
        wp.launch(double, dim=0, inputs=[values], device="cpu")  # which Warp does not launch
    assert (wp.launch, wp.launch_tiled) == before
    assert values.numpy().tolist() == 8 * [4.0]
    (kernel,) = kernels
    assert (kernel.part, kernel.name, kernel.launches, kernel.bytes) == ("test_batched_speed", "double", 2, 2 * 32)
    assert kernel.seconds > 0


@dataclass
class Held:
    values: Any
    count: int = 3


def test_memory_in_classes_counts() -> None:
    assert size(Held(wp.ones(8, dtype=float, device="cpu"))) == 32


def test_parts_are_sums_of_kernels() -> None:
    kernels = [Kernel("solver", "a", 2, 1.0, 10), Kernel("smooth", "b", 1, 2.5, 5), Kernel("solver", "c", 3, 2.0, 1)]
    assert by_part(kernels) == [Kernel("solver", "", 5, 3.0, 11), Kernel("smooth", "", 1, 2.5, 5)]


def test_the_command_prints_parts_or_kernels() -> None:
    kernels = [Kernel("solver", "a", 2, 1.0, 10_000_000), Kernel("solver", "b", 1, 0.5, 0)]
    speed = BatchedMeasurement(
        "FindDupe", "All", "State", 8, 50.0, 0.35, 0.1, 0.2, 0.3, kernels, "aten::add", 2e6, 95_000
    )
    parts, every = list(_batched_lines(speed, 25.0, profile=False)), list(_batched_lines(speed, 25.0, profile=True))
    assert parts[0] == "FindDupe All, State, 8 environments: 50 steps/s"
    assert "2 times" in parts[1]
    assert "350.00 ms: physics 100.00, observations 200.00, the rest 50.00; a reset of the batch 300.00 ms" in parts[3]
    assert "3 kernel launches, 2.00 MB an environment" in parts[4]
    assert parts[5:] == ["  solver: 3 launches, 1500.00 ms, 10.0 MB"]
    each = ["  solver a: 2 launches, 1000.00 ms, 10.0 MB", "  solver b: 1 launches, 500.00 ms, 0.0 MB"]
    assert every[5:] == [*each, "aten::add"]
