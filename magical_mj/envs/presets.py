"""The observation presets of the Gymnasium environments: their frames, and how these are stacked.

A stack is one array with the last few frames, oldest first along the channels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
from gymnasium import spaces
from gymnasium.error import CustomSpaceError
from gymnasium.vector.utils import create_shared_memory
from numpy.typing import NDArray

from magical_mj.observations import SEGMENTATIONS, START_NAMES, STATE_NAMES
from magical_mj.utils.errors import check_name

Layout = Literal["dict", "hwc", "chw", "state"]

LONGEST_SENTENCE: Final = 400  # characters
STATE_BOUND: Final = 1000.0  # bound of all entries of the state vector; in the longest episode, angles reach 100 rad


@dataclass(frozen=True)
class Preset:
    """The content and layout of observations.

    Attributes:
        frames: each view with its number of frames, in stacking order. Views are pictures, or segmentations
            (docs/pictures.md lists their ids).
        layout: "hwc" and "chw" stack all frames along the channels of one array, oldest first. "dict" is a dict with
            such an array (height x width x channels) for each view. "state" is the state vector instead.
        image_size: default side of the frames in pixels.
        summary: a description in one line.
        fingers: whether the dict also contains "fingers", the angles of the left and the right finger (rad). The
            paper's learners do not observe them.
        start: whether the initial poses follow in the state vector (`START_NAMES`).
    """

    frames: tuple[tuple[str, int], ...]
    layout: Layout
    image_size: int
    summary: str
    fingers: bool = False
    start: bool = False

    @property
    def depth(self) -> int:
        """The number of channels of a frame: 3 for pictures, 1 for segmentations."""
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
        "LoResSeg4E": Preset((("ego-segmentation", 4),), "hwc", 96, "LoRes4E as segmentations: an id for each pixel"),
        "LoResSeg4A": Preset((("allo-segmentation", 4),), "hwc", 96, "LoRes4A as segmentations"),
        "State": Preset((), "state", 96, "the state vector (magical_mj.observations.STATE_NAMES)"),
        "StateStart": Preset((), "state", 96, "the state vector, then the initial poses (START_NAMES)", start=True),
    }
)
"""The presets by name. The empty name is the preset of environments that are made without one."""
DEFAULT_PRESET: Final = "LoRes4E"
"""The preset of policies that do not declare one."""


def preset_named(name: str) -> Preset:
    """The preset with this name. Raises `UnknownNameError` if it does not exist."""
    if not isinstance(name, str) or name:
        check_name("preset", name, filter(None, PRESETS))
    return PRESETS[name]


class Sentence(spaces.Text):
    """The space of instructions. `AsyncVectorEnv` needs ``shared_memory=False`` for it, and raises an error otherwise.

    Gymnasium 1.4 would read a text from shared memory only once, before the first episode.
    """


@create_shared_memory.register(Sentence)
def _refuse_shared_memory(space: Sentence, n: int = 1, ctx: Any = None) -> Any:
    del space, n, ctx
    raise CustomSpaceError("instructions cannot be in shared memory: give shared_memory=False")


def observation_space(preset: Preset, size: int | None = None, *, instruction: bool = False) -> spaces.Space[Any]:
    """The space of a preset's observations, with pictures of this size, by default the preset's.

    With `instruction`, dicts contain the sentence that describes the task.
    """
    if preset.layout == "state":
        entries = len(STATE_NAMES) + (len(START_NAMES) if preset.start else 0)
        return spaces.Box(-STATE_BOUND, STATE_BOUND, (entries,), np.float32)
    boxes: dict[str, spaces.Space[Any]] = {
        name: spaces.Box(0, 255, stack.shape, np.uint8) for name, stack in frame_stacks(preset, size).items()
    }
    if preset.fingers:
        boxes["fingers"] = spaces.Box(-np.pi, np.pi, (2,), np.float32)  # left, right; rad
    if instruction:
        boxes["instruction"] = Sentence(LONGEST_SENTENCE, charset=frozenset(map(chr, range(32, 127))))
    return spaces.Dict(boxes) if preset.layout == "dict" else next(iter(boxes.values()))


def observed(preset: str) -> str:
    """A phrase with the preset's name and the shapes of its observations."""
    definition = PRESETS[preset]
    space = observation_space(definition)
    if not isinstance(space, spaces.Dict):
        return f"{preset} {space.shape}"
    parts = ", ".join(f"{name} {part.shape}" for name, part in space.items())
    return f"{preset or 'the preset without a name'}, a dict of {parts}"


