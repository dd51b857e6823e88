"""Scenes of a batch as arrays with a row for each environment, sampled on demand or in advance by worker processes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import astuple, dataclass, fields
from functools import partial
from itertools import groupby
from operator import itemgetter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.region import DASHES, region_corners
from magical_mj.observations import MAX_BLOCKS, MAX_REGIONS
from magical_mj.scene import Block, Dynamics, GoalRegion, Robot, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.bodies import GRIPPER
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.tasks.registry import Pair, sample_scene, task_spec
from magical_mj.utils.errors import InvalidSceneError
from magical_mj.utils.parallel import Pool
from magical_mj.variants import varied_axes

CHUNK: Final = 64
"""The number of scenes in a worker's job. One scene takes half a millisecond."""

ABSENT: Final = -1
"""The shape of an empty block slot, and the colour of an empty region slot."""


Capacity = tuple[int, int]
"""The numbers of slots for blocks and for regions in each environment of a batch. Each is at least 1, since empty
arrays have no memory."""


def capacity_for(scenes: Sequence[Scene]) -> Capacity:
    """The capacity that these scenes need."""
    return max(1, *(len(scene.blocks) for scene in scenes)), max(1, *(len(scene.regions) for scene in scenes))


def capacity_of_environments(pairs: Sequence[Pair]) -> Capacity:
    """The capacity that all scenes of these environments need."""
    if any("count" in varied_axes(task_spec(task), variant) for task, variant in pairs):
        return MAX_BLOCKS, MAX_REGIONS
    return capacity_for([sample_scene(task, "Demo", 0) for task in dict.fromkeys(task for task, _ in pairs)])


def _check_simulated(scene: Scene) -> None:
    """Raises `InvalidSceneError` unless the scene has the benchmark's robot, blocks, borders and arena."""
    plain = {
        f"the body {scene.robot.body!r}": scene.robot.body == GRIPPER,
        "blocks of other masses": all(block.mass == c.BLOCK_MASS for block in scene.blocks),
        "solid borders": all(region.border == "dashed" for region in scene.regions),
        "pebbles (the shift clutter)": not scene.pebbles,
        "unequal wheels (the shift slip)": not scene.dynamics.veer,
        f"an arena of half width {scene.half_width:g}": scene.half_width == c.ARENA_HALF_WIDTH,
    }
    other = [what for what, is_plain in plain.items() if not is_plain]
    if other:
        raise InvalidSceneError(
            f"batched environments do not support {' or '.join(other)}; use gymnasium.make or make_vec"
        )


