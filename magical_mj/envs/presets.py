"""The observation presets of the Gymnasium environments: which frames they contain and how these are stacked.

A stack is the last few pictures as one array, oldest first along the channels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from magical_mj.scene.state_vector import SEGMENTATIONS, STATE_NAMES
from magical_mj.utils.errors import check_name

Layout = Literal["dict", "hwc", "chw", "state"]

LONGEST_SENTENCE: Final = 400
STATE_BOUND: Final = 1000.0  # of any entry of the state vector; angles add up to 100 rad in the longest episode


@dataclass(frozen=True)
class Preset:
    """How observations are made from pictures.

    Attributes:
        frames: the views and how many of the latest frames of each, in the order in which they are stacked: pictures,
            or segmentations (docs/pictures.md says what their ids are).
        layout: "hwc" and "chw" stack all frames along the channels of one array, oldest first; "dict" gives
            one such array (height x width x channels) per view; "state" is the state vector instead.
        image_size: default side of the pictures in pixels.
        summary: one line of description.
        fingers: whether the dict also has "fingers", the angles of the left and the right finger (rad), which the
            paper's learners do not see.
    """

    frames: tuple[tuple[str, int], ...]
    layout: Layout
    image_size: int
    summary: str
    fingers: bool = False

    @property
    def depth(self) -> int:
        """The number of channels of a frame: of a picture 3, of a segmentation 1."""
        return 1 if any(view in SEGMENTATIONS for view, _ in self.frames) else 3


PRESETS: Final[Mapping[str, Preset]] = MappingProxyType(
    {
        "": Preset((("ego", 1), ("allo", 1)), "dict", 384, "a dict of the current ego and allo picture"),
        "LoRes4E": Preset((("ego", 4),), "hwc", 96, "the last four ego frames (the paper's default)"),
        "LoRes4A": Preset((("allo", 4),), "hwc", 96, "the last four allo frames"),
        "LoRes3EA": Preset((("allo", 1), ("ego", 3)), "hwc", 96, "the current allo frame, then the last three ego"),
        "LoResStack": Preset((("ego", 4), ("allo", 4)), "dict", 96, "a dict of the last four frames of each view"),
        "LoResFingers": Preset(
            (("ego", 1), ("allo", 1)), "dict", 96, "a dict of both current frames and the angles of the fingers", True
        ),
        "LoResCHW4E": Preset((("ego", 4),), "chw", 96, "LoRes4E with the channels first, as PyTorch wants them"),
        "LoResSeg4E": Preset((("ego-segmentation", 4),), "hwc", 96, "LoRes4E as segmentations: ids of what is where"),
        "LoResSeg4A": Preset((("allo-segmentation", 4),), "hwc", 96, "LoRes4A as segmentations"),
        "State": Preset((), "state", 96, "the state vector (magical_mj.observations.STATE_NAMES)"),
    }
)
"""The presets by name; the empty name is used when an environment is made without a preset."""
DEFAULT_PRESET: Final = "LoRes4E"
"""What a policy gets that does not say what it observes."""


def preset_named(name: str) -> Preset:
    """The preset with this name; raises `UnknownNameError` if there is none."""
    if not isinstance(name, str) or name:
        check_name("preset", name, filter(None, PRESETS))
    return PRESETS[name]


def observation_space(
    preset: Preset, shapes: Mapping[str, tuple[int, ...]], *, instruction: bool = False
) -> spaces.Space[Any]:
    """The space of a preset's observations, whose stacks have these shapes by name (ignored for the state).

    With `instruction`, dicts hold the sentence that says what is to be done.
    """
    if preset.layout == "state":
        return spaces.Box(-STATE_BOUND, STATE_BOUND, (len(STATE_NAMES),), np.float32)
    boxes: dict[str, spaces.Space[Any]] = {name: spaces.Box(0, 255, shape, np.uint8) for name, shape in shapes.items()}
    if preset.fingers:
        boxes["fingers"] = spaces.Box(-np.pi, np.pi, (2,), np.float32)  # rad, the left one first
    if instruction:
        boxes["instruction"] = spaces.Text(LONGEST_SENTENCE, charset=frozenset(map(chr, range(32, 127))))
    return spaces.Dict(boxes) if preset.layout == "dict" else next(iter(boxes.values()))


def observed(preset: str) -> str:
    """The preset's name and the shape of its observations, or the shapes of their parts, in words."""
    how = PRESETS[preset]
    space = observation_space(how, Stacks(how, how.image_size).shapes)
    if not isinstance(space, spaces.Dict):
        return f"{preset} {space.shape}"
    parts = ", ".join(f"{name} {part.shape}" for name, part in space.items())
    return f"{preset or 'the preset without a name'}, a dict of {parts}"


Images = NDArray[np.uint8]

