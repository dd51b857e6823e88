"""Two shifts of one's own: fog in the pictures, and an arena that tilts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from magical_mj.shifts import Factor, Frame, Picture, Shift


class Fog(Shift):
    """Everything fades into grey, the more the farther it is from the middle of the picture."""

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
    """The arena tilts: a constant force pulls everything that is loose the same way."""

    name = "magnet"
    summary = "a constant force on everything"
    factors = (
        Factor("pull", "acceleration, world units / s^2", (0.4, 0.8, 1.2, 1.6, 2), "exact"),
        Factor("towards", "direction, half turns", (1, 1, 1, 1, 1)),
    )

    def model(self, model: Any) -> None:
        """Turns gravity, which otherwise is 0 in this flat world."""
        towards = math.pi * self.values["towards"]
        model.opt.gravity[:2] = self.values["pull"] * np.array([math.cos(towards), math.sin(towards)])
