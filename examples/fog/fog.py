"""Two shifts: fog in pictures, and a force on every object."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from magical_mj.shifts import Factor, Frame, Picture, Shift


class Fog(Shift):
    """Fades pictures into grey, more strongly far from their centre."""

    name = "fog"
    summary = "grey fog, thicker far from the middle of the picture"
    factors = (
        Factor("thickness", "part of the colours that is lost at the edge", (0.2, 0.35, 0.5, 0.65, 0.8), "exact"),
        Factor("grey", "level of the fog, from middle grey to white", (127, 127, 127, 127, 127), "positive"),
    )

    def picture(self, picture: Picture, frame: Frame) -> Picture:
        """The picture with fog."""
        across = np.linspace(-1, 1, len(picture))
        lost = self.values["thickness"] * np.clip(np.hypot(across[:, None], across), 0, 1)[..., None]
        return (picture * (1 - lost) + (128 + self.values["grey"]) * lost).astype(np.uint8)


class Magnet(Shift):
    """A constant acceleration in one direction, as in a tilted arena."""

    name = "magnet"
    summary = "a constant force on everything"
    factors = (
        Factor("pull", "acceleration, world units / s^2", (0.4, 0.8, 1.2, 1.6, 2), "exact"),
        Factor("towards", "direction, half turns", (1, 1, 1, 1, 1)),
    )

    def model(self, model: Any) -> None:
        """Sets gravity in the plane, which is 0 without this shift."""
        towards = math.pi * self.values["towards"]
        model.opt.gravity[:2] = self.values["pull"] * np.array([math.cos(towards), math.sin(towards)])
