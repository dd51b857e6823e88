"""A scanline rasteriser for flat convex polygons, compiled by numba: the software renderer and pictures of batches.

Every processor and accelerator draws the same bytes. Integers alone decide which samples a polygon covers: corners are
points of a grid of 256 x 256 points a sample, and edges are followed with exact quotients and remainders. A corner's
point is computed by additions and multiplications of doubles and one `floor`, each rounded as IEEE 754 defines: numba
does not fuse or reorder them (no `fastmath`), and tests look for fused instructions in the compiled code. Compilers for
accelerators do fuse a product with a sum; `product` is the product that they do not fuse (`batched.accelerator`).

On a processor, `paint` draws the polygons one after the other. On an accelerator, threads share the work: each places
some of the polygons (`place`), and then fills some of the rows (`fill` with the rows that it may fill).

Numba keeps the machine code on disk: next to this file, in NUMBA_CACHE_DIR, or in the user's cache folder. If none of
these can be written to: in a private folder below the system's temporary folder. Otherwise each process compiles.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from typing import Any, Final

import numpy as np
from numba import config, njit
from numba.extending import register_jitable

from magical_mj.utils import files

GRID_BITS: Final = 8
"""The grid of corners has 2 ** GRID_BITS steps a sample, as usual in OpenGL."""
GRID: Final = 1 << GRID_BITS
HALF: Final = GRID // 2
MAX_CORNERS: Final = 64
"""The most corners of a polygon. Kernels do not check it: callers split larger polygons."""
FIRST, LAST, BODY, SOURCE, IS_SKIN = range(5)
"""The columns of a table of polygons: corners FIRST..LAST - 1, the body, the geom or skin, and whether it is a skin."""

_EVEN: Final = np.uint64(0x00FF_00FF_00FF_00FF)  # red and blue of two samples
_ROUND: Final = np.uint64(0x0002_0002)
_BYTE: Final = np.uint64(0xFF)
_2, _8, _16, _32 = np.uint64(2), np.uint64(8), np.uint64(16), np.uint64(32)

_COMPILING: Final = threading.RLock()
inlined: Final = njit(forceinline=True)
"""Compiles a function into those that call it."""


class Kernel:
    """A function that numba compiles at its first call, or loads from the code that an earlier process has compiled.

    Args:
        signature: the types of the arguments.
        function: the function.
    """

    def __init__(self, signature: str, function: Callable[..., None]) -> None:
        self._signature, self._function = signature, function
        self._dispatcher: Any = None

    def __call__(self, *arguments: Any) -> None:
        """Calls the compiled function."""
        (self._dispatcher or self.dispatcher)(*arguments)

    @property
    def dispatcher(self) -> Any:
        """The compiled function, as numba's dispatcher."""
        with _COMPILING:
            self._dispatcher = self._dispatcher or self._compiled()
        return self._dispatcher

    @property
    def folder(self) -> str | None:
        """The folder that keeps the machine code; None if each process compiles."""
        return self.dispatcher.stats.cache_path

    def _compiled(self) -> Any:
        for keeping in (nullcontext, _kept_in_temporary_folder):
            with suppress(Exception), keeping():  # many kinds: no folder can be written, the disk is full, a bad file
                return njit(self._signature, cache=True, nogil=True)(self._function)
        return njit(self._signature, nogil=True)(self._function)


def compiled(signature: str) -> Callable[[Callable[..., None]], Kernel]:
    """Makes a kernel for arguments of these types."""
    return partial(Kernel, signature)


@contextmanager
def _kept_in_temporary_folder() -> Iterator[None]:
    """Numba keeps code in a folder below the system's temporary one, which nobody else can read or write.

    Machine code is loaded from it, so its owner and permissions are checked before.
    """
    settings: Any = config
    folder, before = files.private_folder("magical-mj-numba"), settings.CACHE_DIR
    settings.CACHE_DIR = str(folder)
    try:
        yield
    finally:
        settings.CACHE_DIR = before


@inlined
def packed_rgba(rgba: Any) -> Any:
    """Red, green, blue in [0, 1] as an opaque pixel 0xAABBGGRR, rounded to 8 bits each. 0 if alpha is 0."""
    if rgba[3] == 0:
        return np.uint32(0)
    pixel = _BYTE
    for k in range(2, -1, -1):
        pixel = (pixel << _8) | np.uint64(math.floor(255.0 * np.float64(rgba[k]) + 0.5))
    return np.uint32(pixel)


@register_jitable
def product(a: float, b: float) -> float:
    """The rounded product of two doubles, which is not fused with a sum."""
    return a * b


