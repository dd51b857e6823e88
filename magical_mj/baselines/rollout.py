"""What the policy has just done: for PPO's minibatches, and for the discriminator's batches."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.buffers import DictRolloutBuffer
from stable_baselines3.common.type_aliases import DictRolloutBufferSamples

from magical_mj.baselines.data import Batch, shares


class EvenBuffer(DictRolloutBuffer):
    """A rollout whose minibatches are split evenly between the tasks, and drawn by a generator of our own.

    Attributes:
        tasks: numbers of the copies' tasks, ascending; every task has as many copies.
        generator: draws the minibatches.
    """

    def __init__(self, *sizes: Any, tasks: NDArray[np.int64], generator: torch.Generator, **others: Any) -> None:
        super().__init__(*sizes, **others)
        self.tasks, self.generator = tasks, generator

    def get(self, batch_size: int | None = None) -> Iterator[DictRolloutBufferSamples]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """All samples once, in minibatches in which the tasks' shares differ by one at most."""
        count = int(self.tasks[-1]) + 1
        each = self.buffer_size * self.n_envs // count
        drawn = [torch.randperm(each, generator=self.generator) + task * each for task in range(count)]
        order = torch.stack(drawn, dim=1).flatten()  # one of each task, and again
        for numbers in order.split(batch_size or len(order)):
            copies, steps = np.divmod(numbers.numpy(), self.buffer_size)
            yield DictRolloutBufferSamples(
                observations={key: self.to_torch(seen[steps, copies]) for key, seen in self.observations.items()},
                actions=self.to_torch(self.actions[steps, copies]),
                old_values=self.to_torch(self.values[steps, copies]),
                old_log_prob=self.to_torch(self.log_probs[steps, copies]),
                advantages=self.to_torch(self.advantages[steps, copies]),
                returns=self.to_torch(self.returns[steps, copies]),
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
