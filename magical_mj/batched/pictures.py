"""Pictures of a batch: tables of the polygons of each environment, and the functions that draw them on its device.

The polygons are those of the software renderer, read from one compiled model with a block of each shape and colour and
a region of each colour. So pictures are the software renderer's to the byte, except where a corner is within rounding
(1e-16 world units) of the middle between two points of its grid.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from functools import cache
from itertools import product
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_mj.assets.region import DASHES
from magical_mj.assets.scene_model import scene_mjcf
from magical_mj.batched.frames import (
    BLOCKS,
    COSINE,
    LEFT_FINGER,
    RIGHT_FINGER,
    ROBOT,
    SINE,
    VISIBLE,
    WORLD,
    X,
    Y,
    frame_count,
    write_frames,
)
from magical_mj.batched.scenes import BatchScenes
from magical_mj.rendering.scanlines import BODY, FIRST, IS_SKIN, LAST, SOURCE, count_bare, draw_posed, packed_rgba
from magical_mj.rendering.software import polygons_of, scratch
from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.scene.state_vector import VIEWS
from magical_mj.shifts.drawn import Light
from magical_mj.shifts.episode import EpisodeShifts, draw_shifts
from magical_mj.shifts.shift import Frame
from magical_mj.utils.extras import check_module

Rows = NDArray[np.int32]
"""Rows of a table of polygons, see `scanlines.FIRST`. The column SOURCE is the polygon's entry of the palette."""
_NO_LIGHT: Final = np.zeros((0, 3)), np.zeros((0, 6))
QUADS: Final = 1 + DASHES
"""The number of quads of a region: its fill and its border."""
_BODIES: Final = {
    "world": WORLD,
    "face": ROBOT,
    "left_finger": LEFT_FINGER,
    "right_finger": RIGHT_FINGER,
}


class Library(NamedTuple):
    """The polygons of everything that a scene may contain."""

    model: mujoco.MjModel
    """The model with a block of each shape and colour and a region of each colour."""
    sources: NDArray[np.int64]
    """The geoms and, as negative numbers -1 - skin, the skins of the palette's entries after the first, in order."""
    corners: NDArray[np.float64]
    """The corners of geoms. Shape (n, 2)."""
    arena: Rows
    blocks: list[list[Rows]]
    """Of each shape and colour. The column BODY is 0."""
    regions: list[tuple[int, int]]
    """Of each colour: the palette's entries of fill and border."""
    robot: Rows


@cache
def library() -> Library:
    """Compiles the model and reads its polygons."""
    kinds = enumerate(product(SHAPES, COLOURS))
    blocks = tuple(Block(shape, colour, 2.0 * slot, 0.0, 0.0) for slot, (shape, colour) in kinds)
    regions = tuple(GoalRegion(colour, 0.0, 0.0, 0.5, 0.5) for colour in COLOURS)
    model = mujoco.MjModel.from_xml_string(scene_mjcf(Scene(Robot(0.0, 0.0, 0.0), blocks, regions)))
    table, corners, _ = polygons_of(model)
    signed = np.where(table[:, IS_SKIN] == 1, -1 - table[:, SOURCE], table[:, SOURCE]).astype(np.int64)
    sources, entry = np.unique(signed, return_inverse=True)
    table[:, SOURCE] = 1 + entry
    skins = {int(-1 - source): 1 + number for number, source in enumerate(sources) if source < 0}
    of_body: dict[str, list[NDArray[np.int32]]] = {}
    for row in table[table[:, IS_SKIN] == 0]:
        of_body.setdefault(mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, row[BODY]), []).append(row)
    parts = {name: np.array(rows) for name, rows in of_body.items()}
    for name, rows in parts.items():
        rows[:, BODY] = _BODIES.get(name, 0)
    return Library(
        model=model,
        sources=sources,
        corners=np.ascontiguousarray(corners),
        arena=parts.pop("world"),
        blocks=[
            [parts.pop(f"block{shape * len(COLOURS) + colour}") for colour in range(len(COLOURS))]
            for shape in range(len(SHAPES))
        ],
        regions=[(skins[2 * colour], skins[2 * colour + 1]) for colour in range(len(COLOURS))],
        robot=np.concatenate(list(parts.values())),
    )


