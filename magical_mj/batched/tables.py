"""Constant parts of a batch's observations, as arrays, computed when scenes are sampled.

State vectors need their constant entries; pictures need polygons, colours, cameras, and the episodes' shifts.

The polygons are those of the software renderer, read from one compiled model with a block of each shape and colour and
a region of each colour. So pictures are the software renderer's to the byte, except where a corner is within rounding
(1e-16 world units) of the middle between two points of its grid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from functools import cache
from itertools import product
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.region import DASHES
from magical_mj.assets.scene_mjcf import scene_mjcf
from magical_mj.batched.frames import COSINE, FIRST_BLOCK, LEFT_FINGER, RIGHT_FINGER, SINE, VISIBLE, WORLD, X, Y
from magical_mj.batched.frames import ROBOT as ROBOT_BODY
from magical_mj.batched.scenes import BatchScenes, EpisodeArrays
from magical_mj.observations import VIEWS, StateEncoder
from magical_mj.rendering.scanlines import BODY, FIRST, IS_SKIN, LAST, SOURCE, packed_rgba
from magical_mj.rendering.software import BLOCK, FINGER, REGION, ROBOT, WALL, polygons_of
from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.shifts.drawn import LOSS, NOISE, NOISE_SAMPLES, Light, Sensor
from magical_mj.shifts.episode import EpisodeShifts, draw_shifts

Rows = NDArray[np.int32]
"""Rows of a table of polygons, see `scanlines.FIRST`. The column SOURCE is the polygon's entry of the palette."""
QUADS: Final = 1 + DASHES
"""The number of quads of a region: its fill and its border."""
_BODIES: Final = {"world": WORLD, "face": ROBOT_BODY, "left_finger": LEFT_FINGER, "right_finger": RIGHT_FINGER}


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
    """The polygons of a block of each shape and colour. The column BODY is 0."""
    regions: list[tuple[int, int]]
    """For each colour of a region: the palette's entries of its fill and border."""
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
    """What is drawn in each environment of a batch, as arrays or tensors. Most change at resets."""

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
    corner_offsets: Any
    """For each polygon, the number of corners before it in its environment. Shape (envs, polygons), int32."""
    segments: Any
    """The values of polygons in segmentations, which all environments share. Shape (polygons,), int64."""
    grounds: Any
    """The levels of `EpisodeShifts.ground`, row by row. Shape (envs, levels), uint8; without shifts of it (0, 0)."""
    tones: Any
    """The arguments of `shifts.kernels.relight`, with an axis for the environments; without light of length 0."""
    slopes: Any
    """See `tones`."""
    bars: Any
    """See `tones`."""


class Faults(NamedTuple):
    """The sensor's fault in each environment, see `drawn.Sensor`, as arrays or tensors. They change at resets."""

    sensors: Any
    """Fault, amount, and x and y of the dirt. Shape (envs, 4), float64."""
    noises: Any
    """The noise, where it is the fault. Shape (envs, NOISE_SAMPLES), int8."""
    chances: Any
    """The random number of each view after each number of steps. Shape (envs, views, steps), float64."""


def constant_states(scenes: BatchScenes, seeds: Sequence[int], *, start: bool) -> EpisodeArrays:
    """The array "fixed", the constant entries of the state vectors, see `StateEncoder`. Shape (envs, entries)."""
    del seeds
    encoders = (StateEncoder(scenes.scene(env), start=start) for env in range(len(scenes.poses)))
    return {"fixed": np.stack([encoder.fixed for encoder in encoders])}


def all_tables(scenes: BatchScenes, episodes: EpisodeArrays) -> EpisodeArrays:
    """All of `Tables`, and with the shift sensor all of `Faults`, for the first episodes, see `episode_tables`."""
    (envs, _), plain = scenes.shapes.shape, library()
    arrays = {
        "corners": plain.corners,
        "palettes": np.repeat(palette(plain.model)[None], envs, axis=0),
        "cameras": np.repeat(cameras(plain.model)[None], envs, axis=0),
        "segments": segments(scenes),
        "grounds": np.zeros((0, 0), np.uint8),
        "tones": np.zeros((0, 3, 256), np.int32),
        "slopes": np.zeros((0, 3)),
        "bars": np.zeros((0, 6)),
        **{name: episodes[name] for name in (*Tables._fields, *Faults._fields) if name in episodes},
        "quads": scenes.quads.reshape(envs, -1, 2),
    }
    if "noises" in episodes:
        silence = np.zeros(NOISE_SAMPLES, np.int8)
        arrays["noises"] = np.stack([silence if noise is None else noise for noise in episodes["noises"]])
    return arrays


def episode_tables(
    scenes: BatchScenes, seeds: Sequence[int] = (), shifts: Mapping[str, int] = MappingProxyType({}), steps: int = 1
) -> EpisodeArrays:
    """The tables that change when episodes start, except `quads`, a field of the scenes.

    Args:
        scenes: the scenes of the episodes.
        seeds: their seeds; the values of shifts are drawn from them.
        shifts: the strengths of shifts that are drawn.
        steps: the largest number of steps of an episode, plus one.

    Returns:
        The tables. In `noises`, an array of objects, only those environments have noise whose fault it is; the others
        have None.
    """
    table = polygons(scenes)
    counts = table[..., LAST] - table[..., FIRST]
    arrays: EpisodeArrays = {"polygons": table, "corner_offsets": counts.cumsum(axis=-1, dtype=np.int32) - counts}
    if shifts:
        rows = [_shifted(EpisodeShifts(draw_shifts(shifts, seed)), steps) for seed in seeds]
        arrays |= {name: np.stack([row[name] for row in rows]) for name in rows[0] if name != "noises"}
        if "noises" in rows[0]:
            arrays["noises"] = np.empty(len(rows), object)
            arrays["noises"][:] = [row["noises"] for row in rows]
    return arrays


def _shifted(episode: EpisodeShifts, steps: int) -> dict[str, Any]:
    """The tables of an episode's shifts."""
    model = copy(library().model)
    episode.model(model)
    row: dict[str, Any] = {"palettes": palette(model), "cameras": cameras(model)}
    if episode.changes_ground:
        row["grounds"] = episode.ground(c.ARENA_HALF_WIDTH).reshape(-1)
    if isinstance(light := episode.named("light"), Light):
        row["tones"], row["slopes"], row["bars"] = light.numbers
    if isinstance(sensor := episode.named("sensor"), Sensor):
        row["sensors"] = np.array(sensor.numbers)
        row["noises"] = sensor.noise if sensor.fault == NOISE else None
        row["chances"] = np.zeros((len(VIEWS), steps))
        if sensor.fault in (NOISE, LOSS):
            row["chances"][:] = [[sensor.chance(view, step) for step in range(steps)] for view in VIEWS]
    return row


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
    blocks[..., BODY] = (FIRST_BLOCK + np.arange(slots))[:, None]
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


def segments(scenes: BatchScenes) -> NDArray[np.int64]:
    """The values of `polygons` in segmentations. They are those of the slots, and so the same in all environments."""
    parts, slots, regions = library(), scenes.shapes.shape[1], scenes.regions.shape[1]
    most = max(len(rows) for shape in parts.blocks for rows in shape)
    of_robot = np.where(parts.robot[:, BODY] == ROBOT_BODY, ROBOT, FINGER)
    arena = np.full(len(parts.arena), WALL)
    return np.concatenate(
        [arena, REGION + np.arange(regions).repeat(QUADS), BLOCK + np.arange(slots).repeat(most), of_robot]
    ).astype(np.int64)


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
