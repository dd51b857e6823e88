"""Batches of samples: of a run's demonstrations, and of what the policy has just done."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_mj import demos
from magical_mj.baselines.settings import TrainingSettings
from magical_mj.errors import DemonstrationError


class Batch(NamedTuple):
    """Samples on the CPU: rows of stacks, what was done, and the task it was done for."""

    images: NDArray[np.uint8]
    """Shape (n, 96, 96, 12)."""
    actions: Tensor
    """Shape (n,) int64."""
    tasks: Tensor
    """Shape (n,) int64: numbers in the order of the settings."""


def drawn(task: str, seed: int, count: int, of: int) -> list[int]:
    """Which of a task's demonstrations a run learns from: the same for every method with this seed."""
    if count > of:
        raise DemonstrationError(f"{count} demonstrations of {task} are asked for, and there are {of}")
    rng = np.random.default_rng([seed, zlib.crc32(task.encode())])
    return sorted(rng.choice(of, count, replace=False).tolist())


def shares(size: int, tasks: int, generator: torch.Generator) -> list[int]:
    """How many samples of each task make a batch: they differ by one at most, and those that get one more are drawn."""
    found = [size // tasks] * tasks
    for extra in torch.randperm(tasks, generator=generator)[: size % tasks].tolist():
        found[extra] += 1
    return found


class Dataset:
    """All transitions of a run's demonstrations, and batches in which every task counts equally.

    Args:
        settings: whose tasks, seed, preset and number of demonstrations are used.
        drop_noop: leave out the transitions in which nothing was done.
        folder: of demonstrations, instead of the shipped ones.
    """

    def __init__(self, settings: TrainingSettings, *, drop_noop: bool, folder: Path | None = None) -> None:
        self._images: list[NDArray[np.uint8]] = []
        self._actions: list[Tensor] = []
        for task in settings.tasks:
            found = demos.load(task, folder)
            chosen = [found[number] for number in drawn(task, settings.seed, settings.demonstrations, len(found))]
            images, actions = demos.transitions(chosen, settings.preset, drop_noop=drop_noop)
            self._images.append(np.asarray(images))
            self._actions.append(torch.as_tensor(actions.astype(np.int64)))

    @property
    def sizes(self) -> list[int]:
        """The number of transitions of each task."""
        return [len(actions) for actions in self._actions]

    def sample(self, size: int, generator: torch.Generator) -> Batch:
        """Draws with replacement, evenly over the tasks."""
        draws = zip(self.sizes, shares(size, len(self.sizes), generator), strict=True)
        return self.rows([torch.randint(total, (share,), generator=generator) for total, share in draws])

    def rows(self, numbers: Sequence[Tensor]) -> Batch:
        """Given rows of each task, one task after the other."""
        return Batch(
            np.concatenate([images[rows.numpy()] for images, rows in zip(self._images, numbers, strict=True)]),
            torch.cat([actions[rows] for actions, rows in zip(self._actions, numbers, strict=True)]),
            torch.cat([torch.full_like(rows, task) for task, rows in enumerate(numbers)]),
        )


class Rollout(NamedTuple):
    """What the policy has just done, copy by copy."""

    images: NDArray[np.uint8]
    """Shape (steps, environments, 96, 96, 12)."""
    actions: NDArray[np.int64]
    """Shape (steps, environments)."""
    tasks: NDArray[np.int64]
    """Shape (environments,), ascending."""

    def sample(self, size: int, generator: torch.Generator) -> Batch:
        """Draws with replacement, evenly over the tasks."""
        parts = shares(size, int(self.tasks[-1]) + 1, generator)
        copies = np.repeat(np.arange(len(parts)), parts) * (len(self.tasks) // len(parts))
        copies += torch.randint(len(self.tasks) // len(parts), (size,), generator=generator).numpy()
        steps = torch.randint(len(self.images), (size,), generator=generator).numpy()
        return self._batch(steps, copies)

    def batches(self, size: int) -> Iterator[Batch]:
        """All of it in order, the steps one after the other."""
        for numbers in np.split(np.arange(self.actions.size), range(size, self.actions.size, size)):
            yield self._batch(*np.divmod(numbers, len(self.tasks)))

    def _batch(self, steps: NDArray[np.int64], copies: NDArray[np.int64]) -> Batch:
        actions, tasks = torch.as_tensor(self.actions[steps, copies]), torch.as_tensor(self.tasks[copies])
        return Batch(self.images[steps, copies], actions, tasks)