class Tables(NamedTuple):
    """What is drawn in each environment of a batch, as arrays or tensors. They change at resets."""

    polygons: Any
    """Polygons in drawing order, see `Rows`. Unused rows have no corners. Shape (envs, polygons, 5), int32."""
    corners: Any
    """The corners of geoms, which all environments share. Shape (n, 2), float64."""
    quads: Any
    """The corners of regions. Shape (envs, quads, 2), float32."""
    palettes: Any
    """Opaque colours 0xAABBGGRR, or 0 for nothing. Shape (envs, entries), int64."""
    cameras: Any
    """See `frames.X`. Shape (envs, views, 5), float64."""
    places: Any
    """For each polygon, the number of corners before it in its environment. Shape (envs, polygons), int32."""
    grounds: Any
    """The levels of `EpisodeShifts.ground`, row by row. Shape (envs, levels), uint8; without shifts of it (0, 0)."""
    tones: Any
    """The arguments of `shifts.kernels.relight`, with an axis for the environments; without light of length 0."""
    slopes: Any
    """See `tones`."""
    bars: Any
    """See `tones`."""


def tables(scenes: BatchScenes, episodes: Sequence[EpisodeShifts] = ()) -> Tables:
    """The tables of scenes, as arrays, with the shifts of their episodes, if any."""
    table = polygons(scenes)
    counts = table[..., LAST] - table[..., FIRST]
    models = [shifted_model(episode) for episode in episodes] or [library().model]
    every = len(table) // len(models)  # without shifts, all environments have the same colours and cameras
    lights = [light.numbers for episode in episodes if isinstance(light := episode.named("light"), Light)]
    grounds = [episode.ground(c.ARENA_HALF_WIDTH).reshape(-1) for episode in episodes if episode.changes_ground]
    tones, slopes, bars = zip(*lights, strict=True) if lights else (np.zeros((0, 3, 256), np.int32), *_NO_LIGHT)
    return Tables(
        polygons=table,
        corners=library().corners,
        quads=scenes.quads.reshape(len(table), -1, 2),
        palettes=np.stack([palette(model) for model in models] * every),
        cameras=np.stack([cameras(model) for model in models] * every),
        places=counts.cumsum(axis=-1, dtype=np.int32) - counts,
        grounds=np.stack(grounds) if grounds else np.zeros((0, 0), np.uint8),
        tones=np.asarray(tones),
        slopes=np.asarray(slopes),
        bars=np.asarray(bars),
    )


def shifted_model(episode: EpisodeShifts) -> mujoco.MjModel:
    """The library's model with the colours and cameras of an episode."""
    model = copy(library().model)
    episode.model(model)
    return model


def polygons(scenes: BatchScenes) -> Rows:
    """The polygons of each environment. Shape (envs, polygons, 5)."""
    parts, (envs, slots) = library(), scenes.shapes.shape
    most = max(len(rows) for shape in parts.blocks for rows in shape)
    regions = scenes.regions.shape[1]
    blocks = np.zeros((envs, slots, most, 5), np.int32)
    for shape, of_shape in enumerate(parts.blocks):
        for colour, rows in enumerate(of_shape):
            where = (scenes.shapes == shape) & (scenes.colours == colour)
            blocks[where, : len(rows)] = rows
    blocks[..., BODY] = (BLOCKS + np.arange(slots))[:, None]
    quads = np.zeros((envs, regions, QUADS, 5), np.int32)
    quads[..., FIRST] = 4 * np.arange(regions * QUADS).reshape(regions, QUADS)
    quads[..., LAST] = quads[..., FIRST] + np.where(scenes.region_colours >= 0, 4, 0)[..., None]
    entries = np.array([(fill, *[border] * DASHES) for fill, border in parts.regions])
    quads[..., SOURCE], quads[..., IS_SKIN] = entries[scenes.region_colours], 1
    drawn = (
        np.broadcast_to(parts.arena, (envs, *parts.arena.shape)),
        quads.reshape(envs, -1, 5),
        blocks.reshape(envs, -1, 5),
        np.broadcast_to(parts.robot, (envs, *parts.robot.shape)),
    )
    return np.concatenate(drawn, axis=1)


def most_corners(scenes: BatchScenes) -> int:
    """The most corners of an environment of any scenes with as many slots as these."""
    parts = library()
    counts = [int((rows[:, LAST] - rows[:, FIRST]).sum()) for shape in parts.blocks for rows in shape]
    static = sum(int((rows[:, LAST] - rows[:, FIRST]).sum()) for rows in (parts.arena, parts.robot))
    return static + 4 * QUADS * scenes.regions.shape[1] + scenes.shapes.shape[1] * max(counts)


def palette(model: mujoco.MjModel) -> NDArray[np.int64]:
    """The palette of a model like the library's. The first entry is nothing."""
    rgba = (model.geom_rgba[source] if source >= 0 else model.skin_rgba[-1 - source] for source in library().sources)
    return np.array([0, *map(packed_rgba, rgba)], np.int64)


