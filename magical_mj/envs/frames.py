"""Stacks of frames: the last few pictures as one array, oldest first along the channels."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.envs.presets import Preset

Images = NDArray[np.uint8]

See = Callable[[str, Images], object]
"""Writes the picture of a view into an array of shape (size, size, 3), which may be a view of a larger array."""


class FrameStack:
    """The last frames of one or more views in one array, the frames of each view oldest first.

    The latest stack is a window into a longer buffer. For the next one the window moves by one frame. So every frame
    is one place earlier in the new window, and only the newest frames are drawn, in place.

    Args:
        frames: the views and how many frames of each, in the order in which they are stacked.
        size: side of the frames in pixels.
        channels_first: stacks of shape (channels, size, size) instead of (size, size, channels).
    """

    MOVES: Final = 16
    """The number of times that the window moves before it returns to the beginning of the buffer."""

    def __init__(self, frames: tuple[tuple[str, int], ...], size: int, *, channels_first: bool = False) -> None:
        count = 3 * sum(number for _, number in frames)
        self.remembers = any(number > 1 for _, number in frames)
        """Whether a stack depends on the one before."""
        self.shape = (count, size, size) if channels_first else (size, size, count)
        self._channels_last = (1, 2, 0) if channels_first else (0, 1, 2)
        ends = np.cumsum([3 * number for _, number in frames]).tolist()
        self._channels = [(view, end - 3 * number, end) for (view, number), end in zip(frames, ends, strict=True)]
        self._shift = 3 * size * size if channels_first else 3
        self._memory = np.zeros(count * size * size + self.MOVES * self._shift, np.uint8)
        self._first = 0

    @property
    def latest(self) -> Images:
        """The latest stack: a view into the buffer, which changes with the next `push`."""
        return self._memory[self._first : self._first + math.prod(self.shape)].reshape(self.shape)

    def start(self, see: See) -> Images:
        """The stack at the start of an episode: all its frames are the first picture. A fresh array."""
        latest = self._draw_newest(see)
        pixels = latest.transpose(self._channels_last)
        for _, first, end in self._channels:
            for channel in range(first, end - 3):
                pixels[..., channel] = pixels[..., end - 3 + (channel - first) % 3]
        return latest.copy()

    def push(self, see: See) -> Images:
        """The stack with the newest pictures added and the oldest gone. A fresh array."""
        if self._first == self.MOVES * self._shift:
            latest, self._first = self.latest.copy(), 0
            self.latest[:] = latest
        self._first += self._shift
        return self._draw_newest(see).copy()

    def _draw_newest(self, see: See) -> Images:
        """Draws the newest frame of each view into the latest stack, which is returned."""
        latest = self.latest
        pixels = latest.transpose(self._channels_last)
        for view, _, end in self._channels:
            see(view, pixels[..., end - 3 : end])
        return latest


class Stacks:
    """All stacks of a preset by name: one for each view in the layout "dict", none for the state vector, else one.

    The name of that one says what it holds, such as "allo1+ego3", since stacks of other presets may have its shape.

    Args:
        preset: the preset.
        size: side of the frames in pixels.
    """

    def __init__(self, preset: Preset, size: int) -> None:
        self._stacks: dict[str, FrameStack] = {}
        if preset.layout == "dict":
            self._stacks = {view: FrameStack(((view, count),), size) for view, count in preset.frames}
        elif preset.layout != "state":
            name = "+".join(f"{view}{count}" for view, count in preset.frames) + (
                "-chw" if preset.layout == "chw" else ""
            )
            self._stacks = {name: FrameStack(preset.frames, size, channels_first=preset.layout == "chw")}

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The shape of each stack."""
        return {name: stack.shape for name, stack in self._stacks.items()}

    def start(self, see: See, frames: Mapping[str, Images] | None = None) -> dict[str, Images]:
        """The stacks at the start of an episode; those given in `frames` (from `save`) are restored if they fit."""
        for name, stack in self._stacks.items():
            saved = (frames or {}).get(name)
            fits = isinstance(saved, np.ndarray) and (saved.dtype, saved.shape) == (np.uint8, stack.shape)
            if saved is not None and fits and stack.remembers:
                stack.latest[:] = saved
            else:
                stack.start(see)
        return {name: stack.latest.copy() for name, stack in self._stacks.items()}

    def push(self, see: See) -> dict[str, Images]:
        """The stacks with the newest pictures added."""
        return {name: stack.push(see) for name, stack in self._stacks.items()}

    def save(self) -> dict[str, Images]:
        """Copies of the stacks, except those that hold only present pictures."""
        return {name: stack.latest.copy() for name, stack in self._stacks.items() if stack.remembers}


def seen(pictures: Mapping[str, Images]) -> See:
    """A `See` that copies pictures which exist already."""

    def write(view: str, place: Images) -> None:
        for channel in range(3):  # three strided copies are faster than one of triples
            place[..., channel] = pictures[view][..., channel]

    return write
