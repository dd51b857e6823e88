"""Paper: from drawn pixels to a picture."""

from __future__ import annotations

from typing import Final

import numpy as np

from magical_mj.rendering.canvas import Picture

OVERSAMPLING: Final = 2
"""Drawn pixels per side of a picture's pixel."""

_LANES: Final = 0x0001_0001_0001_0001
"""A pixel in a word of 64 bits: red, green, blue and alpha have 16 each, alpha the highest."""
_ROUND, _LEVELS, _COLOURS = np.uint64(2 * _LANES), np.uint64(0xFF * _LANES), np.uint64(_LANES >> 16)
_TWO_BITS, _THREE_LANES, _FULL = np.uint64(2), np.uint64(48), np.uint64(0xFF)


def on_paper(pixels: Picture, out: Picture | None = None) -> Picture:
    """The picture of a drawing: averaged 2 x 2, on white paper, top row first.

    Args:
        pixels: red, green, blue (all 0 where nothing was drawn) and alpha (0 there, else 255), bottom row first.
            Shape (2 * height, 2 * width, 4).
        out: where to write it, shape (height, width, 3); None: into a fresh array.
    """
    height, width = pixels.shape[0] // OVERSAMPLING, pixels.shape[1] // OVERSAMPLING
    rows = pixels.reshape(height, OVERSAMPLING, -1)[::-1]
    sums = np.add(rows[:, 0], rows[:, 1], dtype=np.uint16).view(np.uint64)
    mixed = sums[:, ::2] + sums[:, 1::2]
    mixed += _ROUND
    mixed >>= _TWO_BITS
    mixed &= _LEVELS  # exact averages, rounded
    paper = mixed >> _THREE_LANES
    paper ^= _FULL  # the white that shows through; colour + paper is at most 255
    paper *= _COLOURS
    mixed += paper
    levels = mixed.view(np.uint8).reshape(height, width, -1)
    picture = np.empty((height, width, 3), np.uint8) if out is None else out
    for channel in range(3):  # three long loops instead of one for each pixel
        picture[..., channel] = levels[..., 2 * channel]
    return picture
