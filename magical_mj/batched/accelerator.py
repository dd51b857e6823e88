"""Draws a batch on an accelerator: a block of threads for each environment, a row of the picture for each thread.

The functions of `rendering.scanlines`, `batched.frames` and `shifts.kernels` are compiled by numba-cuda, so that the
pictures are the same to the byte. `NUMBA_ENABLE_CUDASIM=1` runs them without an accelerator, for tests.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import torch
from numba import cuda, float64, int32, int64, uint8
from numba.cuda import libdevice
from numba.cuda.extending import overload
from torch import Tensor

from magical_mj.batched.frames import FIRST_BLOCK, VISIBLE, write_frame
from magical_mj.batched.tables import Faults, Tables
from magical_mj.observations import VIEWS
from magical_mj.rendering.scanlines import FIRST, LAST, SOURCE, fill, mean, place, product, view_from
from magical_mj.shifts import drawn, kernels
from magical_mj.shifts.kernels import TILE
from magical_mj.shifts.shift import GROUND_CELLS, GROUND_REACH
from magical_mj.utils.errors import SettingsError

SHARED: Final = 48 * 1024
"""Bytes of shared memory of a block of threads, as every accelerator has."""
MOST_THREADS: Final = 96
_APART: Final = 4
"""Bytes between the scratch memory of two threads, so that the same column is in different banks."""
_32: Final = np.uint64(32)
_LOW: Final = np.uint64(0xFFFF_FFFF)


@overload(product, strict=False)
def _on_accelerators(a: Any, b: Any) -> Any:
    """The product that the compiler does not fuse with a sum."""
    del a, b

    def rounded(a: Any, b: Any) -> Any:
        return libdevice.dmul_rn(a, b)

    return rounded


@cuda.jit(device=True)
def placed(tables: Any, corner_capacity: int, poses: Any, fingers: Any, view: int, env: int, side: int) -> Any:
    """Places all polygons of an environment; each thread places some of them. The arguments are those of `draw`.

    Returns:
        The polygons and what `fill_row` needs of them, in shared memory: the corners x and y, and for each polygon its
        first corner, its first row of samples and the row after its last. Then the camera's frame, and the scratch
        memory of the thread, 2 * side bytes.
    """
    polygons, corners, quads, _, cameras, corner_offsets, _, _, _, _, _ = tables
    thread, threads = cuda.threadIdx.x, cuda.blockDim.x
    count, posed = polygons.shape[1], FIRST_BLOCK + poses.shape[1]
    words = cuda.shared.array(0, int32)
    frames = cuda.shared.array(0, float64)[: 4 * posed].reshape(posed, 4)
    end = 8 * posed
    x, y = words[end : end + corner_capacity], words[end + corner_capacity : end + 2 * corner_capacity]
    end += 2 * corner_capacity
    starts, stops = words[end : end + count], words[end + count : end + 2 * count]
    end = 4 * (end + 2 * count) + thread * (2 * side + _APART)
    scratch = cuda.shared.array(0, uint8)[end : end + 2 * side]

    for number in range(thread, posed, threads):
        write_frame(number, view, cameras[env, view], poses[env], fingers[env], frames)
    cuda.syncthreads()
    camera, at = frames[posed - 1], corner_offsets[env]
    seen = view_from(camera, cameras[env, view, VISIBLE], side)
    for p in range(thread, count, threads):
        scene = polygons[env], corners, quads[env]
        starts[p], stops[p] = place(scene, p, frames, seen, side, x[at[p] :], y[at[p] :])
    cuda.syncthreads()
    return (polygons[env], x, y, at, starts, stops), camera, scratch


@cuda.jit(device=True)
def fill_rows(shapes: Any, colours: Any, lowest: int, count: int, side: int, samples: Any) -> None:
    """Paints the polygons of `placed` in these colours into a few rows of samples, beginning with row `lowest`."""
    polygons, x, y, offsets, starts, stops = shapes
    left, right = cuda.local.array(2, int64), cuda.local.array(2, int64)
    for sample in range(count * side):
        samples[sample] = 0
    for p in range(len(polygons)):
        first, last = max(starts[p], lowest), min(stops[p], lowest + count)
        if first < last:
            at, corners = offsets[p], polygons[p, LAST] - polygons[p, FIRST]
            fill(x[at:], y[at:], corners, colours[p], (first, last, lowest), side, (samples, left, right))


@cuda.jit(device=True)
def put_row(samples: Any, palette: Any, line: Any) -> None:
    """Writes a row of pixels. In `samples`, the number of uncovered ones of each pixel replaces the entries."""
    side = 2 * len(line)
    for column in range(len(line)):
        k = 2 * column
        lower = np.uint64(palette[samples[k]]) | (np.uint64(palette[samples[k + 1]]) << _32)
        upper = np.uint64(palette[samples[side + k]]) | (np.uint64(palette[samples[side + k + 1]]) << _32)
        line[column, 0], line[column, 1], line[column, 2] = mean(lower, upper)
        uncovered = int(lower & _LOW == 0) + int(lower >> _32 == 0) + int(upper & _LOW == 0) + int(upper >> _32 == 0)
        samples[column] = uncovered


@cuda.jit(device=True)
def put_ground(row: int, line: Any, uncovered: Any, ground: Any, camera: Any) -> None:
    """Puts another ground into a row of pixels, with numbers of uncovered samples. See `kernels.put_on_ground`."""
    i, j, stride_i, stride_j = kernels.ground_row(row, len(line), GROUND_CELLS, GROUND_REACH, camera)
    for column in range(len(line)):
        kernels.put_cell(line, column, uncovered[column], ground, kernels.cell_at(i, j, GROUND_CELLS - 1))
        i += stride_i
        j += stride_j


@cuda.jit
def draw(tables: Any, corner_capacity: int, poses: Any, fingers: Any, view: int, envs: Any, out: Any) -> None:
    """Draws the picture of one of the environments.

    Args:
        tables: the arrays of `tables.Tables`, as a plain tuple, which is unpacked in the order of its fields.
        corner_capacity: the number of corners that shared memory holds.
        poses: x, y, angle of the robot and of each block. Shape (all envs, 1 + blocks, 3).
        fingers: angles of the left and the right finger. Shape (all envs, 2).
        view: an index into `VIEWS`.
        envs: the numbers of the environments to draw.
        out: the pictures of all environments, shape (all envs, size, size, 3).
    """
    polygons, _, _, palettes, cameras, _, _, grounds, tones, slopes, bars = tables
    env, size = envs[cuda.blockIdx.x], out.shape[1]
    shapes, camera, samples = placed(tables, corner_capacity, poses, fingers, view, env, 2 * size)
    shown = kernels.turned((camera[0], camera[1], math.atan2(camera[3], camera[2]), cameras[env, view, VISIBLE]))
    for row in range(cuda.threadIdx.x, size, cuda.blockDim.x):
        line = out[env, row]
        fill_rows(shapes, polygons[env, :, SOURCE], 2 * (size - 1 - row), 2, 2 * size, samples)
        put_row(samples, palettes[env], line)
        if len(grounds) > 0:
            put_ground(row, line, samples, grounds[env], shown)
        if len(tones) > 0:
            kernels.relight_row(row, line, tones[env], slopes[env], bars[env], shown)


@cuda.jit
def segment(tables: Any, corner_capacity: int, poses: Any, fingers: Any, view: int, envs: Any, out: Any) -> None:
    """Draws a segmentation, like `draw`: the value at each pixel's centre. `out`: shape (all envs, size, size, 1)."""
    _, _, _, _, _, _, segments, _, _, _, _ = tables
    env, size = envs[cuda.blockIdx.x], out.shape[1]
    shapes, _, samples = placed(tables, corner_capacity, poses, fingers, view, env, size)
    for row in range(cuda.threadIdx.x, size, cuda.blockDim.x):
        fill_rows(shapes, segments, size - 1 - row, 1, size, samples)
        for column in range(size):
            out[env, row, column, 0] = samples[column]


