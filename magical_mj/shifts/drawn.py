"""Shifts of the pictures: camera, light, ground, colours, and sensor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.observations import VIEWS
from magical_mj.scene import constants as c
from magical_mj.shifts.shift import GROUND_REACH, Factor, Frame, Picture, Shift

CONSTANT: Final = (1.0, 1.0, 1.0, 1.0, 1.0)
"""The sizes of a factor that does not depend on the strength."""


class Camera(Shift):
    """Moves, turns and zooms both cameras. The "ego" camera moves in the robot's frame, "allo" in the world frame."""

    name = "camera"
    summary = "offset, heading and zoom of both cameras"
    factors = (
        Factor("x", "offset to the right, in sides of the view", (0.04, 0.08, 0.16, 0.24, 0.32)),
        Factor("y", "offset upwards, in sides of the view", (0.04, 0.08, 0.16, 0.24, 0.32)),
        Factor("heading", "degrees", (3, 6, 12, 20, 30)),
        Factor("zoom", "change of the side of the view, relative", (0.03, 0.06, 0.12, 0.2, 0.3)),
    )

    def model(self, model: Any) -> None:
        """Moves the cameras."""
        half = math.radians(self.values["heading"]) / 2
        for camera in range(model.ncam):
            if model.camera(camera).name.removeprefix("robot/") in VIEWS:
                model.cam_pos[camera, :2] += [c.VISIBLE_SIZE * self.values[axis] for axis in ("x", "y")]
                model.cam_quat[camera] = math.cos(half), 0, 0, math.sin(half)
                model.cam_fovy[camera] = c.VISIBLE_SIZE * (1 + self.values["zoom"])

    def ground(self, ground: Picture) -> Picture:
        """Returns the ground unchanged. It is overridden because then the picture's ground extends beyond the model's.

        The model's own ground ends where the unshifted cameras' view ends.
        """
        return ground


class Light(Shift):
    """Brightness, contrast, colour of the light, a gradient over the ground, and the shadow of a bar outside the view.

    No level is clipped at white, so that pale objects stay distinct from the white ground.
    """

    name = "light"
    summary = "brightness, contrast, colour cast, gradient, shadow"
    factors = (
        Factor("brightness", "lost share of all levels", (0.05, 0.1, 0.18, 0.28, 0.4), "positive"),
        Factor("contrast", "change of all distances from white, relative", (0.06, 0.12, 0.2, 0.3, 0.4)),
        Factor("red", "change of red levels, relative", (0.02, 0.04, 0.07, 0.11, 0.16)),
        Factor("blue", "change of blue levels, relative", (0.02, 0.04, 0.07, 0.11, 0.16)),
        Factor(
            "slope",
            "lost share of all levels at a wall, 0 at the opposite one",
            (0.05, 0.1, 0.18, 0.28, 0.4),
            "positive",
        ),
        Factor("towards", "direction of the slope, half turns", CONSTANT),
        Factor("shadow", "share of the light that the shadow removes", (0.06, 0.12, 0.22, 0.34, 0.48), "exact"),
        Factor("across", "direction across the shadow, half turns", CONSTANT),
        Factor("away", "distance of the shadow from the centre, world units", CONSTANT),
    )

    @cached_property
    def numbers(self) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
        """The arguments `tones`, `slope` and `bar` of `kernels.relight`."""
        v = self.values
        levels = np.arange(256.0)
        tint = np.array([1 + v["red"], 1.0, 1 + v["blue"]])
        tones = np.clip(255 - (255 - levels) * (1 + v["contrast"]), 0, 255) * (1 - v["brightness"])
        tones = tones * (tint / tint.max())[:, None]
        towards, across = math.pi * v["towards"], math.pi * v["across"]
        slope = np.array([math.cos(towards), math.sin(towards), v["slope"]])
        bar = np.array([math.cos(across), math.sin(across), v["away"], 0.25, 0.1, v["shadow"]])
        return np.round(256 * tones).astype(np.int32), slope, bar

    def picture(self, picture: Picture, frame: Frame) -> Picture:
        """Applies the light."""
        from magical_mj.shifts.kernels import relight

        relight(picture, *self.numbers, frame.camera)
        return picture


TINTS, TILES, WOOD, CLOUDS = range(4)


