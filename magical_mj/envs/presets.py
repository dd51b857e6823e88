"""The observation presets of the Gymnasium environments: which frames they contain and how these are stacked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
from gymnasium import spaces

from magical_mj.scene.state_vector import STATE_NAMES
from magical_mj.utils.errors import check_name

Layout = Literal["dict", "hwc", "chw", "state"]

STATE_BOUND: Final = 1000.0  # of any entry of the state vector; angles add up to 100 rad in the longest episode


@dataclass(frozen=True)
class Preset:
    """How observations are made from pictures.

    Attributes:
        frames: the views and how many of the latest frames of each, in the order in which they are stacked.
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
        "State": Preset((), "state", 96, "the state vector (magical_mj.scene.state_vector.STATE_NAMES)"),
    }
)
"""The presets by name; the empty name is used when an environment is made without a preset."""


def preset_named(name: str) -> Preset:
    """The preset with this name; raises `UnknownNameError` if there is none."""
    if not isinstance(name, str) or name:
        check_name("preset", name, filter(None, PRESETS))
    return PRESETS[name]


def observation_space(preset: Preset, shapes: Mapping[str, tuple[int, ...]]) -> spaces.Space[Any]:
    """The space of a preset's observations.

    Args:
        preset: the preset.
        shapes: of the stacks of frames by name; ignored if the preset observes the state.
    """
    if preset.layout == "state":
        return spaces.Box(-STATE_BOUND, STATE_BOUND, (len(STATE_NAMES),), np.float32)
    boxes: dict[str, spaces.Space[Any]] = {name: spaces.Box(0, 255, shape, np.uint8) for name, shape in shapes.items()}
    if preset.fingers:
        boxes["fingers"] = spaces.Box(-np.pi, np.pi, (2,), np.float32)  # rad, the left one first
    return spaces.Dict(boxes) if preset.layout == "dict" else next(iter(boxes.values()))