Images = NDArray[np.uint8]

Draw = Callable[[str, int, Images], object]
"""Draws a view with this side in pixels into an array, which may be a view of a larger array."""


class FrameStack:
    """The last frames of one or more views in one array. The frames of each view are ordered from the oldest.

    The stack is a window into a longer buffer. For each new stack, the window moves by one frame, so all older frames
    keep their memory. Only the newest frames are drawn, directly into the buffer.

    Attributes:
        shape: the shape of the stack.
        has_history: whether a stack depends on the previous stack.
    """

    MOVES: Final = 16
    """The number of moves of the window before it returns to the start of the buffer."""

    def __init__(self, frames: tuple[tuple[str, int], ...], size: int, depth: int, *, channels_first: bool) -> None:
        self._channels, count = list[tuple[str, int, int]](), 0
        for view, number in frames:
            self._channels.append((view, count, count + depth * number))
            count += depth * number
        self.has_history = any(number > 1 for _, number in frames)
        self.shape = (count, size, size) if channels_first else (size, size, count)
        self._channels_last = (1, 2, 0) if channels_first else (0, 1, 2)
        self._depth, self._size, self._shift = depth, size, depth * size * size if channels_first else depth
        self._memory = np.zeros(count * size * size + self.MOVES * self._shift, np.uint8)
        self._first = 0

    @property
    def latest(self) -> Images:
        """The current stack: a view into the buffer, which the next `push` changes."""
        return self._memory[self._first : self._first + math.prod(self.shape)].reshape(self.shape)

    def start(self, draw: Draw, saved: Any = None) -> None:
        """Starts an episode: with saved frames, if they fit; otherwise, its first frame fills the stack."""
        fits = isinstance(saved, np.ndarray) and (saved.dtype, saved.shape) == (np.uint8, self.shape)
        if fits and self.has_history:
            self.latest[:] = saved
            return
        self.push(draw)
        pixels, depth = self.latest.transpose(self._channels_last), self._depth
        for _, first, end in self._channels:
            for channel in range(first, end - depth):
                pixels[..., channel] = pixels[..., end - depth + (channel - first) % depth]

    def push(self, draw: Draw) -> None:
        """Adds the newest frame of each view and drops the oldest."""
        if self._first == self.MOVES * self._shift:
            latest, self._first = self.latest.copy(), 0
            self.latest[:] = latest
        self._first += self._shift
        pixels = self.latest.transpose(self._channels_last)
        for view, _, end in self._channels:
            draw(view, self._size, pixels[..., end - self._depth : end] if self._depth > 1 else pixels[..., end - 1])


def frame_stacks(preset: Preset, size: int | None = None) -> dict[str, FrameStack]:
    """The stacks of a preset by name, with pictures of this size, by default the preset's.

    The layout "dict" has a stack for each view, named after it. The layout "state" has none. Other layouts have one
    stack. Its name describes its frames, such as "allo1+ego3", since the stacks of two presets can have equal shapes.
    """
    first, size = preset.layout == "chw", preset.image_size if size is None else size
    if preset.layout == "dict":
        groups = {view: ((view, count),) for view, count in preset.frames}
    else:
        name = "+".join(f"{view}{count}" for view, count in preset.frames) + "-chw" * first
        groups = {name: preset.frames} if preset.frames else {}
    return {name: FrameStack(frames, size, preset.depth, channels_first=first) for name, frames in groups.items()}


def saved_frames(stacks: Mapping[str, FrameStack]) -> dict[str, Images]:
    """Copies of the stacks, except those that contain only current frames."""
    return {name: stack.latest.copy() for name, stack in stacks.items() if stack.has_history}