def cameras(model: mujoco.MjModel) -> NDArray[np.float64]:
    """The cameras of a model like the library's. Shape (views, 5)."""
    table = np.empty((len(VIEWS), 5))
    for row, view in zip(table, VIEWS, strict=True):
        camera = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, view)
        (x, y, _), (w, _, _, z) = model.cam_pos[camera].tolist(), model.cam_quat[camera].tolist()
        row[[X, Y, COSINE, SINE, VISIBLE]] = x, y, w * w - z * z, 2 * w * z, model.cam_fovy[camera]
    return table


def check_accelerator(device: str) -> None:
    """Raises a `MissingExtraError` if the device is an accelerator and numba-cuda is not installed."""
    if torch.device(device).type != "cpu":
        check_module("pictures on an accelerator", "numba_cuda", "gpu")


class Painter:
    """Draws the environments of a batch on its device.

    Args:
        scenes: the scenes of all environments. Later ones must fit into as many slots.
        device: the device of all tensors.
        shifts: the strengths of shifts that are drawn.
        seeds: the seeds of the environments' first episodes, from which shifts draw their values.
    """

    def __init__(
        self,
        scenes: BatchScenes,
        device: str = "cpu",
        shifts: Mapping[str, int] = MappingProxyType({}),
        seeds: Sequence[int] = (),
    ) -> None:
        self._shifts = shifts
        self._episodes = [EpisodeShifts(draw_shifts(shifts, seed)) for seed in seeds if shifts]
        self._tables = Tables(*(torch.tensor(table, device=device) for table in tables(scenes, self._episodes)))
        self._all = torch.arange(len(scenes.shapes), device=device)
        self._canvas: Any = None
        if self._all.is_cuda:
            from magical_mj.batched.accelerator import Canvas  # numba-cuda is needed for accelerators only

            self._canvas = Canvas(self._tables, most_corners(scenes))

    def set_scenes(self, scenes: BatchScenes, envs: Tensor, seeds: Sequence[int] = ()) -> None:
        """Starts episodes with these scenes and seeds in some environments."""
        episodes = [EpisodeShifts(draw_shifts(self._shifts, seed)) for seed in seeds if self._shifts]
        for env, episode in zip(envs.tolist(), episodes, strict=False):
            self._episodes[env] = episode
        for name, rows in tables(scenes, episodes)._asdict().items():
            if name != "corners" and len(rows):
                table = getattr(self._tables, name)
                table[envs] = torch.from_numpy(rows).to(table)

    def set_steps(self, steps: Sequence[int]) -> None:
        """Tells shifts the number of steps of each environment's episode."""
        for episode, count in zip(self._episodes, steps, strict=False):
            episode.steps = count

    def draw(self, view: str, poses: Tensor, fingers: Tensor, out: Tensor, envs: Tensor | None = None) -> None:
        """Draws environments into their pictures in `out`, shape (all envs, size, size, 3), uint8.

        Args:
            view: "ego" or "allo".
            poses: x, y, angle of the robot and of each block in all environments. Shape (all envs, 1 + blocks, 3).
            fingers: angles of the left and the right finger. Shape (all envs, 2).
            out: the pictures.
            envs: the numbers of the environments to draw, int64; None: all.
        """
        envs, number = self._all if envs is None else envs, VIEWS.index(view)
        if self._canvas is not None:
            self._canvas.draw(poses, fingers, number, envs, out)
            return
        table, corners, quads, palettes, cameras = (tensor.numpy() for tensor in self._tables[:5])
        size, samples = out.shape[1], scratch(2 * out.shape[1])
        colours, frames = np.empty(table.shape[1], np.uint32), np.empty((frame_count(poses.shape[1] - 1), 4))
        exact_poses, exact_fingers, pictures = poses.double().numpy(), fingers.double().numpy(), out.numpy()
        for env in envs.tolist():
            camera, picture = cameras[env, number], pictures[env]
            write_frames(number, camera, exact_poses[env], exact_fingers[env], frames)
            scene, pairs = (table[env], corners, quads[env]), samples[0].view(np.uint64)
            draw_posed(scene, frames, camera[VISIBLE], samples, palettes[env], colours, pairs, picture)
            if self._episodes:
                episode, (x, y, cosine, sine) = self._episodes[env], frames[-1].tolist()
                bare = np.empty((size, size), np.uint8) if episode.changes_ground else None
                if bare is not None:
                    count_bare(samples[0], bare)
                frame = Frame(view, episode.steps, (x, y, math.atan2(sine, cosine), float(camera[VISIBLE])))
                picture[:] = episode.picture(picture, frame, bare, c.ARENA_HALF_WIDTH)
