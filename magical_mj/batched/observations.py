"""What learners see of a batch: stacks of frames, or state vectors, on the device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor

from magical_mj.batched.physics import Physics
from magical_mj.batched.pictures import Painter
from magical_mj.batched.scenes import WorldScenes
from magical_mj.envs.presets import Preset, observation_space, preset_named
from magical_mj.scene.state_vector import MAX_BLOCKS, STATE_NAMES, StateEncoder

Observation = Tensor | dict[str, Tensor]

_BLOCK: Final = STATE_NAMES.index("block0.present")
_BLOCK_ENTRIES: Final = STATE_NAMES.index("block1.present") - _BLOCK
_REGION: Final = STATE_NAMES.index("region0.present")


class States:
    """The state vectors of `magical_mj.scene.state_vector.STATE_NAMES`, shape (worlds, entries), float32."""

    def __init__(self, worlds: int, device: str) -> None:
        self._fixed = torch.zeros((worlds, len(STATE_NAMES)), device=device)
        self.space: spaces.Space[Any] = observation_space(preset_named("State"), {})

    def start(self, scenes: WorldScenes, worlds: Tensor) -> None:
        """Episodes begin in these worlds: writes what stays as it is."""
        fixed = np.stack([StateEncoder(scenes.scene(row)).fixed for row in range(len(worlds))])
        self._fixed[worlds] = torch.from_numpy(fixed).to(self._fixed)

    def look(self, physics: Physics) -> Tensor:
        """The present states, in a fresh tensor."""
        state, poses, speeds = self._fixed.clone(), physics.poses, physics.velocities
        state[:, :8] = torch.cat([poses[:, 0], speeds[:, 0], physics.fingers], dim=-1)
        rows = state[:, _BLOCK:_REGION].view(len(state), MAX_BLOCKS, _BLOCK_ENTRIES)[:, : physics.blocks]
        rows[..., 1:7] = torch.cat([poses[:, 1:], speeds[:, 1:]], dim=-1) * rows[..., :1]
        return state

    def begin(self, physics: Physics, worlds: Tensor) -> Tensor:
        """Observations after resets: the same as any."""
        del worlds
        return self.look(physics)

    def get_state(self) -> dict[str, Tensor]:
        """Nothing: they are the present ones."""
        return {}

    def set_state(self, state: Mapping[str, Tensor], physics: Physics) -> Tensor:
        """Goes back to a state; returns what is seen then."""
        del state
        return self.look(physics)


class Frames:
    """Stacks of pictures as a preset orders them, uint8: one tensor, or for the layout "dict" by view.

    Where the preset says so, the dict also holds the angles of the fingers, float32.
    """

    def __init__(self, preset: Preset, size: int, scenes: WorldScenes, device: str) -> None:
        self._painter = Painter(scenes, device)
        self._preset, worlds = preset, len(scenes.shapes)
        groups = {view: ((view, count),) for view, count in preset.frames}
        self._groups = groups if preset.layout == "dict" else {"all": preset.frames}
        channels = {name: 3 * sum(count for _, count in frames) for name, frames in self._groups.items()}
        self._stacks = {
            name: torch.zeros((worlds, size, size, count), dtype=torch.uint8, device=device)
            for name, count in channels.items()
        }
        shapes = {name: tuple(self._shaped(stack[:1])[0].shape) for name, stack in self._stacks.items()}
        self.space = observation_space(preset, shapes)

    def start(self, scenes: WorldScenes, worlds: Tensor) -> None:
        """Episodes begin in these worlds."""
        self._painter.change(scenes, worlds)

    def look(self, physics: Physics) -> Observation:
        """Adds the present pictures to the stacks; fresh tensors."""
        for name, frames in self._groups.items():
            stack, first = self._stacks[name], 0
            for _, count in frames:
                end = first + 3 * count
                stack[..., first : end - 3] = stack[..., first + 3 : end].clone()
                first = end
        self._draw(physics)
        return self._observation(physics)

    def begin(self, physics: Physics, worlds: Tensor) -> Observation:
        """Fills the stacks of these worlds with their present pictures; fresh tensors, of all worlds."""
        self._draw(physics)
        for name, frames in self._groups.items():
            stack, first = self._stacks[name], 0
            for _, count in frames:
                newest = stack[worlds, :, :, first + 3 * (count - 1) : first + 3 * count]
                stack[worlds, :, :, first : first + 3 * count] = newest.repeat(1, 1, 1, count)
                first += 3 * count
        return self._observation(physics)

    def get_state(self) -> dict[str, Tensor]:
        """The stacks; copies."""
        return {name: stack.clone() for name, stack in self._stacks.items()}

    def set_state(self, state: Mapping[str, Tensor], physics: Physics) -> Observation:
        """Goes back to a state; returns what is seen then."""
        self._stacks = {name: state[name].to(stack, copy=True) for name, stack in self._stacks.items()}
        return self._observation(physics)

    def _draw(self, physics: Physics) -> None:
        """The present pictures, each where the newest of its view belongs."""
        self._painter.place(physics.poses, physics.fingers)
        for name, frames in self._groups.items():
            end = 0
            for view, count in frames:
                end += 3 * count
                self._painter.draw(view, self._stacks[name][..., end - 3 : end])

    def _observation(self, physics: Physics) -> Observation:
        """Copies: whoever changes an observation in place does not change the next ones."""
        observation = {name: self._shaped(stack.clone()) for name, stack in self._stacks.items()}
        if self._preset.fingers:
            observation["fingers"] = physics.fingers
        return observation if self._preset.layout == "dict" else observation["all"]

    def _shaped(self, stack: Tensor) -> Tensor:
        return stack.permute(0, 3, 1, 2) if self._preset.layout == "chw" else stack
