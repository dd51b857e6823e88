"""Flat pictures by OpenGL: the geoms and skins of one model that the cameras ego and allo see, in exact colours.

On software OpenGL every drawn pixel costs time. Frames are cheap because of this:

- They are drawn at twice the size and averaged 2 x 2: cheaper than multisampling, and closer to the original.
- Geoms are drawn in the order in which the model lists them, static ones first, so no depth buffer is needed. Their
  heights have the same order, so other MuJoCo viewers, which use a depth buffer, show the same picture.
- The floor, which is white, is not drawn: pixels without a geom (alpha 0) become white afterwards.
"""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np

from magical_mj.rendering.canvas import DRAWN_GROUPS, Canvas, Drawing, Picture, kind_of
from magical_mj.rendering.canvases import CANVASES

OVERSAMPLING: Final = 2
"""Drawn pixels per side of a picture's pixel."""
_STILL, _MOVING = mujoco.mjtCatBit.mjCAT_STATIC.value, mujoco.mjtCatBit.mjCAT_DYNAMIC.value
_WHITE, _DARK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
_EACH: Final = np.uint64(0x0001_0001_0001_0001)
"""One in each quarter of a word: red, green, blue, alpha, lowest first."""
_EACH_COLOUR: Final = np.uint64(0x0000_0001_0001_0001)


class FlatRenderer:
    """Draws the states of one model. Cheap to make; OpenGL starts at the first frame."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self._kind: bytes | None = None
        self._cameras: dict[str, mujoco.MjvCamera] = {}
        self._perturbation = mujoco.MjvPerturb()
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = self._option.skingroup[:] = [group in DRAWN_GROUPS for group in range(6)]
        self._option.sitegroup[:] = self._option.tendongroup[:] = 0

    def start(self) -> None:
        """Starts OpenGL. Raises a `RenderingError` if it does not work here."""
        CANVASES.draw(self._drawing)

    def draw(
        self, data: mujoco.MjData, camera: str, size: int, out: Picture | None = None, bare: Picture | None = None
    ) -> Picture:
        """A picture from a camera of the model, as `rendering.renderer.Views.draw`."""

        def paint(canvas: Canvas) -> Picture:
            pixels = self._paint(canvas, data, camera, OVERSAMPLING * size)
            if bare is not None:
                empty = (pixels[::-1, :, 3] == 0).reshape(size, OVERSAMPLING, size, OVERSAMPLING)
                empty.sum(axis=(1, 3), dtype=np.uint8, out=bare)
            return on_white(pixels, out)

        return CANVASES.draw(paint)

    def _paint(self, canvas: Canvas, data: mujoco.MjData, camera: str, side: int) -> Picture:
        model, drawing = self.model, self._drawing(canvas)
        scene = drawing.scene(model)
        option, perturbation = self._option, self._perturbation
        mujoco.mjv_updateScene(model, data, option, perturbation, self._camera(camera), _STILL, scene)
        mujoco.mjv_addGeoms(model, data, option, perturbation, _MOVING, scene)
        scene.nlight, light = 1, scene.lights[0]
        light.ambient, light.diffuse, light.specular = _WHITE, _DARK, _DARK
        return drawing.draw(side)

    def _drawing(self, canvas: Canvas) -> Drawing:
        self._kind = self._kind or kind_of(self.model, lit=False)
        return canvas.drawing(self.model, self._kind, lit=False)

    def _camera(self, name: str) -> mujoco.MjvCamera:
        if name not in self._cameras:
            camera = mujoco.MjvCamera()
            camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
            camera.fixedcamid = self.model.camera(name).id
            self._cameras[name] = camera
        return self._cameras[name]


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
