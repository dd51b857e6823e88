"""The bare loop: the steps of an environment with as little Python as possible around MuJoCo and OpenGL."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import nullcontext

import mujoco

from magical_mj.assets.contacts import SUBSTEPS
from magical_mj.assets.robot import control_signal
from magical_mj.assets.world import World
from magical_mj.engine.simulation import Simulation
from magical_mj.envs.presets import Preset
from magical_mj.rendering.canvas import CANVAS
from magical_mj.rendering.renderer import Renderer, on_white
from magical_mj.scene import Scene


class BareLoop:
    """Steps the model of a scene, and draws the views of a preset with the same renderer as the environment.

    There are no resets, hooks, checks, scores, stacked frames or wrappers. The averaging of the pixels is included.
    """

    def __init__(self, scene: Scene, preset: Preset) -> None:
        self.simulation = Simulation.of(World(scene))
        self._views = [view for view, _ in preset.frames]
        self._size = preset.image_size
        self._renderer = Renderer(self.simulation.model.ptr)
        self._canvas = CANVAS if self._views else nullcontext()
        with self._canvas:
            self._draw()  # the first picture includes initialisation

    def run(self, actions: Iterable[int]) -> None:
        """Takes these actions."""
        model, data = self.simulation.model.ptr, self.simulation.data.ptr
        with self._canvas:
            for action in actions:
                data.ctrl[:] = control_signal(action)
                mujoco.mj_step(model, data, SUBSTEPS)
                self._draw()

    def _draw(self) -> None:
        for view in self._views:
            on_white(self._renderer.paint(self.simulation.data.ptr, view, self._size))

    def close(self) -> None:
        """Frees the simulation."""
        self._renderer.close()
        self.simulation.free()
