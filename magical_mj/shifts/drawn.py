"""Shifts of what is seen: camera, light, ground, colours, and the sensor."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene import constants as c
from magical_mj.scene.state_vector import VIEWS
from magical_mj.shifts.shift import GROUND_REACH, Factor, Frame, Picture, Shift

CONSTANT: Final = (1.0, 1.0, 1.0, 1.0, 1.0)
"""The sizes of a factor that is the same at all strengths."""


class Camera(Shift):
    """Both cameras look from elsewhere, in the frames in which they are: "ego" in that of the robot."""

    name = "camera"
    summary = "offset, heading and zoom of both cameras"
    factors = (
        Factor("x", "offset to the right, in sides of the view", (0.04, 0.08, 0.16, 0.24, 0.32)),
        Factor("y", "offset upwards, in sides of the view", (0.04, 0.08, 0.16, 0.24, 0.32)),
        Factor("heading", "degrees", (3, 6, 12, 20, 30)),
        Factor("zoom", "change of the side of what is seen, relative", (0.03, 0.06, 0.12, 0.2, 0.3)),
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
        """As it is, without an end: the model's ends where the cameras of the benchmark see no further."""
        return ground


class Light(Shift):
    """Brightness, contrast, colour of the light, a gradient over the ground, and the shadow of a bar outside.

    Nothing gets brighter than white, so that pale things stay distinct from the white ground.
    """

    name = "light"
    summary = "brightness, contrast, colour cast, gradient, shadow"
    factors = (
        Factor("brightness", "lost part of all levels", (0.05, 0.1, 0.18, 0.28, 0.4), "positive"),
        Factor("contrast", "change of all distances from white, relative", (0.06, 0.12, 0.2, 0.3, 0.4)),
        Factor("red", "change of red levels, relative", (0.02, 0.04, 0.07, 0.11, 0.16)),
        Factor("blue", "change of blue levels, relative", (0.02, 0.04, 0.07, 0.11, 0.16)),
        Factor(
            "slope",
            "lost part of all levels at a wall, 0 at the opposite one",
            (0.05, 0.1, 0.18, 0.28, 0.4),
            "positive",
        ),
        Factor("towards", "direction of the slope, half turns", CONSTANT),
        Factor("shadow", "part of the light that the shadow takes", (0.06, 0.12, 0.22, 0.34, 0.48), "exact"),
        Factor("across", "direction across the shadow, half turns", CONSTANT),
        Factor("away", "distance of the shadow from the middle, world units", CONSTANT),
    )

    @cached_property
    def _numbers(self) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
        """Tones, slope and bar, as `kernels.relight` takes them."""
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
        """In the other light."""
        from magical_mj.shifts.kernels import relight

        relight(picture, *self._numbers, frame.camera)
        return picture


TINTS, TILES, WOOD, CLOUDS = range(4)


class Texture(Shift):
    """Ground and surroundings are tinted plainly, tiled, of wood or cloudy, each in two colours of its own."""

    name = "texture"
    summary = "tints, tiles, wood and clouds on the ground and around it"
    factors = (
        Factor("pattern", "0 plain tints, 1 tiles, 2 wood, 3 clouds", (4, 4, 4, 4, 4), "choice"),
        Factor("opacity", "of the pattern over the plain ground", (0.08, 0.16, 0.3, 0.5, 0.8), "exact"),
        Factor("size", "of the pattern, in doublings", CONSTANT),
        Factor("turn", "of the pattern, half turns", CONSTANT),
    )

    def ground(self, ground: Picture) -> Picture:
        """With the pattern."""
        cells, rng = len(ground), self.rng(0)
        middle = (np.arange(cells, dtype=np.float32) + 0.5) * np.float32(2 * GROUND_REACH / cells) - GROUND_REACH
        angle, scale = math.pi * self.values["turn"], 2.0 ** self.values["size"]
        east, north = middle[None, :] / np.float32(scale), -middle[:, None] / np.float32(scale)
        u = np.float32(math.cos(angle)) * east + np.float32(math.sin(angle)) * north
        v = np.float32(math.cos(angle)) * north - np.float32(math.sin(angle)) * east
        index = np.clip(255 * _pattern(int(self.values["pattern"]), u, v, rng), 0, 255).astype(np.uint8)
        inside = slice(round(len(ground) * (0.5 - 0.5 / GROUND_REACH)), round(len(ground) * (0.5 + 0.5 / GROUND_REACH)))
        opacity = self.values["opacity"]
        textured = ground.copy()
        for where in ((slice(None), slice(None)), (inside, inside)):
            first, second = _tint(rng), _tint(rng)
            mixed = first + np.linspace(0, 1, 256)[:, None] * (second - first)
            blend = (opacity * mixed + (1 - opacity) * ground[where][0, 0]).astype(np.uint8)
            textured[where] = blend.take(index[where], axis=0)
        return textured


def _tint(rng: np.random.Generator) -> NDArray[np.float64]:
    """A colour of any hue, neither pale nor bright: unlike those of blocks and regions. Levels, shape (3,)."""
    hue, saturation, value = rng.random(), 0.15 + 0.4 * rng.random(), 0.45 + 0.35 * rng.random()
    return 255 * value * (1 - saturation * np.clip(np.abs((hue * 6 + np.array([0, 4, 2])) % 6 - 3) - 1, 0, 1))


