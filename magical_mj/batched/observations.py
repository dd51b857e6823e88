"""Observations of a batch on the device: state vectors, or stacks of pictures.

Pictures are drawn from the outlines of the renderer's meshes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import torch
import warp as wp
from gymnasium import spaces
from torch import Tensor

from magical_mj.assets import style
from magical_mj.assets.meshes import loops, meshes
from magical_mj.batched.kernels import MAX_OBJECTS, ROBOT_LAYERS, Objects, Outlines, packed_rgb, paint
from magical_mj.batched.physics import Physics
from magical_mj.batched.scenes import BatchScenes
from magical_mj.envs.presets import Preset, observation_space
from magical_mj.scene import constants as c
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.scene.state_vector import MAX_BLOCKS, STATE_NAMES, StateEncoder
from magical_mj.utils.errors import SettingsError

Observation = Tensor | dict[str, Tensor]

_BLOCK: Final = STATE_NAMES.index("block0.present")
_BLOCK_ENTRIES: Final = STATE_NAMES.index("block1.present") - _BLOCK
_REGION: Final = STATE_NAMES.index("region0.present")


class States:
    """The state vectors of `magical_mj.observations.STATE_NAMES`, shape (envs, entries), float32."""

    def __init__(self, preset: Preset, envs: int, device: str) -> None:
        self.space: spaces.Space[Any] = observation_space(preset, {})
        self._start = preset.start
        self._fixed = torch.zeros((envs, *(self.space.shape or ())), device=device)

    def set_scenes(self, scenes: BatchScenes, envs: Tensor) -> None:
        """Starts episodes in these environments, and stores the constant entries."""
        fixed = np.stack([StateEncoder(scenes.scene(row), start=self._start).fixed for row in range(len(envs))])
        self._fixed[envs] = torch.from_numpy(fixed).to(self._fixed)

    def observe(self, physics: Physics) -> Tensor:
        """The current states, in a new tensor."""
        state, poses, speeds = self._fixed.clone(), physics.poses, physics.velocities
        state[:, :8] = torch.cat([poses[:, 0], speeds[:, 0], physics.fingers], dim=-1)
        rows = state[:, _BLOCK:_REGION].view(len(state), MAX_BLOCKS, _BLOCK_ENTRIES)[:, : physics.blocks]
        rows[..., 1:7] = torch.cat([poses[:, 1:], speeds[:, 1:]], dim=-1) * rows[..., :1]
        return state

    def observe_start(self, physics: Physics, envs: Tensor) -> Tensor:
        """The observations after resets. The state vector does not depend on the past."""
        del envs
        return self.observe(physics)

    def get_state(self) -> dict[str, Tensor]:
        """An empty state: observations depend only on the current physics."""
        return {}

    def set_state(self, state: Mapping[str, Tensor], physics: Physics) -> Tensor:
        """Restores a state, and returns its observation."""
        del state
        return self.observe(physics)


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
    outlines.colours = wp.array([packed_rgb(rgb) for _, _, rgb in ROBOT_LAYERS], dtype=int, device=device)
    table = np.array([[packed_rgb(palette[colour]) for colour in COLOURS] for palette in palettes], np.int32)
    outlines.palette = wp.array(table, dtype=int, device=device)
    return outlines


class Painter:
    """Draws the environments of a batch on one of Warp's devices.

    Raises:
        SettingsError: if the environments have too many blocks and regions.
    """

    def __init__(self, scenes: BatchScenes, device: str = "cpu") -> None:
        envs, blocks = scenes.shapes.shape
        if blocks + scenes.regions.shape[1] > MAX_OBJECTS:
            raise SettingsError(f"batched environments can draw at most {MAX_OBJECTS} blocks and regions: use make_vec")
        self._outlines = _outlines(device)
        self._poses = torch.zeros((envs, 1 + blocks, 4), device=device)
        self._fingers = torch.zeros((envs, 2, 2), device=device)
        self._objects: Any = Objects()
        self._objects.poses = wp.from_torch(self._poses, dtype=wp.vec4)
        self._objects.fingers = wp.from_torch(self._fingers, dtype=wp.vec2)
        self._fixed: dict[str, Tensor] = {}
        for name in ("shapes", "colours", "region_colours", "regions", "dashes"):
            boxes = name in ("regions", "dashes")
            kind, entry = (torch.float32, wp.vec4) if boxes else (torch.int32, wp.int32)
            self._fixed[name] = torch.from_numpy(getattr(scenes, name)).to(device, kind)
            setattr(self._objects, name, wp.from_torch(self._fixed[name], dtype=entry))
        self._device = device
        self.set_poses(torch.from_numpy(scenes.poses), torch.from_numpy(scenes.fingers))

    def set_scenes(self, scenes: BatchScenes, envs: Tensor) -> None:
        """Replaces the scenes of some environments."""
        for name, tensor in self._fixed.items():
            tensor[envs] = torch.from_numpy(getattr(scenes, name)).to(tensor)

    def set_poses(self, poses: Tensor, fingers: Tensor) -> None:
        """Sets poses (envs, 1 + blocks, 3), and angles of the left and right finger (envs, 2)."""
        self._poses[..., :2] = poses[..., :2]
        self._poses[..., 2], self._poses[..., 3] = poses[..., 2].cos(), poses[..., 2].sin()
        self._fingers[..., 0], self._fingers[..., 1] = fingers.cos(), fingers.sin()

    def draw(self, view: str, out: Tensor) -> None:
        """Draws all environments in the view "ego" or "allo" into `out`, shape (envs, size, size, 3), uint8."""
        inputs = [self._objects, self._outlines, int(view == "ego"), c.VISIBLE_SIZE]
        inputs += [c.VISIBLE_SIZE * (0.5 - c.EGO_ANCHOR), wp.from_torch(out, dtype=wp.uint8)]
        wp.launch(paint, dim=out.shape[:3], inputs=inputs, device=self._device)


class Frames:
    """Stacks of pictures in a preset's order, uint8: one tensor, or for the layout "dict" one for each view.

    For presets with finger angles, the dict also contains these, float32.
    """

    def __init__(self, preset: Preset, size: int, scenes: BatchScenes, device: str) -> None:
        self._painter = Painter(scenes, device)
        self._preset, envs = preset, len(scenes.shapes)
        self._channels: list[tuple[str, str, int, int]] = []
        """For each view: the stack, the view, the first of its channels in the stack, and the index after the last."""
        channels: dict[str, int] = {}
        for view, count in preset.frames:
            name = view if preset.layout == "dict" else "all"
            first = channels.get(name, 0)
            channels[name] = first + 3 * count
            self._channels.append((name, view, first, channels[name]))
        self._stacks = {
            name: torch.zeros((envs, size, size, count), dtype=torch.uint8, device=device)
            for name, count in channels.items()
        }
        shapes = {name: tuple(self._shaped(stack[:1])[0].shape) for name, stack in self._stacks.items()}
        self.space = observation_space(preset, shapes)

    def set_scenes(self, scenes: BatchScenes, envs: Tensor) -> None:
        """Starts episodes in these environments."""
        self._painter.set_scenes(scenes, envs)

    def observe(self, physics: Physics) -> Observation:
        """Adds the current pictures to the stacks. Returns new tensors."""
        for name, _, first, end in self._channels:
            stack = self._stacks[name]
            stack[..., first : end - 3] = stack[..., first + 3 : end].clone()
        self._draw(physics)
        return self._observation(physics)

    def observe_start(self, physics: Physics, envs: Tensor) -> Observation:
        """Fills these environments' stacks with their current pictures. Returns new tensors, of all environments."""
        self._draw(physics)
        for name, _, first, end in self._channels:
            stack = self._stacks[name]
            newest = stack[envs, :, :, end - 3 : end]
            stack[envs, :, :, first:end] = newest.repeat(1, 1, 1, (end - first) // 3)
        return self._observation(physics)

    def get_state(self) -> dict[str, Tensor]:
        """Copies of the stacks."""
        return {name: stack.clone() for name, stack in self._stacks.items()}

    def set_state(self, state: Mapping[str, Tensor], physics: Physics) -> Observation:
        """Restores a state, and returns its observation."""
        self._stacks = {name: state[name].to(stack, copy=True) for name, stack in self._stacks.items()}
        return self._observation(physics)

    def _draw(self, physics: Physics) -> None:
        """Draws the current pictures into the channels of each view's newest one."""
        self._painter.set_poses(physics.poses, physics.fingers)
        for name, view, _, end in self._channels:
            self._painter.draw(view, self._stacks[name][..., end - 3 : end])

    def _observation(self, physics: Physics) -> Observation:
        """Copies, so that changing an observation in place does not affect later ones."""
        observation = {name: self._shaped(stack.clone()) for name, stack in self._stacks.items()}
        if self._preset.fingers:
            observation["fingers"] = physics.fingers
        return observation if self._preset.layout == "dict" else observation["all"]

    def _shaped(self, stack: Tensor) -> Tensor:
        return stack.permute(0, 3, 1, 2) if self._preset.layout == "chw" else stack