Draw = Callable[[str, Images], object]
"""Writes a frame of a view into an array of shape (size, size, depth), which may be a view of a larger array."""


class FrameStack:
    """The last frames of one or more views in one array, the frames of each view oldest first.

    The latest stack is a window into a longer buffer. For the next one the window moves by one frame. So every frame
    is one place earlier in the new window, and only the newest frames are drawn, in place.

    Args:
        frames: the views and how many frames of each, in the order in which they are stacked.
        size: side of the frames in pixels.
        depth: the number of channels of a frame.
        channels_first: stacks of shape (channels, size, size) instead of (size, size, channels).
    """

    MOVES: Final = 16
    """The number of times that the window moves before it returns to the beginning of the buffer."""

    def __init__(
        self, frames: tuple[tuple[str, int], ...], size: int, depth: int = 3, *, channels_first: bool = False
    ) -> None:
        count = depth * sum(number for _, number in frames)
        self.has_history = any(number > 1 for _, number in frames)
        """Whether a stack depends on the one before."""
        self.shape = (count, size, size) if channels_first else (size, size, count)
        self._channels_last = (1, 2, 0) if channels_first else (0, 1, 2)
        ends = np.cumsum([depth * number for _, number in frames]).tolist()
        self._channels = [(view, end - depth * number, end) for (view, number), end in zip(frames, ends, strict=True)]
        self._depth, self._shift = depth, depth * size * size if channels_first else depth
        self._memory = np.zeros(count * size * size + self.MOVES * self._shift, np.uint8)
        self._first = 0

    @property
    def latest(self) -> Images:
        """The latest stack: a view into the buffer, which changes with the next `push`."""
        return self._memory[self._first : self._first + math.prod(self.shape)].reshape(self.shape)

    def start(self, draw: Draw) -> None:
        """Makes the first picture of an episode all frames of the stack."""
        self._draw_newest(draw)
        pixels, depth = self.latest.transpose(self._channels_last), self._depth
        for _, first, end in self._channels:
            for channel in range(first, end - depth):
                pixels[..., channel] = pixels[..., end - depth + (channel - first) % depth]

    def push(self, draw: Draw) -> None:
        """Adds the newest picture of each view; the oldest is gone."""
        if self._first == self.MOVES * self._shift:
            latest, self._first = self.latest.copy(), 0
            self.latest[:] = latest
        self._first += self._shift
        self._draw_newest(draw)

    def _draw_newest(self, draw: Draw) -> None:
        """Draws the newest frame of each view into the latest stack."""
        pixels = self.latest.transpose(self._channels_last)
        for view, _, end in self._channels:
            draw(view, pixels[..., end - self._depth : end])


class Stacks:
    """All stacks of a preset by name: one for each view in the layout "dict", none for the state vector, else one.

    The name of that one says what it holds, such as "allo1+ego3", since stacks of other presets may have its shape.
    Frames have `size` pixels a side.
    """

    def __init__(self, preset: Preset, size: int) -> None:
        first = preset.layout == "chw"
        if preset.layout == "dict":
            groups = {view: ((view, count),) for view, count in preset.frames}
        else:
            name = "+".join(f"{view}{count}" for view, count in preset.frames) + "-chw" * first
            groups = {name: preset.frames} if preset.frames else {}
        self._stacks = {
            name: FrameStack(frames, size, preset.depth, channels_first=first) for name, frames in groups.items()
        }

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The shape of each stack."""
        return {name: stack.shape for name, stack in self._stacks.items()}

    def start(self, draw: Draw, frames: Mapping[str, Images] | None = None) -> None:
        """Begins the stacks of an episode; those given in `frames` (from `save`) are restored if they fit."""
        for name, stack in self._stacks.items():
            saved = (frames or {}).get(name)
            fits = isinstance(saved, np.ndarray) and (saved.dtype, saved.shape) == (np.uint8, stack.shape)
            if saved is not None and fits and stack.has_history:
                stack.latest[:] = saved
            else:
                stack.start(draw)

    def push(self, draw: Draw) -> None:
        """Adds the newest pictures to the stacks."""
        for stack in self._stacks.values():
            stack.push(draw)

    @property
    def latest(self) -> dict[str, Images]:
        """The stacks, which change with the next `push`."""
        return {name: stack.latest for name, stack in self._stacks.items()}

    def save(self) -> dict[str, Images]:
        """Copies of the stacks, except those that hold only present pictures."""
        return {name: stack.latest.copy() for name, stack in self._stacks.items() if stack.has_history}


def copying(pictures: Mapping[str, Images]) -> Draw:
    """A `Draw` that copies pictures which exist already."""

    def write(view: str, place: Images) -> None:
        frame = pictures[view].reshape(place.shape)  # of a segmentation: with its channel
        for channel in range(place.shape[-1]):  # three strided copies are faster than one of triples
            place[..., channel] = frame[..., channel]

    return write