@cuda.jit(device=True)
def add_noise(picture: Any, noise: Any, chance: float) -> None:
    """See `kernels.add_noise`."""
    size, last = len(picture), len(noise) - 1
    first = kernels.first_noise(chance, len(noise), 3 * size * size)
    for row in range(cuda.threadIdx.x, size, cuda.blockDim.x):
        for column in range(size):
            for k in range(3):
                level = first + 3 * (row * size + column) + k
                picture[row, column, k] = kernels.noisy(picture[row, column, k], noise[level & last])


@cuda.jit(device=True)
def blur(picture: Any, width: int) -> None:
    """See `kernels.blur`."""
    size, thread, threads = len(picture), cuda.threadIdx.x, cuda.blockDim.x
    scratch = cuda.shared.array(0, uint8)[thread * (3 * size + _APART) :]
    for row in range(thread, size, threads):
        kernels.blur_line(picture[row], scratch, width)
    cuda.syncthreads()
    for column in range(thread, size, threads):
        kernels.blur_line(picture[:, column], scratch, width)


@cuda.jit(device=True)
def quantise(picture: Any, step: int) -> None:
    """See `kernels.quantise`."""
    tile, tiles = cuda.local.array((TILE, TILE), float64), len(picture) // TILE
    for number in range(cuda.threadIdx.x, tiles * tiles, cuda.blockDim.x):
        top, left = number // tiles * TILE, number % tiles * TILE
        kernels.quantise_tile(picture[top : top + TILE, left : left + TILE], step, tile)