@inlined
def transform(points: Any, frame: Any, scale: float, middle: float, x: Any, y: Any) -> None:
    """Writes the corners of a polygon on the picture's grid: scale (R(c, s) (u, v) + (tx, ty)) + middle, rounded.

    Args:
        points: local coordinates u, v (world units), one corner a row.
        frame: tx, ty, c, s, as `relative` computes them.
        scale: steps of the grid per world unit.
        middle: where the camera looks, in steps of the grid.
        x: the array to write x to (to the right).
        y: the array to write y to (upwards).
    """
    tx, ty, c, s = frame
    for k in range(len(points)):
        u, v = np.float64(points[k, 0]), np.float64(points[k, 1])
        x[k] = math.floor(product(scale, tx + product(c, u) - product(s, v)) + middle + 0.5)
        y[k] = math.floor(product(scale, ty + product(s, u) + product(c, v)) + middle + 0.5)


@inlined
def relative(body: Any, camera: Any) -> Any:
    """The frame of a body as a camera sees it: tx, ty, cosine and sine of the angle.

    With d the vector from the camera to the body, a and b their angles: R(-a) d and b - a. Cameras look straight down.
    Both arguments are x, y, cosine and sine of the angle, and more entries are ignored.
    """
    dx, dy = body[0] - camera[0], body[1] - camera[1]
    cos_a, sin_a, cos_b, sin_b = camera[2], camera[3], body[2], body[3]
    return (
        product(cos_a, dx) + product(sin_a, dy),
        product(cos_a, dy) - product(sin_a, dx),
        product(cos_a, cos_b) + product(sin_a, sin_b),
        product(cos_a, sin_b) - product(sin_a, cos_b),
    )


@inlined
def first_centre(position: int) -> int:
    """The first sample whose centre is not before a position on the grid: ceil((position - HALF) / GRID)."""
    return (position + HALF - 1) >> GRID_BITS


@inlined
def clip(x: Any, y: Any, count: int, side: int) -> Any:
    """The rows first..last - 1 of samples that a polygon covers within the picture. Empty if it is outside."""
    low_x, high_x, low_y, high_y = x[0], x[0], y[0], y[0]
    for k in range(1, count):
        low_x, high_x = min(low_x, x[k]), max(high_x, x[k])
        low_y, high_y = min(low_y, y[k]), max(high_y, y[k])
    if high_x <= 0 or low_x >= side * GRID:
        return 0, 0
    return max(first_centre(low_y), 0), min(first_centre(high_y), side)


@inlined
def place(scene: Any, polygon: int, frames: Any, view: Any, side: int, x: Any, y: Any) -> Any:
    """Writes the corners of a polygon on the picture's grid, and returns the rows that it covers, as `clip`.

    Args:
        scene: the table of polygons, whose columns are `FIRST`..`IS_SKIN`; corners of geoms; corners of skins.
        polygon: its row of the table.
        frames: x, y, cosine and sine of the angle of each body, shape (n, 4).
        view: x, y, cosine and sine of the camera, and the steps of the grid per world unit.
        side: samples per side of the picture.
        x: the array to write x to (to the right).
        y: the array to write y to (upwards).
    """
    polygons, corners, skin = scene
    first, last = polygons[polygon, FIRST], polygons[polygon, LAST]
    if first == last:
        return 0, 0
    scale, middle = view[4], 0.5 * GRID * side
    frame = relative(frames[polygons[polygon, BODY]], view)
    if polygons[polygon, IS_SKIN]:
        transform(skin[first:last], frame, scale, middle, x, y)
    else:
        transform(corners[first:last], frame, scale, middle, x, y)
    return clip(x, y, last - first, side)


@inlined
def follow(xa: int, ya: int, xb: int, yb: int, rows: Any, side: int, ends: Any) -> None:
    """Writes, for each of these rows that an edge crosses, the first sample whose centre is not left of it, in 0..side.

    The edge goes up from (xa, ya) to (xb, yb). At the centre of row r, y = GRID r + HALF, it is at
    xa + (y - ya) (xb - xa) / (yb - ya), and the sample is ceil((that - HALF) / GRID) = ceil(n / d) with
    d = GRID (yb - ya) and n = (xa - HALF) (yb - ya) + (y - ya) (xb - xa). From row to row n grows by GRID (xb - xa).
    """
    first, last, lowest = rows
    start, stop = max(first_centre(ya), first), min(first_centre(yb), last)
    if start >= stop:
        return
    dx, dy = np.int64(xb - xa), np.int64(yb - ya)
    d = GRID * dy
    n = (xa - HALF) * dy + (GRID * start + HALF - ya) * dx + d - 1  # + d - 1: ceil as floor
    quotient, rest = n // d, n % d
    step, step_rest = (GRID * dx) // d, (GRID * dx) % d
    for row in range(start, stop):
        ends[row - lowest] = min(max(quotient, 0), side)
        quotient += step
        rest += step_rest
        if rest >= d:
            rest -= d
            quotient += 1