class Texture(Shift):
    """Gives ground and surroundings a plain tint, tiles, wood or clouds, each with two colours of its own."""

    name = "texture"
    summary = "tints, tiles, wood and clouds on the ground and around it"
    factors = (
        Factor("pattern", "0 plain tint, 1 tiles, 2 wood, 3 clouds", (4, 4, 4, 4, 4), "choice"),
        Factor("opacity", "opacity of the pattern over the plain ground", (0.08, 0.16, 0.3, 0.5, 0.8), "exact"),
        Factor("size", "size of the pattern, in doublings", CONSTANT),
        Factor("turn", "angle of the pattern, half turns", CONSTANT),
    )

    def ground(self, ground: Picture) -> Picture:
        """Adds the pattern."""
        cells, rng = len(ground), self.rng(0)
        centres = (np.arange(cells, dtype=np.float32) + 0.5) * np.float32(2 * GROUND_REACH / cells) - GROUND_REACH
        angle, scale = math.pi * self.values["turn"], 2.0 ** self.values["size"]
        east, north = centres[None, :] / np.float32(scale), -centres[:, None] / np.float32(scale)
        u = np.float32(math.cos(angle)) * east + np.float32(math.sin(angle)) * north
        v = np.float32(math.cos(angle)) * north - np.float32(math.sin(angle)) * east
        index = np.clip(255 * _pattern(int(self.values["pattern"]), u, v, rng), 0, 255).astype(np.uint8)
        inside = slice(round(len(ground) * (0.5 - 0.5 / GROUND_REACH)), round(len(ground) * (0.5 + 0.5 / GROUND_REACH)))
        opacity = self.values["opacity"]
        textured = ground.copy()
        for area in ((slice(None), slice(None)), (inside, inside)):
            first, second = _tint(rng), _tint(rng)
            mixed = first + np.linspace(0, 1, 256)[:, None] * (second - first)
            blend = (opacity * mixed + (1 - opacity) * ground[area][0, 0]).astype(np.uint8)
            textured[area] = blend.take(index[area], axis=0)
        return textured


def _tint(rng: np.random.Generator) -> NDArray[np.float64]:
    """A random colour of medium saturation and brightness, unlike those of blocks and regions. Levels, shape (3,)."""
    hue, saturation, value = rng.random(), 0.15 + 0.4 * rng.random(), 0.45 + 0.35 * rng.random()
    return 255 * value * (1 - saturation * np.clip(np.abs((hue * 6 + np.array([0, 4, 2])) % 6 - 3) - 1, 0, 1))


def _pattern(pattern: int, u: NDArray[Any], v: NDArray[Any], rng: np.random.Generator) -> NDArray[Any]:
    """The share of a pattern's second colour at u, v (world units), from 0 to 1. Shape (cells, cells)."""
    if pattern == TINTS:
        return np.zeros_like(u)
    if pattern == TILES:
        return ((np.floor(u / 0.25) + np.floor(v / 0.25)) % 2).astype(np.float32)
    if pattern == WOOD:
        plank = np.floor(u / 0.3)
        waves = np.sin(60 * u + 3 * np.sin(4 * v + 2.4 * plank) + 5 * np.sin(plank * 78.2))
        return (0.5 + 0.3 * waves - 0.5 * (u / 0.3 - plank < 0.06)).astype(np.float32)
    total = np.zeros_like(u)
    for waves in (2.0, 5.0, 12.0):
        for towards, phase in rng.random((2, 2)) * 2 * math.pi:
            along = np.float32(waves * math.cos(towards)) * u + np.float32(waves * math.sin(towards)) * v
            total += np.sin(along + np.float32(phase)) / np.float32(waves**0.5)
    return 0.5 + total / 3


class Palette(Shift):
    """Turns all hues by the same angle, so that the four colours keep their order, and changes the saturation."""

    name = "palette"
    summary = "hue and saturation of every colour"
    factors = (
        Factor("hue", "turn of all hues, degrees", (8, 16, 32, 64, 120)),
        Factor("saturation", "change of all saturations, relative", (0.06, 0.12, 0.2, 0.3, 0.4)),
    )

    def model(self, model: Any) -> None:
        """Changes the colours of all geoms and skins."""
        for colours in (model.geom_rgba, *([model.skin_rgba] if model.nskin else [])):
            colours[:, :3] = turned(colours[:, :3], self.values["hue"], self.values["saturation"])


