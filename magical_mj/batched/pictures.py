"""Draws the environments of a batch on its device: accelerators with `batched.accelerator`, processors here."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_mj.batched.frames import FIRST_BLOCK, VISIBLE, write_frames
from magical_mj.batched.scenes import BatchScenes, EpisodeArrays
from magical_mj.batched.tables import Faults, Tables, all_tables, most_corners
from magical_mj.observations import SEGMENTATIONS, VIEWS
from magical_mj.rendering.picture import Picture
from magical_mj.rendering.scanlines import count_uncovered, draw_posed, segment_posed
from magical_mj.rendering.software import scratch
from magical_mj.shifts.drawn import spoil
from magical_mj.shifts.kernels import put_on_ground, relight
from magical_mj.shifts.shift import GROUND_CELLS, GROUND_REACH
from magical_mj.utils.extras import check_module

Poses = tuple[NDArray[np.float64], NDArray[np.float64]]
"""The poses and the angles of the fingers of one environment, see `Painter.draw`."""


def check_accelerator(device: str) -> None:
    """Raises a `MissingExtraError` if the device is an accelerator and numba-cuda is not installed."""
    if torch.device(device).type != "cpu":
        check_module("pictures on an accelerator", "numba_cuda", "gpu")


class Painter:
    """Draws the environments of a batch on its device.

    Args:
        scenes: scenes with as many slots for blocks and regions as those that are drawn.
        episodes: the first episodes' tables, see `tables.episode_tables`.
        device: the device of all tensors.
    """

    def __init__(self, scenes: BatchScenes, episodes: EpisodeArrays, device: str = "cpu") -> None:
        arrays = all_tables(scenes, episodes)
        self._named = {name: torch.tensor(table, device=device) for name, table in arrays.items()}
        self._all = torch.arange(len(scenes.shapes), device=device)
        self._steps = torch.zeros_like(self._all)
        self._tables = Tables(*(self._named[name] for name in Tables._fields))
        self._faults = Faults(*(self._named[name] for name in Faults._fields)) if "noises" in episodes else None
        self._launcher: Any = None
        if self._all.is_cuda:
            from magical_mj.batched.accelerator import Launcher  # numba-cuda is needed for accelerators only

            self._launcher = Launcher(self._tables, self._faults, most_corners(scenes))

    def set_episodes(self, episodes: EpisodeArrays, envs: Tensor) -> None:
        """Starts these episodes in some environments."""
        self._steps[envs] = 0
        for name in (self._named.keys() & episodes.keys()) - {"noises"}:
            table = self._named[name]
            table[envs] = torch.from_numpy(episodes[name]).to(table).reshape(len(envs), *table.shape[1:])
        for env, noise in zip(envs.tolist(), episodes.get("noises", ()), strict=False):
            if noise is not None:
                self._named["noises"][env] = torch.from_numpy(noise).to(self._all.device)

    def set_steps(self, steps: Tensor) -> None:
        """Sets the number of steps of each environment's episode."""
        self._steps[:] = steps

    def draw(self, view: str, poses: Tensor, fingers: Tensor, out: Tensor, envs: Tensor | None = None) -> None:
        """Draws environments into their pictures in `out`, shape (all envs, size, size, 3), uint8.

        Args:
            view: one of `VIEWS`; or one of `SEGMENTATIONS`, whose pictures have the shape (size, size, 1).
            poses: x, y, angle of the robot and of each block in all environments. Shape (all envs, 1 + blocks, 3).
            fingers: angles of the left and the right finger. Shape (all envs, 2).
            out: the pictures.
            envs: the numbers of the environments to draw, int64; None: all.
        """
        envs = self._all if envs is None else envs
        if self._launcher is not None:
            self._launcher.draw((poses, fingers, self._steps), view, envs, out)
            return
        exact_poses, exact_fingers, pictures = poses.double().numpy(), fingers.double().numpy(), out.numpy()
        tables = Tables(*(tensor.numpy() for tensor in self._tables))
        for env in envs.tolist():
            self._draw_here(tables, view, env, (exact_poses[env], exact_fingers[env]), pictures[env])

    def _draw_here(self, tables: Tables, view: str, env: int, posed: Poses, picture: Picture) -> None:
        """Draws an environment on the processor."""
        size, number = len(picture), VIEWS.index(view.partition("-")[0])
        camera, frames = tables.cameras[env, number], np.empty((FIRST_BLOCK + len(posed[0]), 4))
        write_frames(number, camera, *posed, frames)
        scene, visible = (tables.polygons[env], tables.corners, tables.quads[env]), float(camera[VISIBLE])
        if view in SEGMENTATIONS:
            segment_posed(scene, frames, visible, scratch(size), tables.segments, picture[..., 0])
            return
        samples, colours = scratch(2 * size), np.empty(len(scene[0]), np.uint32)
        pairs = samples[0].view(np.uint64)
        draw_posed(scene, frames, visible, samples, tables.palettes[env], colours, pairs, picture)
        x, y, cosine, sine = frames[-1].tolist()
        shown = x, y, math.atan2(sine, cosine), visible
        if len(tables.grounds):
            uncovered = np.empty((size, size), np.uint8)
            count_uncovered(samples[0], uncovered)
            ground = tables.grounds[env].reshape(GROUND_CELLS, GROUND_CELLS, 3)
            put_on_ground(picture, uncovered, ground, GROUND_REACH, shown)
        if len(tables.tones):
            relight(picture, tables.tones[env], tables.slopes[env], tables.bars[env], shown)
        if self._faults is not None:
            sensors, noises, chances = (tensor[env].numpy() for tensor in self._faults)
            spoil(picture, sensors, noises, chances[number, int(self._steps[env])])