@inlined
def fill(x: Any, y: Any, count: int, colour: int, rows: Any, side: int, scratch: Any) -> None:
    """Colours the samples whose centres a convex polygon covers; on an edge: those of left and lower edges.

    Args:
        x: corners on the grid, counter-clockwise: edges that go up are on the right.
        y: the corners' heights on the grid, upwards.
        count: the number of corners.
        colour: the value of the coloured samples.
        rows: the first row to fill, the last one + 1, and the row where `scratch` begins. The polygon must cross all
            rows to fill.
        side: samples per side of the picture.
        scratch: samples row by row from below; for each row, the first sample of the polygon and the one after its
            last, which are overwritten.
    """
    samples, left, right = scratch
    first, last, lowest = rows
    for k in range(count):
        after = k + 1 if k + 1 < count else 0
        if y[after] > y[k]:
            follow(x[k], y[k], x[after], y[after], rows, side, right)
        elif y[after] < y[k]:
            follow(x[after], y[after], x[k], y[k], rows, side, left)
    for row in range(first - lowest, last - lowest):
        for sample in range(row * side + left[row], row * side + right[row]):
            samples[sample] = colour


@inlined
def paint(scene: Any, colours: Any, frames: Any, view: Any, side: int, scratch: Any) -> None:
    """Paints polygons in their order and in these colours, later ones over earlier ones.

    The other arguments are those of `place` and `fill`. The arrays in `scratch` have the shapes (side * side,), (side,)
    and (side,).
    """
    x, y = np.empty(MAX_CORNERS, np.int64), np.empty(MAX_CORNERS, np.int64)
    scratch[0][: side * side] = 0
    for p in range(len(scene[0])):
        first, last = place(scene, p, frames, view, side, x, y)
        if first < last:
            fill(x, y, scene[0][p, LAST] - scene[0][p, FIRST], colours[p], (first, last, 0), side, scratch)


@inlined
def mean(lower: Any, upper: Any) -> Any:
    """Red, green and blue of a pixel: the mean of its four samples, rounded, on white. Equal to `opengl.on_white`'s.

    Two colours of 8 bits are 16 bits apart in a word, so that four samples can be added at once without carries.

    Args:
        lower: the pixel's two lower samples as one word: 0xAABBGGRR of the right one, then of the left one.
        upper: the two upper ones.
    """
    red_blue = (lower & _EVEN) + (upper & _EVEN)
    green_alpha = ((lower >> _8) & _EVEN) + ((upper >> _8) & _EVEN)
    red_blue = ((red_blue + (red_blue >> _32) + _ROUND) >> _2) & _EVEN
    green_alpha = ((green_alpha + (green_alpha >> _32) + _ROUND) >> _2) & _EVEN
    paper = _BYTE - ((green_alpha >> _16) & _BYTE)
    return (
        np.uint8((red_blue & _BYTE) + paper),
        np.uint8((green_alpha & _BYTE) + paper),
        np.uint8(((red_blue >> _16) & _BYTE) + paper),
    )


@inlined
def average(pairs: Any, out: Any) -> None:
    """The picture of painted samples, top row first. Most pixels have the same samples as their left neighbour.

    Args:
        pairs: two neighbouring samples as one word, as for `mean`.
        out: shape (height, width, 3).
    """
    height, width = out.shape[0], out.shape[1]
    for row in range(height):
        lower = pairs[2 * row * width : (2 * row + 1) * width]
        upper = pairs[(2 * row + 1) * width : (2 * row + 2) * width]
        line = out[height - 1 - row]
        last_low, last_up = np.uint64(0), np.uint64(0)
        red = green = blue = np.uint8(255)
        for column in range(width):
            low, up = lower[column], upper[column]
            if low != last_low or up != last_up:
                last_low, last_up = low, up
                red, green, blue = mean(low, up)
            line[column, 0] = red
            line[column, 1] = green
            line[column, 2] = blue


_SCENE: Final = "Tuple((i4[:, ::1], f8[:, ::1], f4[:, ::1]))"
_WORLD: Final = f"{_SCENE}, Tuple((f8[:, ::1], f8[:, ::1])), Tuple((f8[::1], f8[::1], f8))"
_SCRATCH: Final = "Tuple((u4[::1], i8[::1], i8[::1]))"


