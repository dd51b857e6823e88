"""The view "scene": one model in 3-D with lights and shadows, as MuJoCo's viewers show it at first."""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np

from magical_mj.rendering.canvas import Canvas, Picture, kind_of
from magical_mj.rendering.canvases import CANVASES
from magical_mj.rendering.flat import on_white

_ALL: Final = mujoco.mjtCatBit.mjCAT_ALL.value


class SolidRenderer:
    """Draws the states of one model from its initial free camera. Cheap to make; OpenGL starts at the first frame."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self._kind: bytes | None = None
        self._option, self._perturbation = mujoco.MjvOption(), mujoco.MjvPerturb()
        self._camera = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(model, self._camera)

    def draw(self, data: mujoco.MjData, size: int, out: Picture | None = None) -> Picture:
        """A picture, as `rendering.renderer.Views.draw`."""
        model = self.model
        self._kind = kind = self._kind or kind_of(model, lit=True)

        def paint(canvas: Canvas) -> Picture:
            drawing = canvas.drawing(model, kind, lit=True)
            scene = drawing.scene(model)
            mujoco.mjv_updateScene(model, data, self._option, self._perturbation, self._camera, _ALL, scene)
            twice = on_white(drawing.draw(4 * size)).reshape(size, 2, size, 2, 3)  # for smooth slanted edges
            picture = np.empty((size, size, 3), np.uint8) if out is None else out
            picture[:] = (twice.sum(axis=(1, 3), dtype=np.uint16) + 2) >> 2
            return picture

        return CANVASES.draw(paint)
