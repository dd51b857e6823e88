"""Observations of a batch on the device: state vectors, or stacks of pictures."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from typing import Any, Final

import torch
from gymnasium import spaces
from torch import Tensor

from magical_mj.batched.physics import Physics
from magical_mj.batched.pictures import Painter
from magical_mj.batched.scenes import BatchScenes, EpisodeArrays
from magical_mj.envs.presets import Preset, observation_space
from magical_mj.observations import MAX_BLOCKS, STATE_NAMES

Observation = Tensor | dict[str, Tensor]

_BLOCK: Final = STATE_NAMES.index("block0.present")
_BLOCK_ENTRIES: Final = STATE_NAMES.index("block1.present") - _BLOCK
_REGION: Final = STATE_NAMES.index("region0.present")


class States:
    """The state vectors of `magical_mj.observations.STATE_NAMES`, shape (envs, entries), float32."""

    def __init__(self, preset: Preset, episodes: EpisodeArrays, device: str) -> None:
        self.space: spaces.Space[Any] = observation_space(preset)
        self._fixed = torch.from_numpy(episodes["fixed"]).to(device, copy=True)

    def set_episodes(self, episodes: EpisodeArrays, envs: Tensor) -> None:
        """Starts episodes in these environments, see `tables.constant_states`."""
        self._fixed[envs] = torch.from_numpy(episodes["fixed"]).to(self._fixed)

    def observe(self, physics: Physics, steps: Tensor | None = None) -> Tensor:
        """The current states, in a new tensor. They do not depend on the steps of the episodes."""
        del steps
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


class Frames:
    """Stacks of pictures in a preset's order, uint8: one tensor, or for the layout "dict" one for each view.

    The last pictures of each view are kept in a ring: a new picture replaces the oldest one, and an observation copies
    them in order. For presets with finger angles, the dict also contains these, float32.
    """

    def __init__(self, preset: Preset, size: int, scenes: BatchScenes, episodes: EpisodeArrays, device: str) -> None:
        self._painter = Painter(scenes, episodes, device)
        self._preset, shape = preset, (len(scenes.shapes), size, size, preset.depth)
        self._rings = {
            view: torch.zeros((count, *shape), dtype=torch.uint8, device=device) for view, count in preset.frames
        }
        """View -> its last frames, shape (count, envs, size, size, depth). The newest has index `_drawn` % count."""
        self._drawn = 0
        self.space = observation_space(preset, size)

    def set_episodes(self, episodes: EpisodeArrays, envs: Tensor) -> None:
        """Starts episodes in these environments, see `tables.episode_tables`."""
        self._painter.set_episodes(episodes, envs)

    def observe(self, physics: Physics, steps: Tensor) -> Observation:
        """Adds the current pictures to the stacks. `steps` is each episode's number of steps. Returns new tensors."""
        self._drawn += 1
        self._painter.set_steps(steps)
        poses, fingers = physics.poses, physics.fingers
        for view, ring in self._rings.items():
            self._painter.draw(view, poses, fingers, ring[self._drawn % len(ring)])
        return self._observation(physics)

    def observe_start(self, physics: Physics, envs: Tensor) -> Observation:
        """Fills these environments' stacks with their current pictures. Returns new tensors, of all environments."""
        if len(envs):
            poses, fingers = physics.poses, physics.fingers
            for view, ring in self._rings.items():
                newest = ring[self._drawn % len(ring)]
                self._painter.draw(view, poses, fingers, newest, envs)
                ring[:, envs] = newest[envs]
        return self._observation(physics)

    def get_state(self) -> dict[str, Tensor]:
        """The stacks, in new tensors: "all", or one for each view of the layout "dict"."""
        ordered = {
            view: [ring[(self._drawn + 1 + age) % len(ring)] for age in range(len(ring))]
            for view, ring in self._rings.items()
        }
        if self._preset.layout == "dict":
            return {view: torch.cat(pictures, dim=-1) for view, pictures in ordered.items()}
        return {"all": torch.cat(list(chain(*ordered.values())), dim=-1)}

    def set_state(self, state: Mapping[str, Tensor], physics: Physics) -> Observation:
        """Restores a state, and returns its observation."""
        pictures = chain.from_iterable(stack.split(self._preset.depth, dim=-1) for stack in state.values())
        for ring in self._rings.values():
            for age in range(len(ring)):
                ring[(self._drawn + 1 + age) % len(ring)] = next(pictures).to(ring)
        return self._observation(physics)

    def _observation(self, physics: Physics) -> Observation:
        observation: dict[str, Tensor] = {name: self._shaped(stack) for name, stack in self.get_state().items()}
        if self._preset.fingers:
            observation["fingers"] = physics.fingers
        return observation if self._preset.layout == "dict" else observation["all"]

    def _shaped(self, stack: Tensor) -> Tensor:
        return stack.permute(0, 3, 1, 2) if self._preset.layout == "chw" else stack
