"""Batches of samples from a run's demonstrations, and from the policy's latest rollout."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_mj import demos
from magical_mj.actions import ACTIONS, NOOP
from magical_mj.demos import Demonstration, Transitions
from magical_mj.demos.learning import observations as observations_of
from magical_mj.demos.shipped import DemonstrationSet, of_demo_scene
from magical_mj.learners.networks import SHAPE
from magical_mj.learners.settings import TrainingSettings
from magical_mj.observations import STATE_NAMES
from magical_mj.policies.interface import histories
from magical_mj.scene.bodies import GRIPPER
from magical_mj.utils.errors import DemonstrationError, short_repr

Demonstrations = Mapping[str, Sequence[Demonstration | Transitions]]
"""Task -> the transitions of each demonstration, no-ops included, with the observations of the run's preset."""


class Batch(NamedTuple):
    """Samples on the CPU: observations, actions, and the numbers of their tasks."""

    observations: Tensor
    """Stacks of frames, shape (n, 96, 96, 12) uint8; or histories of states, shape (n, HISTORY, names) float32."""
    actions: Tensor
    """Shape (n,) int64."""
    tasks: Tensor
    """Shape (n,) int64: numbers in the order of the settings."""


FEW: Final = 10
"""The default number of shipped demonstrations of each task for training, as in the paper."""


def drawn(task: str, seed: int, count: int, of: int) -> list[int]:
    """The numbers of the task's demonstrations that a run uses. They depend on the seed, not on the method."""
    if count > of:
        raise DemonstrationError(f"the setting demonstrations is {count}, but there are {of} demonstrations of {task}")
    rng = np.random.default_rng([seed, zlib.crc32(task.encode())])
    return sorted(rng.choice(of, count, replace=False).tolist())