@dataclass(frozen=True)
class BatchScenes:
    """The scenes of a batch as arrays. All have the same slots. Unused slots are `ABSENT` and zero.

    Attributes:
        poses: x, y, angle of the robot and then of each block. Shape (envs, 1 + blocks, 3).
        shapes: indices into `SHAPES`. Shape (envs, blocks).
        colours: indices into `COLOURS`. Shape (envs, blocks).
        regions: x_min, y_min, x_max, y_max. Shape (envs, regions, 4).
        region_colours: indices into `COLOURS`. Shape (envs, regions).
        fingers: angles of the left and the right finger. Shape (envs, 2).
        dynamics: the five force caps, in the order of `Dynamics`. Shape (envs, 5).
        quads: the corners of each region's fill and of its border's dashes, x and y. Unused quads are points. Shape
            (envs, regions, 1 + DASHES, 4, 2).
    """

    poses: NDArray[np.float64]
    shapes: NDArray[np.int32]
    colours: NDArray[np.int32]
    regions: NDArray[np.float64]
    region_colours: NDArray[np.int32]
    fingers: NDArray[np.float64]
    dynamics: NDArray[np.float64]
    quads: NDArray[np.float32]

    @classmethod
    def of(cls, scenes: Sequence[Scene], blocks: int, regions: int) -> BatchScenes:
        """These scenes as arrays. Raises an `InvalidSceneError` if one does not fit or is not supported."""
        envs = len(scenes)
        for scene in scenes:
            _check_simulated(scene)
        arrays = cls(
            poses=np.zeros((envs, 1 + blocks, 3)),
            shapes=np.full((envs, blocks), ABSENT, np.int32),
            colours=np.zeros((envs, blocks), np.int32),
            regions=np.zeros((envs, regions, 4)),
            region_colours=np.full((envs, regions), ABSENT, np.int32),
            fingers=np.array([scene.robot.fingers for scene in scenes]),
            dynamics=np.array([astuple(scene.dynamics)[:-1] for scene in scenes]),  # without `veer`
            quads=np.zeros((envs, regions, 1 + DASHES, 4, 2), np.float32),
        )
        for env, scene in enumerate(scenes):
            if len(scene.blocks) > blocks or len(scene.regions) > regions:
                raise InvalidSceneError(
                    f"a scene with {len(scene.blocks)} blocks and {len(scene.regions)} regions does not fit in "
                    f"{blocks} and {regions} slots"
                )
            arrays.poses[env, 0] = scene.robot.pose
            for slot, block in enumerate(scene.blocks):
                arrays.poses[env, 1 + slot] = block.pose
                arrays.shapes[env, slot] = SHAPES.index(block.shape)
                arrays.colours[env, slot] = COLOURS.index(block.colour)
            for slot, region in enumerate(scene.regions):
                arrays.regions[env, slot] = region.box
                arrays.region_colours[env, slot] = COLOURS.index(region.colour)
                for first, count in ((0, 1), (1, DASHES)):
                    corners = region_corners(region, slot, count)[:, :2].reshape(count, 4, 2)
                    arrays.quads[env, slot, first : first + count] = corners
        return arrays

    @classmethod
    def named(cls, arrays: EpisodeArrays) -> BatchScenes:
        """The scenes whose fields are among these arrays."""
        return cls(**{field.name: arrays[field.name] for field in fields(cls)})

    def __getitem__(self, envs: NDArray[np.int64]) -> BatchScenes:
        """The scenes of these environments, in this order."""
        return BatchScenes(**{name: values[envs] for name, values in vars(self).items()})

    def scene(self, env: int, poses: NDArray[np.float64] | None = None) -> Scene:
        """The scene of an environment, optionally with other poses of the robot and the slots, (1 + blocks, 3)."""
        robot, *poses_of_blocks = (self.poses[env] if poses is None else poses).tolist()
        blocks = zip(self.shapes[env].tolist(), self.colours[env].tolist(), poses_of_blocks, strict=True)
        regions = zip(self.region_colours[env].tolist(), self.regions[env].tolist(), strict=True)
        return Scene(
            robot=Robot(*robot, fingers=self.fingers[env].tolist()),
            blocks=tuple(Block(SHAPES[shape], COLOURS[colour], *pose) for shape, colour, pose in blocks if shape >= 0),
            regions=tuple(GoalRegion(COLOURS[colour], *box) for colour, box in regions if colour >= 0),
            dynamics=Dynamics(*self.dynamics[env].tolist()),
        )

    def write(self, other: BatchScenes, envs: NDArray[np.int64]) -> None:
        """Replaces the scenes of these environments."""
        for name, values in vars(self).items():
            values[envs] = getattr(other, name)


EpisodeArrays = dict[str, NDArray[Any]]
"""Arrays by name, with a row for each environment: the fields of `BatchScenes`, and what observations need."""
Prepare = Callable[[BatchScenes, Sequence[int]], EpisodeArrays]
"""Computes what observations need of episodes with these scenes and seeds."""
Row = tuple["Future[EpisodeArrays]", int]
"""Episodes that a worker samples, and the row of one of them."""