@cuda.jit(device=True)
def add_dirt(picture: Any, x: float, y: float, radius: float) -> None:
    """See `kernels.add_dirt`."""
    for row in range(cuda.threadIdx.x, len(picture), cuda.blockDim.x):
        kernels.dirty_row(row, picture[row], x, y, radius)


@cuda.jit(device=True)
def lose(picture: Any) -> None:
    """Makes the picture grey."""
    for row in range(cuda.threadIdx.x, len(picture), cuda.blockDim.x):
        for column in range(len(picture)):
            picture[row, column, 0] = picture[row, column, 1] = picture[row, column, 2] = kernels.GREY


@cuda.jit
def spoil(faults: Any, steps: Any, view: int, envs: Any, out: Any) -> None:
    """Applies the sensor's fault to the picture of one of the environments. See `drawn.Sensor`.

    Args:
        faults: the arrays of `tables.Faults`, as a plain tuple.
        steps: the number of steps of each environment's episode.
        view: an index into `VIEWS`.
        envs: the numbers of the environments.
        out: the pictures of all environments, shape (all envs, size, size, 3).
    """
    sensors, noises, chances = faults
    env = envs[cuda.blockIdx.x]
    picture, sensor, chance = out[env], sensors[env], chances[env, view, steps[env]]
    fault, amount = int(sensor[0]), sensor[1]
    if fault == drawn.NOISE:
        add_noise(picture, noises[env], chance)
    elif fault == drawn.BLUR:
        blur(picture, max(1, round(amount * len(picture))))
    elif fault == drawn.BLOCKS:
        quantise(picture, int(amount))
    elif fault == drawn.DIRT:
        add_dirt(picture, sensor[2], sensor[3], amount)
    elif fault == drawn.LOSS and chance < amount:
        lose(picture)


def launch(
    tables: Tables,
    faults: Faults | None,
    corner_capacity: int,
    posed: Sequence[Any],
    view: str,
    envs: Any,
    out: Any,
    stream: Any = 0,
) -> None:
    """Launches the kernels that draw a view of these environments on a stream. See `Painter.draw`.

    Args:
        tables: on the device, as all arrays.
        faults: the sensors' faults; None: without any.
        corner_capacity: see `draw`.
        posed: poses, fingers, and steps.
        view: one of `VIEWS` or `SEGMENTATIONS`.
        envs: the numbers of the environments to draw.
        out: the pictures of all environments.
        stream: numba's.
    """
    poses, fingers, steps = posed
    size, number, pictures = out.shape[1], VIEWS.index(view.partition("-")[0]), out.shape[3] == 3
    used = 32 * (FIRST_BLOCK + poses.shape[1]) + 8 * (corner_capacity + tables.polygons.shape[1])
    threads, memory = _launch_shape(size, used, (4 if pictures else 2) * size)
    kernel = draw if pictures else segment
    kernel[len(envs), threads, stream, memory](tuple(tables), corner_capacity, poses, fingers, number, envs, out)
    if faults is not None and pictures:
        threads, memory = _launch_shape(size, 0, 3 * size)
        spoil[len(envs), threads, stream, memory](tuple(faults), steps, number, envs, out)


def _launch_shape(size: int, used: int, scratch: int) -> tuple[int, int]:
    """The number of threads of a block, and its shared memory: what all use, and the scratch memory of each thread."""
    threads = min(MOST_THREADS, size, (SHARED - used) // (scratch + _APART))
    if threads < 1:
        raise SettingsError("these scenes have too many blocks and regions for an accelerator: use gymnasium.make_vec")
    return threads, used + threads * (scratch + _APART)


class Launcher:
    """Draws the environments of a batch on one of PyTorch's accelerators. See `launch`."""

    def __init__(self, tables: Tables, faults: Faults | None, corner_capacity: int) -> None:
        self._device, self._corner_capacity = tables.polygons.device, corner_capacity
        with cuda.gpus[self._device.index or 0]:
            self._tables = Tables(*map(cuda.as_cuda_array, tables))
            self._faults = faults and Faults(*map(cuda.as_cuda_array, faults))

    def draw(self, posed: tuple[Tensor, Tensor, Tensor], view: str, envs: Tensor, out: Tensor) -> None:
        """Launches the kernels after all other work on PyTorch's current stream."""
        handle = torch.cuda.current_stream(self._device).cuda_stream
        with cuda.gpus[self._device.index or 0]:
            stream = cuda.external_stream(handle) if handle else cuda.default_stream()
            *here, chosen, pictures = map(cuda.as_cuda_array, (*posed, envs, out))
            launch(self._tables, self._faults, self._corner_capacity, here, view, chosen, pictures, stream)