def shares(size: int, tasks: int, generator: torch.Generator) -> list[int]:
    """The number of samples of each task in a batch. They differ by at most one. The tasks with one more are random."""
    counts = [size // tasks] * tasks
    for extra in torch.randperm(tasks, generator=generator)[: size % tasks].tolist():
        counts[extra] += 1
    return counts


def to_choose_from(settings: TrainingSettings, task: str) -> list[Demonstration]:
    """The demonstrations of a task's demo scene, from the folder in the settings, or those shipped with the task.

    Raises:
        DemonstrationError: if none is found.
    """
    if settings.recordings:
        return of_demo_scene(demos.load(task, settings.recordings), f"of {task} in {settings.recordings}")
    known = demos.load(task, set=cast("DemonstrationSet", settings.demos.set))
    return of_demo_scene(known, f"that come with {task}")


def chosen(settings: TrainingSettings, task: str) -> list[Demonstration]:
    """A run's demonstrations of a task.

    Raises:
        DemonstrationError: if none is found, or fewer than the number in the settings.
    """
    every = to_choose_from(settings, task)
    count = settings.demonstrations or (len(every) if settings.recordings else min(FEW, len(every)))
    return [every[number] for number in drawn(task, settings.seed, count, len(every))]


def digest(settings: TrainingSettings) -> str:
    """The SHA-256 hash of the user's demonstrations in a run. Empty if it uses the package's."""
    if not settings.recordings:
        return ""
    parts = (demo.digest for task in settings.tasks for demo in chosen(settings, task))
    return hashlib.sha256("".join(parts).encode()).hexdigest()


def _given(
    settings: TrainingSettings, task: str, demonstrations: Demonstrations
) -> Sequence[Demonstration | Transitions]:
    """The given demonstrations for training: all, or the number in the settings."""
    listed = demonstrations.get(task) if isinstance(demonstrations, Mapping) else None
    if listed is None or isinstance(listed, Demonstration | Transitions):
        raise DemonstrationError(
            f"give a list of demonstrations for each task, as in {{{task!r}: [...]}}, not {short_repr(demonstrations)}"
        )
    varied = any(isinstance(demo, Demonstration) and demo.demonstrator == "diverse" for demo in listed)
    if varied and settings.demos.set != 2:
        raise DemonstrationError(
            f"demonstrations given for {task} are of set 2: give settings with demos.set=2, so that evaluations of the "
            "policy record it"
        )
    count = settings.demonstrations or len(listed)
    return [listed[number] for number in drawn(task, settings.seed, count, len(listed))]


def _episode(
    task: str, demonstration: Demonstration | Transitions, settings: TrainingSettings, drop_noop: bool
) -> tuple[NDArray[Any], NDArray[np.uint8]]:
    if isinstance(demonstration, Demonstration):
        if demonstration.task != task:
            raise DemonstrationError(f"a demonstration given for {task} is of {demonstration.task}")
        if demonstration.scene.robot.body != GRIPPER:
            raise DemonstrationError(
                f"a demonstration given for {task} is by the body {demonstration.scene.robot.body!r}, but learners use "
                f"the {GRIPPER}"
            )
        rows: Any = observations_of(demonstration, settings.preset, settings.renderer)
        demonstration = Transitions(rows[:-1], demonstration.actions)  # no action follows the last observation
    observations, actions = np.asarray(demonstration.observations), np.asarray(demonstration.actions)
    needed = (len(actions), len(STATE_NAMES)) if settings.states else (len(actions), *SHAPE)
    if actions.ndim != 1 or observations.shape != needed:
        raise DemonstrationError(
            f"a demonstration of {task} for the preset {settings.preset} needs the observation before each action, "
            f"{needed}, but it has observations {observations.shape} and actions {actions.shape}"
        )
    if settings.states and not (observations.dtype.kind == "f" and np.isfinite(observations).all()):
        raise DemonstrationError(f"states must be finite floats; a demonstration of {task} contains others")
    if not settings.states and observations.dtype != np.uint8:
        raise DemonstrationError(
            f"pictures must be uint8, from 0 to 255, as environments return them; a demonstration of {task} has "
            f"{observations.dtype}"
        )
    if actions.dtype.kind not in "iu" or not np.isin(actions, range(len(ACTIONS))).all():
        raise DemonstrationError(
            f"actions must be integers from 0 to {len(ACTIONS) - 1}; a demonstration of {task} contains others"
        )
    if settings.states:
        observations = histories(observations)
    kept = actions != NOOP if drop_noop else np.full(len(actions), True)
    return observations[kept], actions[kept]


class TrainingData:
    """All transitions of a run's demonstrations. Batches give all tasks the same weight.

    Args:
        settings: their tasks, seed, preset, and number and folder of demonstrations are used.
        drop_noop: leave out the transitions with the no-op action.
        demonstrations: task -> demonstrations, instead of those in the settings.

    Raises:
        DemonstrationError: if a task has too few demonstrations, or one of them does not fit the task or the preset.
    """

    def __init__(
        self, settings: TrainingSettings, *, drop_noop: bool, demonstrations: Demonstrations | None = None
    ) -> None:
        self._observations: list[Tensor] = []
        self.sizes: list[int] = []
        """The number of transitions of each task."""
        self.actions: list[Tensor] = []
        """All actions of each task, shape (n,)."""
        self.last: list[Tensor] = []
        """For each task, whether a transition is the last of its demonstration, bool, shape (n,)."""
        for task in settings.tasks:
            learnt = chosen(settings, task) if demonstrations is None else _given(settings, task, demonstrations)
            if not learnt:
                raise DemonstrationError(f"no demonstrations of {task} are given")
            episodes = [_episode(task, demonstration, settings, drop_noop) for demonstration in learnt]
            observations, actions = zip(*episodes, strict=True)
            self._observations.append(torch.as_tensor(np.concatenate(observations)))
            self.actions.append(torch.as_tensor(np.concatenate(actions).astype(np.int64)))
            ends = [torch.arange(len(taken)) == len(taken) - 1 for taken in actions]
            self.last.append(torch.cat(ends))
            self.sizes.append(len(self.actions[-1]))
            if not self.sizes[-1]:
                raise DemonstrationError(f"the demonstrations of {task} contain no actions except no-ops")

    def sample(self, size: int, generator: torch.Generator) -> Batch:
        """Draws with replacement, evenly over the tasks."""
        draws = zip(self.sizes, shares(size, len(self.sizes), generator), strict=True)
        return self.rows([torch.randint(total, (share,), generator=generator) for total, share in draws])

    def batches(self, size: int) -> Iterator[Batch]:
        """All transitions in order, in batches of at most `size`. Each batch is from one task."""
        for task, total in enumerate(self.sizes):
            for rows in torch.arange(total).split(size):
                yield self.rows([rows if other == task else rows[:0] for other in range(len(self.sizes))])

    def rows(self, indices: Sequence[Tensor]) -> Batch:
        """The rows with these indices, given for each task. The tasks follow one another."""
        return Batch(
            torch.cat([values.index_select(0, rows) for values, rows in zip(self._observations, indices, strict=True)]),
            torch.cat([actions[rows] for actions, rows in zip(self.actions, indices, strict=True)]),
            torch.cat([torch.full_like(rows, task) for task, rows in enumerate(indices)]),
        )


class Rollout(NamedTuple):
    """The policy's latest steps in all environments, on the CPU."""

    observations: Tensor
    """Shape (steps, environments, ...)."""
    actions: Tensor
    """Shape (steps, environments), int64."""
    tasks: Tensor
    """Shape (environments,), int64, ascending."""

    def sample(self, size: int, generator: torch.Generator) -> Batch:
        """Draws with replacement, evenly over the tasks."""
        parts = torch.tensor(shares(size, int(self.tasks[-1]) + 1, generator))
        copies = len(self.tasks) // len(parts)
        environments = torch.arange(len(parts)).repeat_interleave(parts) * copies
        environments += torch.randint(copies, (size,), generator=generator)
        steps = torch.randint(len(self.observations), (size,), generator=generator)
        return self._batch(steps * len(self.tasks) + environments)

    def batches(self, size: int) -> Iterator[Batch]:
        """All samples in the order of the steps."""
        for indices in torch.arange(self.actions.numel()).split(size):
            yield self._batch(indices)

    def _batch(self, indices: Tensor) -> Batch:
        observations = self.observations.flatten(0, 1).index_select(0, indices)  # faster than indexing
        return Batch(observations, self.actions.flatten()[indices], self.tasks[indices % len(self.tasks)])


def joined(rollouts: Sequence[Rollout]) -> Rollout:
    """Concatenates rollouts of the same environments."""
    if len(rollouts) == 1:
        return rollouts[0]
    observations = torch.cat([rollout.observations for rollout in rollouts])
    return Rollout(observations, torch.cat([rollout.actions for rollout in rollouts]), rollouts[0].tasks)
