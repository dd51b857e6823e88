"""Pictures of whole batches, painted on the device from the outlines of the renderer's meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import warp as wp
from torch import Tensor

from magical_mj.assets import style
from magical_mj.assets.meshes import loops, meshes
from magical_mj.batched.kernels import ROBOT_LAYERS, Outlines, Worlds, packed, paint
from magical_mj.batched.scenes import WorldScenes
from magical_mj.scene import constants as c
from magical_mj.scene.constants import COLOURS, SHAPES


def _outlines(device: str) -> Any:
    library = meshes()
    names = [name for name, _, _ in ROBOT_LAYERS]
    names += [f"{shape}_{what}" for shape in SHAPES for what in ("outline", "fill")]
    points, ends, parts, reach = [], [], [], []
    for name in names:
        first = len(ends)
        vertices, faces = library[name]
        for loop in (vertices[loop, :2] for loop in loops(faces)):
            begin = sum(map(len, points))
            points.append(loop)
            ends.append((begin, begin + len(loop)))
        parts.append((first, len(ends)))
        reach.append(max(float((loop**2).sum(axis=1).max()) for loop in points[first:]) + 1e-6)
    palettes = (style.BLOCK_OUTLINE, style.BLOCK_FILL, style.REGION_FILL, style.REGION_BORDER)
    outlines: Any = Outlines()
    outlines.points = wp.array(np.concatenate(points).astype(np.float32), dtype=wp.vec2, device=device)
    outlines.loops = wp.array(np.array(ends, np.int32), dtype=wp.vec2i, device=device)
    outlines.parts = wp.array(np.array(parts, np.int32), dtype=wp.vec2i, device=device)
    outlines.reach = wp.array(np.array(reach, np.float32), dtype=float, device=device)
    outlines.frames = wp.array([frame for _, frame, _ in ROBOT_LAYERS], dtype=int, device=device)
    outlines.colours = wp.array([packed(rgb) for _, _, rgb in ROBOT_LAYERS], dtype=int, device=device)
    table = np.array([[packed(palette[colour]) for colour in COLOURS] for palette in palettes], np.int32)
    outlines.palette = wp.array(table, dtype=int, device=device)
    return outlines


class Painter:
    """Draws the worlds of a batch.

    Args:
        scenes: what is in each world.
        device: Warp's name of the device, such as "cpu" or "cuda:0".
    """

    def __init__(self, scenes: WorldScenes, device: str = "cpu") -> None:
        self._outlines = _outlines(device)
        self._fixed = {
            name: torch.from_numpy(getattr(scenes, name)).to(device).to(kind)
            for name, kind in (
                ("shapes", torch.int32),
                ("colours", torch.int32),
                ("regions", torch.float32),
                ("region_colours", torch.int32),
                ("dashes", torch.float32),
            )
        }
        worlds, blocks = scenes.shapes.shape
        self._places = torch.zeros((worlds, 1 + blocks, 4), device=device)
        self._fingers = torch.zeros((worlds, 2, 2), device=device)
        self._worlds: Any = Worlds()
        for name, tensor in (*self._fixed.items(), ("places", self._places), ("fingers", self._fingers)):
            kind = {"regions": wp.vec4, "dashes": wp.vec4, "places": wp.vec4, "fingers": wp.vec2}.get(name, wp.int32)
            setattr(self._worlds, name, wp.from_torch(tensor, dtype=kind))
        self._device = device
        self.place(torch.from_numpy(scenes.poses), torch.from_numpy(scenes.fingers))

    def change(self, scenes: WorldScenes, worlds: Tensor) -> None:
        """Other scenes in some of the worlds."""
        for name, tensor in self._fixed.items():
            tensor[worlds] = torch.from_numpy(getattr(scenes, name)).to(tensor)

    def place(self, poses: Tensor, fingers: Tensor) -> None:
        """Where everything is now.

        Args:
            poses: x, y, angle of the robot and each block. Shape (worlds, 1 + blocks, 3).
            fingers: angles of the left and the right finger. Shape (worlds, 2).
        """
        self._places[..., :2] = poses[..., :2]
        self._places[..., 2], self._places[..., 3] = poses[..., 2].cos(), poses[..., 2].sin()
        self._fingers[..., 0], self._fingers[..., 1] = fingers.cos(), fingers.sin()

    def draw(self, view: str, out: Tensor) -> None:
        """Paints all worlds.

        Args:
            view: "ego" or "allo".
            out: where to; any strides. Shape (worlds, size, size, 3), uint8.
        """
        inputs = [self._worlds, self._outlines, int(view == "ego"), c.VISIBLE_SIZE]
        inputs += [c.VISIBLE_SIZE * (0.5 - c.EGO_ANCHOR), wp.from_torch(out, dtype=wp.uint8)]
        wp.launch(paint, dim=out.shape[:3], inputs=inputs, device=self._device)