def turned(colours: NDArray[Any], degrees: float, change: float) -> NDArray[Any]:
    """Colours with turned hues and changed saturation. Their largest channel keeps its value. Shape (n, 3).

    Args:
        colours: RGB in [0, 1], shape (n, 3).
        degrees: the angle that is added to hues.
        change: the relative change of saturation.
    """
    most, least = colours.max(axis=1, keepdims=True), colours.min(axis=1, keepdims=True)
    spread = np.where(most > least, most - least, 1)
    r, g, b = ((colours - least) / spread).T
    hue = np.where(r >= np.maximum(g, b), (g - b) % 6, np.where(g >= b, 2 + b - r, 4 + r - g)) + degrees / 60
    saturation = np.clip((most - least) / np.where(most > 0, most, 1) * (1 + change), 0, 1)
    missing = np.clip(np.abs((hue[:, None] + np.array([0, 4, 2])) % 6 - 3) - 1, 0, 1)
    return (most * (1 - saturation * (1 - missing))).astype(np.float32)


NOISE, BLUR, BLOCKS, DIRT, LOSS = range(5)
AMOUNTS: Final = (
    (6, 12, 20, 32, 48),  # standard deviation of noise, levels
    (0.005, 0.01, 0.016, 0.024, 0.036),  # half the width of the blur, sides of the picture
    (32, 64, 112, 192, 320),  # 16 times the step of coefficients, levels
    (0.06, 0.1, 0.15, 0.21, 0.28),  # radius of the dirt, sides of the picture
    (0.03, 0.06, 0.12, 0.25, 0.5),  # probability that a frame is lost
)
"""The size of each fault (row) at each grade (column)."""
NOISE_SAMPLES: Final = 2**17


class Sensor(Shift):
    """One fault of the sensor per episode: noise, blur, block artefacts, a spot of dirt, or lost frames (grey).

    Noise and lost frames are drawn at every step.
    """

    name = "sensor"
    summary = "noise, blur, block artefacts, dirt or lost frames: one per episode"
    factors = (
        Factor("fault", "0 noise, 1 blur, 2 block artefacts, 3 dirt, 4 lost frames", (5, 5, 5, 5, 5), "choice"),
        Factor("grade", "severity of the fault", (1, 2, 3, 4, 5), "exact"),
        Factor("x", "x of the dirt, in half sides of the picture", (0.7,) * 5),
        Factor("y", "y of the dirt, in half sides of the picture", (0.7,) * 5),
    )

    @property
    def fault(self) -> int:
        """The fault, or -1 without one."""
        return int(self.values["fault"]) if self.values["grade"] >= 1 else -1

    @property
    def amount(self) -> float:
        """The size of the fault in this episode, from `AMOUNTS`."""
        return AMOUNTS[self.fault][int(self.values["grade"]) - 1] if self.fault >= 0 else 0

    @cached_property
    def noise(self) -> NDArray[np.int8]:
        """The noise of the episode. Each picture uses a part of it."""
        levels = np.float32(self.amount) * self.rng(0).standard_normal(NOISE_SAMPLES, np.float32)
        return np.clip(levels, -127, 127).astype(np.int8)

    def chance(self, view: str, step: int) -> float:
        """A picture's random number in [0, 1), for noise and lost frames. Frames of both views are lost together."""
        return self.uniform(step, *([VIEWS.index(view)] if self.fault == NOISE else []))

    @property
    def numbers(self) -> tuple[int, float, float, float]:
        """The argument `sensor` of `spoil`."""
        return self.fault, self.amount, self.values["x"], self.values["y"]

    def picture(self, picture: Picture, frame: Frame) -> Picture:
        """Applies the fault."""
        noise = self.noise if self.fault == NOISE else None
        spoil(picture, self.numbers, noise, self.chance(frame.view, frame.step))
        return picture


def spoil(picture: Picture, sensor: Sequence[float], noise: Any, chance: float) -> None:
    """Applies a sensor's fault to a picture in place.

    Args:
        picture: shape (size, size, 3).
        sensor: the fault, its amount, and x and y of the dirt.
        noise: the episode's noise, if it is the fault.
        chance: the picture's random number, see `Sensor.chance`.
    """
    from magical_mj.shifts import kernels

    fault, amount, x, y = sensor
    if fault == NOISE:
        kernels.add_noise(picture.reshape(-1), noise, chance)
    elif fault == BLUR:
        kernels.blur(picture, max(1, round(amount * len(picture))))
    elif fault == BLOCKS:
        kernels.quantise(picture, int(amount))
    elif fault == DIRT:
        kernels.add_dirt(picture, x, y, amount)
    elif fault == LOSS and chance < amount:
        picture[:] = kernels.GREY
