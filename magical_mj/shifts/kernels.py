"""Pixel operations of shifts, compiled by numba. Integer arithmetic gives the same bytes on every machine.

Accelerators use the functions for a pixel, a row, a line or a tile, see `batched.accelerator`.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from magical_mj.rendering.scanlines import compiled, inlined, product

TILE: Final = 4
"""Pixels per side of a tile whose coefficients `quantise` rounds."""
BITS: Final = 24
ONE: Final = float(1 << BITS)
"""The side of a ground cell in fixed-point coordinates."""
WHITE: Final = 255
DIRTY: Final = 1.2
OPACITY: Final = 255 * 1.6
MOST_OPAQUE: Final = 240.0
"""The opacity of dirt, of 255, rises from 0 at `DIRTY` radii by `OPACITY` per radius, to at most `MOST_OPAQUE`."""
DIRT_LEVEL: Final = 60
"""The level of dirt."""
GREY: Final = 128
"""The level of lost frames."""
_FRAME: Final = "UniTuple(f8, 4)"


@inlined
def turned(camera: Any) -> Any:
    """A camera (see `Frame`) as x, y, cosine and sine of its angle, and the side of its view."""
    return camera[0], camera[1], math.cos(camera[2]), math.sin(camera[2]), camera[3]


@inlined
def ground_row(row: int, size: int, cells: int, reach: float, camera: Any) -> Any:
    """The position of a row's first pixel on the ground, and the step from a pixel to the next.

    Args:
        row: its number, from the top.
        size: pixels per side of the picture.
        cells: cells per side of the ground.
        reach: half the side of the ground (world units).
        camera: see `turned`.

    Returns:
        The row and the column of the ground at the first pixel, and their steps. All are fixed-point numbers.
    """
    x, y, cosine, sine, side = camera
    scale = cells / (2 * reach)  # cells per world unit
    right, up = cosine * scale * side / size, sine * scale * side / size  # cells per pixel
    half = (size - 1) / 2
    lift = half - row
    j = int((product(x + reach, scale) - product(half, right) - product(lift, up)) * ONE)
    i = int((product(reach - y, scale) + product(half, up) - product(lift, right)) * ONE)
    return i, j, int(-up * ONE), int(right * ONE)


@inlined
def cell_at(i: int, j: int, last: int) -> int:
    """The index of the red level of a cell of the ground. Beyond the ground, the cells of its edge continue."""
    return 3 * (min(max(i >> BITS, 0), last) * (last + 1) + min(max(j >> BITS, 0), last))


@inlined
def put_cell(line: Any, column: int, uncovered: int, levels: Any, cell: int) -> None:
    """Replaces the white ground, which `uncovered` of a pixel's four samples show, by a cell's colour."""
    one, two = np.uint32(1), np.uint32(2)
    count = np.int32(uncovered)
    plain = levels[cell] & levels[cell + one] & levels[cell + two] == WHITE
    if count == 0 or plain:
        return
    for k in range(3):
        level = np.int32(levels[cell + np.uint32(k)])
        if count < 4:
            darker = (count * (255 - level) + 2) >> 2
            level = max(np.int32(line[column, k]) - darker, 0)
        line[column, k] = np.uint8(level)


@compiled(f"void(u1[:, :, :], u1[:, ::1], u1[:, :, ::1], f8, {_FRAME})")
def put_on_ground(picture: Any, uncovered: Any, ground: Any, reach: float, camera: Any) -> None:
    """Replaces the white ground of a picture by another one, in place.

    Args:
        picture: shape (size, size, 3).
        uncovered: the number of each pixel's four samples that show the ground, shape (size, size).
        ground: a picture of the square around the origin, top row first, shape (n, n, 3).
        reach: half the side of that square (world units). Beyond it, the pixels of its edge continue.
        camera: see `Frame`.
    """
    size, last = len(picture), len(ground) - 1
    levels, seen, seen_by = ground.reshape(-1), np.empty(size, np.uint32), turned(camera)
    for row in range(size):
        i, j, stride_i, stride_j = ground_row(row, size, last + 1, reach, seen_by)
        for column in range(size):  # without branches, so that the compiler can vectorise it
            seen[column] = cell_at(i, j, last)
            i += stride_i
            j += stride_j
        for column in range(size):
            put_cell(picture[row], column, uncovered[row, column], levels, seen[column])


@inlined
def relight_row(row: int, line: Any, tones: Any, slope: Any, bar: Any, camera: Any) -> None:
    """Changes the light of a row of a picture in place. See `relight`, and `turned` for the camera."""
    size = len(line)
    x, y, cosine, sine, side = camera
    right, up, half = cosine * side / size, sine * side / size, (size - 1) / 2
    lift = half - row
    east = x - product(half, right) - product(lift, up)
    north = y - product(half, up) + product(lift, right)
    loss = slope[2] * (1.0 + product(slope[0], east) + product(slope[1], north)) / 2
    more = slope[2] * (product(slope[0], right) + product(slope[1], up)) / 2
    away = product(bar[0], east) + product(bar[1], north) - bar[2]
    further = product(bar[0], right) + product(bar[1], up)
    for column in range(size):
        inside = (bar[3] - abs(away + product(further, float(column)))) / bar[4] + 0.5
        shade = 1.0 - min(max(loss + product(more, float(column)), 0.0), 1.0)
        level = np.int32(256.0 * shade * (1.0 - product(bar[5], min(max(inside, 0.0), 1.0))))
        for k in range(3):
            line[column, k] = np.uint8((tones[k, line[column, k]] * level + 32768) >> 16)


@compiled(f"void(u1[:, :, ::1], i4[:, ::1], f8[::1], f8[::1], {_FRAME})")
def relight(picture: Any, tones: Any, slope: Any, bar: Any, camera: Any) -> None:
    """Changes the light of a picture in place: tones of each channel, a gradient over the ground, the shadow of a bar.

    Args:
        picture: shape (size, size, 3).
        tones: the new level, times 256, of each level of red, green and blue, shape (3, 256).
        slope: x, y of the unit vector towards the darker side, and the share of the light that is lost at 1 along it.
            At -1 nothing is lost. Shape (3,).
        bar: x, y of the shadow's normal, its distance from the origin, half its width and the width of its soft edges
            (world units), and the share of the light that it removes. Shape (6,).
        camera: see `Frame`.
    """
    seen_by = turned(camera)
    for row in range(len(picture)):
        relight_row(row, picture[row], tones, slope, bar, seen_by)


@inlined
def noisy(level: Any, noise: Any) -> Any:
    """A level with noise, clipped to 0..255."""
    return np.uint8(min(max(np.int32(level) + np.int32(noise), 0), 255))


@inlined
def first_noise(chance: float, count: int, levels: int) -> int:
    """The first of `count` entries of noise for the `levels` of a picture, from a random number in [0, 1).

    A picture with more levels than there is noise repeats it.
    """
    if levels > count:
        count *= levels // count + 2
    return int(chance * (count - levels + 1))


@compiled("void(u1[::1], i1[::1], f8)")
def add_noise(pixels: Any, noise: Any, chance: float) -> None:
    """Adds noise to all levels in place. See `first_noise`. The length of the noise is a power of two."""
    first, last = first_noise(chance, len(noise), len(pixels)), len(noise) - 1
    for k in range(len(pixels)):
        pixels[k] = noisy(pixels[k], noise[(first + k) & last])


@inlined
def blur_line(pixels: Any, line: Any, width: int) -> None:
    """Replaces each pixel of a row or column by the mean of itself and `width` pixels on either side, in place.

    Args:
        pixels: shape (size, 3).
        line: is overwritten, shape (3 * size,), uint8.
        width: beyond the ends, the pixels there continue.
    """
    last, count = len(pixels) - 1, 2 * width + 1
    share = np.int32(65536 // count)
    for i in range(last + 1):
        for k in range(3):
            line[3 * i + k] = pixels[i, k]
    for k in range(3):
        total = np.int32(0)  # a moving sum
        for i in range(-width, width + 1):
            total += np.int32(line[3 * min(max(i, 0), last) + k])
        for i in range(last + 1):
            pixels[i, k] = np.uint8((total * share + 32768) >> 16)
            total += np.int32(line[3 * min(i + width + 1, last) + k]) - np.int32(line[3 * max(i - width, 0) + k])


@compiled("void(u1[:, :, ::1], i8)")
def blur(picture: Any, width: int) -> None:
    """Blurs the rows of a picture, and then its columns, in place. See `blur_line`."""
    line = np.empty(3 * len(picture), np.uint8)
    for row in range(len(picture)):
        blur_line(picture[row], line, width)
    for column in range(len(picture)):
        blur_line(picture[:, column], line, width)


@inlined
def _mixed(a: float, b: float, c: float, d: float) -> Any:
    """The Hadamard transform of four numbers, ordered by frequency. Applied twice, it multiplies them by four."""
    return a + b + c + d, a + b - c - d, a - b - c + d, a - b + c - d


@inlined
def _round(tile: Any, step: int) -> None:
    """Rounds the Hadamard coefficients of a tile in place, shape (4, 4)."""
    for i in range(TILE):
        tile[i, 0], tile[i, 1], tile[i, 2], tile[i, 3] = _mixed(tile[i, 0], tile[i, 1], tile[i, 2], tile[i, 3])
    for j in range(TILE):
        tile[0, j], tile[1, j], tile[2, j], tile[3, j] = _mixed(tile[0, j], tile[1, j], tile[2, j], tile[3, j])
        for i in range(TILE):
            coarse = np.float64(step * (1 + i + j))
            tile[i, j] = math.floor(tile[i, j] / coarse + 0.5) * coarse
        tile[0, j], tile[1, j], tile[2, j], tile[3, j] = _mixed(tile[0, j], tile[1, j], tile[2, j], tile[3, j])
    for i in range(TILE):
        tile[i, 0], tile[i, 1], tile[i, 2], tile[i, 3] = _mixed(tile[i, 0], tile[i, 1], tile[i, 2], tile[i, 3])


@inlined
def _level(coefficient: float) -> Any:
    """The level of a pixel, 0 to 255, from the rounded coefficients' transform."""
    return np.uint8(min(max(coefficient / 16.0 + 0.5, 0.0), 255.0))


