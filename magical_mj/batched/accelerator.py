"""Draws a batch on an accelerator: a block of threads for each environment, a row of the picture for each thread.

The functions of `rendering.scanlines` and `batched.frames` are compiled by numba-cuda, so that the pictures are the
same to the byte. `NUMBA_ENABLE_CUDASIM=1` runs them without an accelerator, for tests.
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

from magical_mj.batched.frames import BLOCKS, VISIBLE, write_frame
from magical_mj.rendering.scanlines import FIRST, GRID, LAST, SOURCE, fill, mean, place, product
from magical_mj.shifts.kernels import cell_at, ground_row, put_cell, relight_row, turned
from magical_mj.shifts.shift import GROUND_CELLS, GROUND_REACH
from magical_mj.utils.errors import SettingsError

SHARED: Final = 48 * 1024
"""Bytes of shared memory of a block of threads, as every accelerator has."""
MOST_THREADS: Final = 96
_APART: Final = 4
"""Bytes between the samples of two threads, so that the same column is in different banks."""
_32: Final = np.uint64(32)
_LOW: Final = np.uint64(0xFFFF_FFFF)


@overload(product, strict=False)
def _on_accelerators(a: Any, b: Any) -> Any:
    """The product that the compiler does not fuse with a sum."""
    del a, b

    def rounded(a: Any, b: Any) -> Any:
        return libdevice.dmul_rn(a, b)

    return rounded


@cuda.jit
def draw(tables: Any, room: int, poses: Any, fingers: Any, view: int, envs: Any, out: Any) -> None:
    """Draws the picture of one of the environments.

    Args:
        tables: see `pictures.Tables`.
        room: the number of corners that shared memory holds.
        poses: x, y, angle of the robot and of each block. Shape (all envs, 1 + blocks, 3).
        fingers: angles of the left and the right finger. Shape (all envs, 2).
        view: an index into `VIEWS`.
        envs: the numbers of the environments to draw.
        out: the pictures of all environments, shape (all envs, size, size, 3).
    """
    polygons, corners, quads, palettes, cameras, places, grounds, tones, slopes, bars = tables
    env, thread, threads = envs[cuda.blockIdx.x], cuda.threadIdx.x, cuda.blockDim.x
    size, count, posed = out.shape[1], polygons.shape[1], BLOCKS + poses.shape[1]
    side = 2 * size

    words = cuda.shared.array(0, int32)
    frames = cuda.shared.array(0, float64)[: 4 * posed].reshape(posed, 4)
    end = 8 * posed
    x, y = words[end : end + room], words[end + room : end + 2 * room]
    end += 2 * room
    starts, stops = words[end : end + count], words[end + count : end + 2 * count]
    end = 4 * (end + 2 * count) + thread * (2 * side + _APART)
    samples = cuda.shared.array(0, uint8)[end : end + 2 * side]
    left, right = cuda.local.array(2, int64), cuda.local.array(2, int64)

    for number in range(thread, posed, threads):
        write_frame(number, view, cameras[env, view], poses[env], fingers[env], frames)
    cuda.syncthreads()

    camera, visible = frames[posed - 1], cameras[env, view, VISIBLE]
    seen = camera[0], camera[1], camera[2], camera[3], GRID * side / visible
    shown = turned((camera[0], camera[1], math.atan2(camera[3], camera[2]), visible))
    for p in range(thread, count, threads):
        at = places[env, p]
        starts[p], stops[p] = place((polygons[env], corners, quads[env]), p, frames, seen, side, x[at:], y[at:])
    cuda.syncthreads()

    palette = palettes[env]
    for row in range(thread, size, threads):
        lowest = 2 * row
        for sample in range(2 * side):
            samples[sample] = 0
        for p in range(count):
            first, last = max(starts[p], lowest), min(stops[p], lowest + 2)
            if first < last:
                at, number = places[env, p], polygons[env, p, LAST] - polygons[env, p, FIRST]
                colour, rows = polygons[env, p, SOURCE], (first, last, lowest)
                fill(x[at:], y[at:], number, colour, rows, side, (samples, left, right))
        line = out[env, size - 1 - row]
        for column in range(size):
            k = 2 * column
            lower = np.uint64(palette[samples[k]]) | (np.uint64(palette[samples[k + 1]]) << _32)
            upper = np.uint64(palette[samples[side + k]]) | (np.uint64(palette[samples[side + k + 1]]) << _32)
            line[column, 0], line[column, 1], line[column, 2] = mean(lower, upper)
            bare = int(lower & _LOW == 0) + int(lower >> _32 == 0) + int(upper & _LOW == 0) + int(upper >> _32 == 0)
            samples[column] = bare  # the pixel's samples are not needed again
        if len(grounds) > 0:
            i, j, stride_i, stride_j = ground_row(size - 1 - row, size, GROUND_CELLS, GROUND_REACH, shown)
            for column in range(size):
                put_cell(line, column, samples[column], grounds[env], cell_at(i, j, GROUND_CELLS - 1))
                i += stride_i
                j += stride_j
        if len(tones) > 0:
            relight_row(size - 1 - row, line, tones[env], slopes[env], bars[env], shown)


def launch(tables: Any, room: int, poses: Any, fingers: Any, view: int, envs: Any, out: Any, stream: Any = 0) -> None:
    """Launches `draw` for these environments on a stream. Arrays are on the device."""
    size = out.shape[1]
    used = 32 * (BLOCKS + poses.shape[1]) + 8 * (room + tables[0].shape[1])
    each = 4 * size + _APART
    threads = min(MOST_THREADS, size, (SHARED - used) // each)
    if threads < 1:
        raise SettingsError("these scenes have too many blocks and regions for an accelerator: use gymnasium.make_vec")
    draw[len(envs), threads, stream, used + threads * each](tuple(tables), room, poses, fingers, view, envs, out)


class Canvas:
    """Draws the environments of a batch on one of PyTorch's accelerators."""

    def __init__(self, tables: Sequence[Tensor], room: int) -> None:
        self._device, self._room = tables[0].device, room
        with cuda.gpus[self._device.index or 0]:
            self._tables = tuple(map(cuda.as_cuda_array, tables))

    def draw(self, poses: Tensor, fingers: Tensor, view: int, envs: Tensor, out: Tensor) -> None:
        """Launches `draw` after all other work on PyTorch's current stream. See `launch`."""
        handle = torch.cuda.current_stream(self._device).cuda_stream
        with cuda.gpus[self._device.index or 0]:
            stream = cuda.external_stream(handle) if handle else cuda.default_stream()
            posed, turned_fingers, chosen, pictures = map(cuda.as_cuda_array, (poses, fingers, envs, out))
            launch(self._tables, self._room, posed, turned_fingers, view, chosen, pictures, stream)