@inlined
def seen(poses: Any, view: Any, side: int) -> Any:
    """The arguments `frames` and `view` of `paint`.

    Args:
        poses: positions and rotation matrices of all bodies, shapes (n, 3) and (n, 9).
        view: position and matrix of a camera, and the side of the visible square (world units).
        side: samples per side of the picture.
    """
    positions, rotations = poses
    frames = np.empty((len(positions), 4))
    for body in range(len(positions)):
        frames[body, 0], frames[body, 1] = positions[body, 0], positions[body, 1]
        frames[body, 2], frames[body, 3] = rotations[body, 0], rotations[body, 3]
    return frames, (view[0][0], view[0][1], view[1][0], view[1][3], GRID * side / view[2])


@compiled(f"void({_WORLD}, {_SCRATCH}, f4[:, ::1], f4[:, ::1], u4[::1], u8[::1], u1[:, :, :])")
def draw_picture(
    scene: Any, poses: Any, view: Any, scratch: Any, geoms: Any, skins: Any, colours: Any, pairs: Any, out: Any
) -> None:
    """Draws polygons, four samples a pixel, into `out`, shape (size, size, 3).

    The first arguments are those of `seen` and `paint`; then come red, green and blue of geoms and of skins, scratch
    for the colours of polygons, and the samples in pairs, for `average`.
    """
    polygons, side = scene[0], 2 * len(out)
    for p in range(len(polygons)):
        source = polygons[p, SOURCE]
        colours[p] = packed_rgba(skins[source]) if polygons[p, IS_SKIN] else packed_rgba(geoms[source])
    frames, camera = seen(poses, view, side)
    paint(scene, colours, frames, camera, side, scratch)
    average(pairs, out)


@inlined
def view_from(camera: Any, visible: float, side: int) -> Any:
    """The argument `view` of `place`: a camera's frame, and the steps of the grid per world unit."""
    return camera[0], camera[1], camera[2], camera[3], GRID * side / visible


@compiled(f"void({_SCENE}, f8[:, ::1], f8, {_SCRATCH}, i8[::1], u4[::1], u8[::1], u1[:, :, :])")
def draw_posed(
    scene: Any, frames: Any, visible: float, scratch: Any, palette: Any, colours: Any, pairs: Any, out: Any
) -> None:
    """Draws a picture of bodies with these frames. The last frame is the camera's, and `visible` its square's side.

    The column SOURCE of the table is the polygon's entry of the palette, 0xAABBGGRR.
    """
    polygons, side = scene[0], 2 * len(out)
    for p in range(len(polygons)):
        colours[p] = palette[polygons[p, SOURCE]]
    paint(scene, colours, frames, view_from(frames[-1], visible, side), side, scratch)
    average(pairs, out)


@compiled("void(u4[::1], u1[:, ::1])")
def count_uncovered(samples: Any, out: Any) -> None:
    """Writes the number of uncovered samples, 0 to 4, of each pixel. Shape (height, width)."""
    height, width = out.shape
    one, uncovered = np.uint32(1), np.empty(2 * width, np.uint8)
    for row in range(height):
        first = 4 * row * width
        lower, upper = samples[first : first + 2 * width], samples[first + 2 * width : first + 4 * width]
        for column in range(2 * width):
            uncovered[column] = np.uint8(2 - min(lower[column], one) - min(upper[column], one))
        line = out[height - 1 - row]
        for column in range(width):
            line[column] = uncovered[2 * column] + uncovered[2 * column + 1]


@inlined
def put_segments(samples: Any, out: Any) -> None:
    """Writes painted samples, one for each pixel, into a picture, top row first."""
    side = len(out)
    for row in range(side):
        for column in range(side):
            out[side - 1 - row, column] = samples[row * side + column]


@compiled(f"void({_WORLD}, {_SCRATCH}, u4[::1], u1[:, :])")
def draw_segments(scene: Any, poses: Any, view: Any, scratch: Any, segments: Any, out: Any) -> None:
    """Writes the segment at each pixel's centre into `out`, shape (size, size); 0 without a polygon."""
    frames, camera = seen(poses, view, len(out))
    paint(scene, segments, frames, camera, len(out), scratch)
    put_segments(scratch[0], out)


@compiled(f"void({_SCENE}, f8[:, ::1], f8, {_SCRATCH}, i8[::1], u1[:, :])")
def segment_posed(scene: Any, frames: Any, visible: float, scratch: Any, segments: Any, out: Any) -> None:
    """Draws segments, as `draw_segments` does, of bodies with these frames; see `draw_posed`."""
    paint(scene, segments, frames, view_from(frames[-1], visible, len(out)), len(out), scratch)
    put_segments(scratch[0], out)