def sample(pairs: Sequence[Pair], capacity: Capacity, prepare: Prepare, seeds: Sequence[int]) -> EpisodeArrays:
    """The episodes that start in `sample_scene(task, variant, seed)`."""
    drawn = [sample_scene(task, variant, seed) for (task, variant), seed in zip(pairs, seeds, strict=True)]
    scenes = BatchScenes.of(drawn, *capacity)
    return {**vars(scenes), **prepare(scenes, seeds)}


class Sampler:
    """Samples the episodes of a batch. They depend only on the seed, the environment's number and the episode's number.

    Workers are started when they are first needed, and sample in advance. Without workers, episodes are sampled on
    demand.
    """

    def __init__(self, pairs: Sequence[Pair], capacity: Capacity, prepare: Prepare, workers: int = 0) -> None:
        self._pairs, self._capacity, self._prepare, self._workers = pairs, capacity, prepare, workers
        self._seed = 0
        self._episodes = [0] * len(pairs)
        self._pool: Pool | None = None
        self._ahead: dict[int, Row] = {}
        """Environment -> its next episode."""

    def seed(self, seed: int) -> None:
        """Restarts the sequences of all environments with this seed."""
        for future, _ in self._ahead.values():
            future.cancel()
        self._seed, self._episodes, self._ahead = seed, [0] * len(self._pairs), {}

    def get_state(self) -> dict[str, Any]:
        """The seed and the next episode's number of each environment."""
        return {"seed": self._seed, "episodes": list(self._episodes)}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restores a state."""
        self.seed(state["seed"])
        self._episodes = list(state["episodes"])

    def episodes(self, envs: Sequence[int], seeds: Sequence[int] | None = None) -> tuple[list[int], EpisodeArrays]:
        """The seeds and arrays of episodes for these environments: of these seeds, or each environment's next one.

        With workers, starts to sample the following ones.
        """
        chosen = self.next_seeds(envs) if seeds is None else list(seeds)
        if not self._workers or (seeds is not None and len(envs) <= CHUNK):
            arrays = sample([self._pairs[env] for env in envs], self._capacity, self._prepare, chosen)
        elif seeds is None:
            self._start(envs)
            arrays = _joined([self._ahead.pop(env) for env in envs])
        else:
            arrays = _joined(list(self._submitted(envs, chosen).values()))
        if seeds is None:
            for env in envs:
                self._episodes[env] += 1
        if self._workers:
            self._start(envs)
        return chosen, arrays

    def next_seeds(self, envs: Sequence[int]) -> list[int]:
        """The seeds of the next episodes of these environments."""
        keys = ((env, self._episodes[env]) for env in envs)
        return [int(np.random.SeedSequence(self._seed, spawn_key=key).generate_state(1, np.uint64)[0]) for key in keys]

    def _start(self, envs: Sequence[int]) -> None:
        """Starts to sample the next episodes of these environments, unless this has been done."""
        missing = [env for env in envs if env not in self._ahead]
        self._ahead |= self._submitted(missing, self.next_seeds(missing))

    def _submitted(self, envs: Sequence[int], seeds: Sequence[int]) -> dict[int, Row]:
        """Lets the workers sample an episode of these seeds for each of these environments."""
        self._pool = self._pool or Pool(self._workers)
        submitted: dict[int, Row] = {}
        for first in range(0, len(envs), CHUNK):
            chunk = envs[first : first + CHUNK]
            work = partial(sample, [self._pairs[env] for env in chunk], self._capacity, self._prepare)
            future = self._pool.submit(work, seeds[first : first + CHUNK])
            submitted |= {env: (future, row) for row, env in enumerate(chunk)}
        return submitted

    def close(self) -> None:
        """Stops the workers. May be called twice."""
        if self._pool:
            self._pool.close()


def _joined(rows: Sequence[Row]) -> EpisodeArrays:
    """The arrays with these rows."""
    parts = [(future.result(), [row for _, row in group]) for future, group in groupby(rows, key=itemgetter(0))]
    return {name: np.concatenate([arrays[name][chosen] for arrays, chosen in parts]) for name in parts[0][0]}
