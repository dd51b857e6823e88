"""Pictures of one model by OpenGL: the flat views in exact colours, and the view "scene" in 3-D.

On software OpenGL every drawn pixel costs time. Flat pictures are cheap because of this:

- They are drawn at twice the size and averaged 2 x 2: cheaper than multisampling, and closer to the original.
- The floor, which is white, is not drawn: pixels without a geom (alpha 0) become white afterwards.
"""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np

from magical_mj.rendering.canvas import CANVASES, Canvas
from magical_mj.rendering.drawing import Drawing
from magical_mj.rendering.picture import Picture

OVERSAMPLING: Final = 2
"""Drawn pixels per side of a picture's pixel."""
_EACH: Final = np.uint64(0x0001_0001_0001_0001)
"""One in each quarter of a word: red, green, blue, alpha, lowest first."""
_EACH_COLOUR: Final = np.uint64(0x0000_0001_0001_0001)


class FlatRenderer:
    """Draws what the cameras ego and allo see of one model. Cheap to make; OpenGL starts at the first picture."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._drawing = model, Drawing(model, lit=False)
        self._cameras: dict[str, mujoco.MjvCamera] = {}

    def start(self) -> None:
        """Starts OpenGL. Raises a `RenderingError` if it does not work here."""
        CANVASES.draw(self._drawing.context)

    def draw(
        self, data: mujoco.MjData, camera: str, size: int, out: Picture | None = None, bare: Picture | None = None
    ) -> Picture:
        """A picture from a camera of the model, as `rendering.renderer.Views.draw`."""

        def paint(canvas: Canvas) -> Picture:
            pixels = self._drawing.draw(canvas, data, self._camera(camera), OVERSAMPLING * size)
            if bare is not None:
                empty = (pixels[::-1, :, 3] == 0).reshape(size, OVERSAMPLING, size, OVERSAMPLING)
                empty.sum(axis=(1, 3), dtype=np.uint8, out=bare)
            return on_white(pixels, out)

        return CANVASES.draw(paint)

    def _camera(self, name: str) -> mujoco.MjvCamera:
        if name not in self._cameras:
            camera = self._cameras[name] = mujoco.MjvCamera()
            camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, self._model.camera(name).id
        return self._cameras[name]


class SolidRenderer:
    """Draws one model in 3-D with lights and shadows, as MuJoCo's viewers show it at first."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._drawing, self._camera = Drawing(model, lit=True), mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(model, self._camera)

    def draw(self, data: mujoco.MjData, size: int, out: Picture | None = None) -> Picture:
        """A picture, as `rendering.renderer.Views.draw`."""

        def paint(canvas: Canvas) -> Picture:
            pixels = self._drawing.draw(canvas, data, self._camera, 4 * size)
            twice = on_white(pixels).reshape(size, 2, size, 2, 3)  # for smooth slanted edges
            picture = np.empty((size, size, 3), np.uint8) if out is None else out
            picture[:] = (twice.sum(axis=(1, 3), dtype=np.uint16) + 2) >> 2
            return picture

        return CANVASES.draw(paint)


def on_white(pixels: Picture, out: Picture | None = None) -> Picture:
    """The finished picture of drawn pixels: averaged 2 x 2, on a white background, top row first.

    The four numbers of a pixel are added as one 64-bit word: each has 16 bits, which the sum of four cannot exceed.

    Args:
        pixels: red, green, blue (all 0 where nothing was drawn) and alpha (0 there, else 255), bottom row first.
            Shape (2 * height, 2 * width, 4).
        out: where to write it, shape (height, width, 3); None: into a fresh array.
    """
    height, width = pixels.shape[0] // OVERSAMPLING, pixels.shape[1] // OVERSAMPLING
    rows = pixels.reshape(height, OVERSAMPLING, -1)[::-1]
    columns = np.add(rows[:, 0], rows[:, 1], dtype=np.uint16).view(np.uint64)
    average = columns[:, ::2] + columns[:, 1::2]
    del columns  # freed together with the rest, it would go back to the system, which slows down large pictures
    average += 2 * _EACH  # to round
    average >>= np.uint64(2)
    average &= 0xFF * _EACH
    paper = average >> np.uint64(48)  # alpha
    paper ^= np.uint64(0xFF)  # 255 - alpha; colour + paper is at most 255
    paper *= _EACH_COLOUR
    average += paper
    levels = average.view(np.uint8).reshape(height, width, -1)
    picture = np.empty((height, width, 3), np.uint8) if out is None else out
    for channel in range(3):  # three strided copies are faster than one of triples
        picture[..., channel] = levels[..., 2 * channel]
    return picture
