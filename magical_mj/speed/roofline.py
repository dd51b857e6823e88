"""How fast an accelerator should step batched worlds, by what a step consists of; docs/batched.md states the model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Accelerator:
    """What a card does, and how much of it kernels like these get.

    Attributes:
        launch: seconds from one small kernel of a graph to the next.
        bandwidth: bytes per second, from and to its memory.
        arithmetic: single-precision operations per second.
    """

    launch: float
    bandwidth: float
    arithmetic: float


H200: Final = Accelerator(launch=2.5e-6, bandwidth=0.5 * 4.8e12, arithmetic=0.05 * 67e12)
"""NVIDIA's data sheet; assumed: half of the bandwidth, a twentieth of the arithmetic, 2.5 microseconds a launch."""


@dataclass(frozen=True)
class Work:
    """What a control step consists of.

    Attributes:
        launches: of kernels, one after another, each for all worlds. The solver makes some in each of its iterations,
            and goes on until the last world is done: so there are a few more of them with more worlds.
        bytes: that one world's share of them reads and writes.
        operations: of one world's share, in single precision.
    """

    launches: float
    bytes: float
    operations: float


def step_seconds(work: Work, worlds: int, card: Accelerator = H200) -> float:
    """Seconds of a control step: launches, memory and arithmetic one after another, as if nothing overlapped."""
    return work.launches * card.launch + worlds * (work.bytes / card.bandwidth + work.operations / card.arithmetic)


def newton_operations(dofs: int, rows: float, iterations: float) -> float:
    """Of the constraint solver in one substep: in each iteration the Hessian J' D J and its Cholesky factorisation.

    Args:
        dofs: degrees of freedom.
        rows: constraints that are there.
        iterations: of Newton's method.
    """
    return (iterations + 1) * (2 * rows * dofs**2 + dofs**3 / 3)
