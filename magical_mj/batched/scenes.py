"""Scenes of a batch as arrays, a row for each world; sampled when they are needed, or ahead by worker processes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, fields
from functools import partial
from itertools import groupby
from operator import itemgetter
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.region import DASHES, dash_quads
from magical_mj.scene import Dynamics, Scene
from magical_mj.scene.arrays import SceneArrays
from magical_mj.scene.state_vector import MAX_BLOCKS, MAX_REGIONS
from magical_mj.tasks.registry import Pair, sample_scene, task_spec
from magical_mj.utils.parallel import Pool
from magical_mj.variants import varied_axes

CHUNK: Final = 64
"""Scenes that one worker samples at a time: one takes half a millisecond."""


class Capacity(NamedTuple):
    """How much the worlds of a batch can hold; at least one of each, for empty arrays have no place in memory."""

    blocks: int
    regions: int

    @classmethod
    def of(cls, scenes: Sequence[Scene]) -> Capacity:
        """What these scenes need."""
        return cls(
            blocks=max(1, *(len(scene.blocks) for scene in scenes)),
            regions=max(1, *(len(scene.regions) for scene in scenes)),
        )

    @classmethod
    def of_environments(cls, pairs: Sequence[Pair]) -> Capacity:
        """What all scenes of these environments need."""
        if any("count" in varied_axes(task_spec(task), variant) for task, variant in pairs):
            return cls(MAX_BLOCKS, MAX_REGIONS)
        return cls.of([sample_scene(task, "Demo", 0) for task in dict.fromkeys(task for task, _ in pairs)])


@dataclass(frozen=True)
class WorldScenes(SceneArrays):
    """The scenes of a batch with all that physics and pictures are made from, in numpy's arrays.

    Attributes:
        fingers: angles of the left and the right finger. Shape (worlds, 2).
        dynamics: the five force caps, in the order of `Dynamics`. Shape (worlds, 5).
        dashes: the rectangles of each region's border, x_min, y_min, x_max, y_max. Shape (worlds, regions, DASHES, 4).
    """

    fingers: NDArray[np.float64]
    dynamics: NDArray[np.float64]
    dashes: NDArray[np.float32]

    @classmethod
    def of(cls, scenes: Sequence[Scene], blocks: int, regions: int) -> WorldScenes:
        """These scenes; raises `InvalidSceneError` if one has more blocks or regions than that."""
        plain = SceneArrays.of(scenes, blocks, regions)
        dashes = np.zeros((len(scenes), regions, DASHES, 4), np.float32)
        for world, scene in enumerate(scenes):
            for slot, region in enumerate(scene.regions):
                quads = dash_quads(region)  # rectangles along the axes
                dashes[world, slot, : len(quads)] = np.concatenate([quads.min(axis=1), quads.max(axis=1)], axis=1)
        caps = [[getattr(scene.dynamics, entry.name) for entry in fields(Dynamics)] for scene in scenes]
        fingers = np.array([scene.robot.fingers for scene in scenes])
        return cls(**vars(plain), fingers=fingers, dynamics=np.array(caps), dashes=dashes)

    def write(self, other: WorldScenes, worlds: NDArray[np.int64]) -> None:
        """Puts other scenes into these worlds."""
        for entry in fields(self):
            getattr(self, entry.name)[worlds] = getattr(other, entry.name)


def sample(pairs: Sequence[Pair], seeds: Sequence[int], capacity: Capacity) -> WorldScenes:
    """The scenes `sample_scene(task, variant, seed)`."""
    scenes = [sample_scene(task, variant, seed) for (task, variant), seed in zip(pairs, seeds, strict=True)]
    return WorldScenes.of(scenes, *capacity)


class SceneSampler:
    """Samples the scenes of a batch; an episode's depends on the seed, the world's number and the episode's alone.

    Args:
        pairs: task and variant of each world.
        capacity: of the arrays.
        workers: processes that sample ahead, started when they are needed; 0 samples when scenes are needed.
    """

    def __init__(self, pairs: Sequence[Pair], capacity: Capacity, workers: int = 0) -> None:
        self._pairs, self._capacity, self._workers = pairs, capacity, workers
        self._seed = 0
        self._episodes = [0] * len(pairs)
        self._pool: Pool | None = None
        self._ahead: dict[int, tuple[Future[WorldScenes], int]] = {}  # by world: its scene to come, and the row

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

    def scenes(self, worlds: Sequence[int], seeds: Sequence[int] | None = None) -> WorldScenes:
        """Scenes for these worlds, in their order; with workers, those to come after them are begun.

        Args:
            worlds: their numbers.
            seeds: of the scenes; None: each world's next one.
        """
        if seeds is not None or not self._workers:
            scenes = sample([self._pairs[world] for world in worlds], seeds or self._seeds(worlds), self._capacity)
        else:
            self._prepare(worlds)
            scenes = self._prepared(worlds)
        if seeds is None:
            for world in worlds:
                self._episodes[world] += 1
        if self._workers:
            self._prepare(worlds)
        return scenes

    def _seeds(self, worlds: Sequence[int]) -> list[int]:
        keys = ((world, self._episodes[world]) for world in worlds)
        return [int(np.random.SeedSequence(self._seed, spawn_key=key).generate_state(1, np.uint64)[0]) for key in keys]

    def _prepare(self, worlds: Sequence[int]) -> None:
        """Has the next scenes of these worlds sampled, unless they are already."""
        self._pool = self._pool or Pool(self._workers)
        missing = [world for world in worlds if world not in self._ahead]
        for first in range(0, len(missing), CHUNK):
            chunk = missing[first : first + CHUNK]
            work = partial(sample, [self._pairs[world] for world in chunk], capacity=self._capacity)
            future = self._pool.submit(work, self._seeds(chunk))
            self._ahead |= {world: (future, row) for row, world in enumerate(chunk)}

    def _prepared(self, worlds: Sequence[int]) -> WorldScenes:
        """The scenes that were prepared for these worlds."""
        sampled = groupby((self._ahead.pop(world) for world in worlds), key=itemgetter(0))
        parts = [future.result()[np.array([row for _, row in rows])] for future, rows in sampled]
        names = [entry.name for entry in fields(WorldScenes)]
        return WorldScenes(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})

    def close(self) -> None:
        """Ends the workers; may be called twice."""
        if self._pool:
            self._pool.close()
