"""The camera: moved, turned and zoomed."""

from __future__ import annotations

import math
from typing import Any

from magical_mj.scene import constants as c
from magical_mj.shifts.shift import Factor, Shift

VIEWS = ("ego", "allo")


class Camera(Shift):
    """Both cameras look from elsewhere: x and y are along the picture's sides, in shares of the view."""

    name = "camera"
    summary = "offset, heading and zoom of both cameras"
    factors = (
        Factor("x", "offset to the right, of the view's side", (0.04, 0.08, 0.16, 0.24, 0.32)),
        Factor("y", "offset upwards, of the view's side", (0.04, 0.08, 0.16, 0.24, 0.32)),
        Factor("angle", "heading, degrees", (3, 6, 12, 20, 30)),
        Factor("zoom", "side of what is seen, relative", (0.03, 0.06, 0.12, 0.2, 0.3)),
    )

    def model(self, model: Any) -> None:
        """Moves the cameras in the frames of their bodies."""
        half = math.radians(self.values["angle"]) / 2
        for camera in range(model.ncam):
            if model.camera(camera).name.removeprefix("robot/") in VIEWS:
                model.cam_pos[camera, :2] += [c.VISIBLE_SIZE * self.values[axis] for axis in ("x", "y")]
                model.cam_quat[camera] = math.cos(half), 0, 0, math.sin(half)
                model.cam_fovy[camera] = c.VISIBLE_SIZE * (1 + self.values["zoom"])
