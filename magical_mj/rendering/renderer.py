"""Drawing: what each environment keeps to draw its pictures.

What makes a frame cheap on software OpenGL, where every drawn pixel costs:

- It is drawn at twice the size and averaged 2 x 2: cheaper, and nearer to the original, than multisampling.
- Things are painted in the order in which the model lists them, still scenery first, so the canvas needs no depth
  buffer. Their heights have the same order: any other MuJoCo viewer, which does use depth, shows the same picture.
- The paper is white, as the arena's floor is: where nothing was drawn (alpha 0), white shows through.
"""

from __future__ import annotations

import operator
from typing import Any, Final

import mujoco
import numpy as np
from PIL import Image

from magical_mj.rendering.canvas import CANVAS, DRAWN_GROUPS, Context, Picture, drawn

OVERSAMPLING: Final = 2
"""Drawn pixels per side of a picture's pixel."""
LARGEST: Final = 2048
"""Side of the largest picture, in pixels."""


def check_size(image_size: Any) -> int:
    """`image_size` as an int; a ValueError unless it is an integer in 1..LARGEST."""
    try:
        size = 0 if isinstance(image_size, bool) else operator.index(image_size)
    except TypeError:
        size = 0
    if not 1 <= size <= LARGEST:
        raise ValueError(f"image_size must be an integer in 1..{LARGEST} (pixels per side), not {image_size!r}")
    return size


def on_paper(pixels: Picture) -> Picture:
    """The picture of a drawing: averaged 2 x 2, on white paper, top row first.

    Args:
        pixels: red, green, blue (all 0 where nothing was drawn) and alpha (0 there, else 255), bottom row first.
            Shape (2 * height, 2 * width, 4).
    """
    height, width = pixels.shape[0] // OVERSAMPLING, pixels.shape[1] // OVERSAMPLING
    drawing = Image.frombuffer("RGBX", (pixels.shape[1], pixels.shape[0]), pixels, "raw", "RGBX", 0, 1)
    rows = drawing.reduce(OVERSAMPLING).tobytes("raw", "RGBX", 0, -1)  # exact averages, rounded; turned upside down
    mixed = np.frombuffer(rows, np.uint8).reshape(height, width, 4)
    paper = ~mixed[..., 3]  # the white that shows through; colour + paper is at most 255
    picture = np.empty((height, width, 3), np.uint8)
    for channel in range(3):
        np.add(mixed[..., channel], paper, out=picture[..., channel])
    return picture


class Renderer:
    """Draws the states of one model. Cheap to make (0.1 ms); nothing touches OpenGL before the first frame."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._scene: mujoco.MjvScene | None = None
        self._context: Context | None = None
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = self._option.skingroup[:] = [k in DRAWN_GROUPS for k in range(6)]
        self._option.sitegroup[:] = self._option.jointgroup[:] = self._option.tendongroup[:] = 0
        self._perturbation = mujoco.MjvPerturb()
        self._cameras: dict[str, mujoco.MjvCamera] = {}
        self._pixels: dict[int, Picture] = {}

    def draw(self, data: mujoco.MjData, camera: str, size: int) -> Picture:
        """A fresh picture of the present state, seen by a camera of the model: RGB, top row first.

        Shape (size, size, 3).

        Raises:
            RenderingError: if OpenGL does not work here; it says what to do.
        """
        if self._context is None or self._scene is None or CANVAS.gl is None:
            self._context = CANVAS.context_for(self._model)
            self._scene = self._new_scene()
        else:
            CANVAS.activate()
        scene, option, eye = self._scene, self._option, self._camera(camera)
        still, moving = mujoco.mjtCatBit.mjCAT_STATIC.value, mujoco.mjtCatBit.mjCAT_DYNAMIC.value
        mujoco.mjv_updateScene(self._model, data, option, None, eye, still, scene)
        mujoco.mjv_addGeoms(self._model, data, option, self._perturbation, moving, scene)
        pixels = self._buffer(size)
        CANVAS.draw(self._context, scene, pixels)
        return on_paper(pixels)

    def close(self) -> None:
        """Let go of the scene; the process's canvas stays for others. May be called twice."""
        self._scene = self._context = None
        self._pixels.clear()

    def _new_scene(self) -> mujoco.MjvScene:
        model = self._model
        scene = mujoco.MjvScene(model, int(drawn(model.geom_group).sum() + model.nskin + 1))
        scene.flags[:] = 0  # no shadows, reflections, haze, sky
        return scene

    def _camera(self, name: str) -> mujoco.MjvCamera:
        if name not in self._cameras:
            camera = mujoco.MjvCamera()
            camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
            camera.fixedcamid = self._model.camera(name).id
            self._cameras[name] = camera
        return self._cameras[name]

    def _buffer(self, size: int) -> Picture:
        if size not in self._pixels:
            self._pixels[size] = np.empty((OVERSAMPLING * size, OVERSAMPLING * size, 4), np.uint8)
        return self._pixels[size]
