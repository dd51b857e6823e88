"""Stacks of frames: the last few pictures as one array, oldest first along the channels."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

Images = NDArray[np.uint8]

See = Callable[[str, Images], object]
"""Writes the picture of a view into a place of shape (size, size, 3), which may be a part of something larger."""


class FrameStack:
    """The last frames of one or more views in one array, the frames of each view oldest first.

    A new stack is the last one moved by one frame in a single copy of its memory, which is five times as fast as
    joining the frames: what comes to lie in a place where it does not belong is a place of the newest frames, and
    these are drawn where they belong.

    Args:
        frames: the views and how many frames of each, in the order in which they are stacked.
        size: side of the frames in pixels.
        channels_first: stacks of shape (channels, size, size) instead of (size, size, channels).
    """

    def __init__(self, frames: tuple[tuple[str, int], ...], size: int, *, channels_first: bool = False) -> None:
        count = 3 * sum(number for _, number in frames)
        self.shape = (count, size, size) if channels_first else (size, size, count)
        self._channels_last = (1, 2, 0) if channels_first else (0, 1, 2)
        ends = np.cumsum([3 * number for _, number in frames]).tolist()
        self._channels = [(view, end - 3 * number, end) for (view, number), end in zip(frames, ends, strict=True)]
        self._shift = 3 * size * size if channels_first else 3
        self.last = np.empty(self.shape, np.uint8)
        """The latest stack."""

    def start(self, see: See) -> Images:
        """The stack of an episode's first pictures, which fill it. A fresh array."""
        self.last = np.empty(self.shape, np.uint8)
        self._draw_newest(see)
        pixels = self.last.transpose(self._channels_last)
        for _, first, end in self._channels:
            for channel in range(first, end - 3):
                pixels[..., channel] = pixels[..., end - 3 + (channel - first) % 3]
        return self.last

    def push(self, see: See) -> Images:
        """The stack with the newest pictures added and the oldest gone. A fresh array."""
        stack = np.empty(self.shape, np.uint8)
        stack.ravel()[: -self._shift] = self.last.ravel()[self._shift :]
        self.last = stack
        self._draw_newest(see)
        return stack

    def _draw_newest(self, see: See) -> None:
        pixels = self.last.transpose(self._channels_last)
        for view, _, end in self._channels:
            see(view, pixels[..., end - 3 : end])


def seen(pictures: Mapping[str, Images]) -> See:
    """How to see pictures that are there already."""

    def write(view: str, place: Images) -> None:
        for channel in range(3):  # three long loops instead of one for each pixel
            place[..., channel] = pictures[view][..., channel]

    return write