def _pattern(pattern: int, u: NDArray[Any], v: NDArray[Any], rng: np.random.Generator) -> NDArray[Any]:
    """How much of its second colour a pattern has at u, v (world units), from 0 to 1. Shape (cells, cells)."""
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
    """All hues are turned by the same angle, so that the four colours keep their order, and saturation changes."""

    name = "palette"
    summary = "hue and saturation of every colour"
    factors = (
        Factor("hue", "turn of all hues, degrees", (8, 16, 32, 64, 120)),
        Factor("saturation", "change of all saturations, relative", (0.06, 0.12, 0.2, 0.3, 0.4)),
    )

    def model(self, model: Any) -> None:
        """Turns the colours of everything that is drawn."""
        for colours in (model.geom_rgba, *([model.skin_rgba] if model.nskin else [])):
            colours[:, :3] = turned(colours[:, :3], self.values["hue"], self.values["saturation"])


def turned(colours: NDArray[Any], degrees: float, change: float) -> NDArray[Any]:
    """Colours with hues turned, and saturations changed relatively, of the same brightest channel. Shape (n, 3)."""
    most, least = colours.max(axis=1, keepdims=True), colours.min(axis=1, keepdims=True)
    spread = np.where(most > least, most - least, 1)
    r, g, b = ((colours - least) / spread).T
    hue = np.where(r >= np.maximum(g, b), (g - b) % 6, np.where(g >= b, 2 + b - r, 4 + r - g)) + degrees / 60
    saturation = np.clip((most - least) / np.where(most > 0, most, 1) * (1 + change), 0, 1)
    missing = np.clip(np.abs((hue[:, None] + np.array([0, 4, 2])) % 6 - 3) - 1, 0, 1)
    return (most * (1 - saturation * (1 - missing))).astype(np.float32)


NOISE, BLUR, BLOCKS, DIRT, LOSS = range(5)
NOISE_LEVELS: Final = (6, 12, 20, 32, 48)  # standard deviation of noise, levels
BLUR_WIDTHS: Final = (0.005, 0.01, 0.016, 0.024, 0.036)  # half the width of the blur, sides of the picture
COEFFICIENT_STEPS: Final = (32, 64, 112, 192, 320)  # 16 times the step of coefficients, levels
DIRT_RADII: Final = (0.06, 0.1, 0.15, 0.21, 0.28)  # radius of the dirt, sides of the picture
LOSS_RATES: Final = (0.03, 0.06, 0.12, 0.25, 0.5)  # probability that a frame is lost
NOISE_SAMPLES: Final = 2**17


class Sensor(Shift):
    """One fault of the sensor an episode: noise, blur, blocks as of JPEG, a spot of dirt, or lost frames (grey).

    Noise and losses are drawn for every step.
    """

    name = "sensor"
    summary = "noise, blur, blocks, dirt or lost frames: one an episode"
    factors = (
        Factor("fault", "0 noise, 1 blur, 2 blocks, 3 dirt, 4 lost frames", (5, 5, 5, 5, 5), "choice"),
        Factor("grade", "how bad it is", (1, 2, 3, 4, 5), "exact"),
        Factor("x", "position of the dirt to the right, in half sides of the picture", (0.7,) * 5),
        Factor("y", "position of the dirt upwards, in half sides of the picture", (0.7,) * 5),
    )

    @cached_property
    def _noise(self) -> NDArray[np.int8]:
        grade = int(self.values["grade"]) - 1
        levels = NOISE_LEVELS[grade] * self.rng(0).standard_normal(NOISE_SAMPLES, np.float32)
        return np.clip(levels, -127, 127).astype(np.int8)

    def _dirt(self, size: int) -> NDArray[np.uint8]:
        """How thick the dirt is, 0 to 255; soft at the edge. Shape (size, size)."""
        if self._mask.shape != (size, size):
            radius = DIRT_RADII[int(self.values["grade"]) - 1]
            at = (np.arange(size) + 0.5) / size - 0.5
            across, down = at[None, :] - self.values["x"] / 2, at[:, None] + self.values["y"] / 2
            self._mask = np.clip(255 * 1.6 * (1.2 - np.hypot(across, down) / radius), 0, 240).astype(np.uint8)
        return self._mask

    _mask: NDArray[np.uint8] = np.empty((0, 0), np.uint8)

    def picture(self, picture: Picture, frame: Frame) -> Picture:
        """As the sensor gives it."""
        from magical_mj.shifts import kernels

        fault, grade = int(self.values["fault"]), int(self.values["grade"]) - 1
        if grade < 0:
            return picture
        if fault == NOISE:
            noise = self._noise
            if picture.size > len(noise):
                noise = np.tile(noise, picture.size // len(noise) + 2)
            first = int(self.uniform(frame.step, VIEWS.index(frame.view)) * (len(noise) - picture.size + 1))
            kernels.add_noise(picture.reshape(-1), noise, first)
        elif fault == BLUR:
            kernels.blur(picture, max(1, round(BLUR_WIDTHS[grade] * len(picture))))
        elif fault == BLOCKS:
            kernels.quantise(picture, COEFFICIENT_STEPS[grade])
        elif fault == DIRT:
            kernels.add_dirt(picture, self._dirt(len(picture)), 60)
        elif self.uniform(frame.step) < LOSS_RATES[grade]:
            picture[:] = 128
        return picture