@inlined
def _is_plain(pixels: Any) -> bool:
    """Whether all pixels of a tile are equal, as in most tiles."""
    for i in range(TILE):
        for j in range(TILE):
            for k in range(3):
                if pixels[i, j, k] != pixels[0, 0, k]:
                    return False
    return True


@inlined
def quantise_tile(pixels: Any, step: int, tile: Any) -> None:
    """Rounds the coefficients of a tile of pixels in place, shape (4, 4, 3). `tile` is overwritten, shape (4, 4)."""
    plain = _is_plain(pixels)
    for k in range(3):
        if plain:  # all coefficients except the mean are 0
            level = _level(math.floor(16.0 * pixels[0, 0, k] / step + 0.5) * step)
            for i in range(TILE):
                for j in range(TILE):
                    pixels[i, j, k] = level
            continue
        for i in range(TILE):
            for j in range(TILE):
                tile[i, j] = pixels[i, j, k]
        _round(tile, step)
        for i in range(TILE):
            for j in range(TILE):
                pixels[i, j, k] = _level(tile[i, j])


@compiled("void(u1[:, :, ::1], i8)")
def quantise(picture: Any, step: int) -> None:
    """Rounds the coefficients of tiles of 4 x 4 pixels in place. Higher frequencies get larger steps, as in JPEG.

    The coefficients are those of the Hadamard transform, which are integers. Pixels outside whole tiles are unchanged.
    """
    size, tile = len(picture) // TILE * TILE, np.empty((TILE, TILE), np.float64)
    for top in range(0, size, TILE):
        for left in range(0, size, TILE):
            quantise_tile(picture[top : top + TILE, left : left + TILE], step, tile)


