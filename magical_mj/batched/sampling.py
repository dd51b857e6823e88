"""Scenes for the episodes to come, sampled ahead by worker processes: one takes half a millisecond."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import fields
from functools import partial
from itertools import groupby
from operator import itemgetter
from typing import Any

import numpy as np

from magical_mj.batched.scenes import Capacity, SceneArrays
from magical_mj.tasks.registry import Pair, sample_scene
from magical_mj.utils.parallel.local import Pool

CHUNK = 64
"""Scenes that one worker samples at a time."""


def sample(pairs: Sequence[Pair], seeds: Sequence[int], capacity: Capacity) -> SceneArrays:
    """The scenes `sample_scene(task, variant, seed)`."""
    scenes = [sample_scene(task, variant, seed) for (task, variant), seed in zip(pairs, seeds, strict=True)]
    return SceneArrays.of(scenes, capacity)


class SceneSampler:
    """Samples the scenes of a batch; an episode's depends on the seed, the world's number and the episode's alone.

    Args:
        pairs: task and variant of each world.
        capacity: of the arrays.
        workers: processes that sample ahead; 0 samples when scenes are needed.
    """

    def __init__(self, pairs: Sequence[Pair], capacity: Capacity, workers: int = 0) -> None:
        self._pairs, self._capacity = pairs, capacity
        self._seed = 0
        self._episodes = [0] * len(pairs)
        self._pool = Pool(workers) if workers else None
        self._ahead: dict[int, tuple[Future[SceneArrays], int]] = {}  # by world: its scene to come, and the row

    def seed(self, seed: int) -> None:
        """Starts the seeds of all episodes anew."""
        for future, _ in self._ahead.values():
            future.cancel()
        self._seed, self._episodes, self._ahead = seed, [0] * len(self._pairs), {}

    def get_state(self) -> dict[str, Any]:
        """Of which episodes the next scenes are."""
        return {"seed": self._seed, "episodes": list(self._episodes)}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Goes back to a state."""
        self.seed(state["seed"])
        self._episodes = list(state["episodes"])

    def scenes(self, worlds: Sequence[int], seeds: Sequence[int] | None = None) -> SceneArrays:
        """Scenes for these worlds, in their order; with workers, those to come after them are begun.

        Args:
            worlds: their numbers.
            seeds: of the scenes; None: each world's next one.
        """
        if seeds is not None or self._pool is None:
            made = sample([self._pairs[world] for world in worlds], seeds or self._seeds(worlds), self._capacity)
        else:
            self._prepare(self._pool, worlds)
            made = self._prepared(worlds)
        if seeds is None:
            for world in worlds:
                self._episodes[world] += 1
        if self._pool:
            self._prepare(self._pool, worlds)
        return made

    def _seeds(self, worlds: Sequence[int]) -> list[int]:
        keys = ((world, self._episodes[world]) for world in worlds)
        return [int(np.random.SeedSequence(self._seed, spawn_key=key).generate_state(1, np.uint64)[0]) for key in keys]

    def _prepare(self, pool: Pool, worlds: Sequence[int]) -> None:
        """Has the next scenes of these worlds sampled, unless they are already."""
        missing = [world for world in worlds if world not in self._ahead]
        for first in range(0, len(missing), CHUNK):
            some = missing[first : first + CHUNK]
            work = partial(sample, [self._pairs[world] for world in some], capacity=self._capacity)
            future = pool.submit(work, self._seeds(some))
            self._ahead |= {world: (future, row) for row, world in enumerate(some)}

    def _prepared(self, worlds: Sequence[int]) -> SceneArrays:
        """The scenes that were prepared for these worlds."""
        sampled = groupby((self._ahead.pop(world) for world in worlds), key=itemgetter(0))
        return joined([future.result().rows(np.array([row for _, row in rows])) for future, rows in sampled])

    def close(self) -> None:
        """Ends the workers; may be called twice."""
        if self._pool:
            self._pool.close()


def joined(parts: Sequence[SceneArrays]) -> SceneArrays:
    """Several arrays as one."""
    return SceneArrays(
        *(np.concatenate([getattr(part, entry.name) for part in parts]) for entry in fields(SceneArrays))
    )