@inlined
def dirty_row(row: int, line: Any, x: float, y: float, radius: float) -> None:
    """Adds a grey spot with a soft edge to a row of a picture in place.

    Args:
        row: its number, from the top.
        line: its pixels, shape (size, 3).
        x: the distance of the spot to the right of the picture's centre, in half sides of the picture.
        y: the distance of the spot above the picture's centre, in half sides of the picture.
        radius: the radius of the spot, in sides of the picture.
    """
    size = len(line)
    down = (row + 0.5) / size - 0.5 + product(0.5, y)
    if abs(down) > DIRTY * radius:
        return
    for column in range(size):
        across = (column + 0.5) / size - 0.5 - product(0.5, x)
        if abs(across) > DIRTY * radius:
            continue
        away = math.sqrt(product(across, across) + product(down, down))
        cover = np.int32(min(max(OPACITY * (DIRTY - away / radius), 0.0), MOST_OPAQUE))
        for k in range(3):
            line[column, k] = np.uint8(((255 - cover) * np.int32(line[column, k]) + cover * DIRT_LEVEL + 127) // 255)


@compiled("void(u1[:, :, ::1], f8, f8, f8)")
def add_dirt(picture: Any, x: float, y: float, radius: float) -> None:
    """Adds a grey spot to a picture in place. See `dirty_row`."""
    for row in range(len(picture)):
        dirty_row(row, picture[row], x, y, radius)
