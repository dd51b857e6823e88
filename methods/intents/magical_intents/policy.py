"""Policies that receive a sentence, or demonstrations, at test time, and their file in a training's folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_intents.network import Planner, Skill
from magical_intents.subgoals import DONE, ROBOT
from magical_intents.symmetries import words_of
from magical_mj.actions import NOOP
from magical_mj.learners import checkpoint
from magical_mj.learners.settings import STATE
from magical_mj.observations import FINGERS
from magical_mj.policies.interface import Episode
from magical_mj.policies.models import Model, torch_settings
from magical_mj.utils import files
from magical_mj.utils.errors import TrainingError

POLICY: Final = "conditioned.safetensors"
KINDS: Final = ("skill", "sentence", "demonstrations")
"""The trained networks: the skill, and the two planners."""
SHARPNESS: Final = 2.0
"""Actions are drawn from the skill's probabilities with this exponent."""
EVERY: Final = 3
"""The number of steps between plans."""
STANDING: Final = 0.5
"""The exponent after a step in which the robot rested, so that a robot that is stuck tries other actions."""
MOTION: Final = (0.01, 0.03)
"""A robot rests if it moves less in a step: in units or rad, and a finger in rad."""


class ConditionedPolicy(Model):
    """Plans in every third step, and draws actions from the skill's probabilities with the episode's generator.

    Attributes:
        uses_instruction: whether it receives a sentence.
        uses_demonstrations: whether it receives demonstrations.
        planner: the network that plans.
    """

    def __init__(self, planner: Planner, skill: Skill) -> None:
        super().__init__(self._drawn, remembers=True)
        self.planner, self._skill = planner.eval(), skill.eval()
        self.uses_instruction, self.uses_demonstrations, self.preset = planner.reads, not planner.reads, STATE

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Begins episodes that are played together."""
        super().reset_batch(episodes)
        given = np.stack([self._given(episode) for episode in episodes])
        with torch_settings(1), torch.inference_mode():
            self._context = self.planner.context(torch.from_numpy(given))
        self._rngs = [episode.rng() for episode in episodes]
        self._initial: Tensor | None = None
        self._step = 0

    def _given(self, episode: Episode) -> NDArray[Any]:
        if self.uses_instruction:
            return words_of(episode.instruction)
        return np.stack([np.asarray(demo.observations)[[0, -1]] for demo in episode.demonstrations])

    def _drawn(self, histories: NDArray[Any]) -> NDArray[np.int64]:
        count, states = len(histories), torch.from_numpy(histories)
        now = states[:, -1]
        self._initial = now if self._initial is None else self._initial
        with torch_settings(1), torch.inference_mode():
            if self._step % EVERY == 0:
                context, known = (part[:count] for part in self._context)
                self._plan = self.planner(self._initial[:count], now, (context, known)).best()
            objects, places = (part[:count] for part in self._plan)
            logits = self._skill(now, objects.clamp(max=ROBOT), places)
        self._step += 1
        change = (now - states[:, -2]).abs()
        rests = (change[:, :3] < MOTION[0]).all(1) & (change[:, FINGERS] < MOTION[1]).all(1)
        actions = drawn_actions(logits * torch.where(rests, STANDING, SHARPNESS)[:, None], self._rngs)
        return np.where(objects.numpy() == DONE, NOOP, actions)


def drawn_actions(logits: Tensor, rngs: Sequence[np.random.Generator]) -> NDArray[np.int64]:
    """An action for each row of logits (n, 18), drawn by the first n generators."""
    shares = logits.double().softmax(dim=1).cumsum(dim=1).numpy()
    points = np.array([rng.random() for rng in rngs[: len(shares)]])
    return np.minimum((shares < points[:, None]).sum(axis=1), shares.shape[1] - 1)


@torch_settings()
def load_policy(folder: Path | str) -> ConditionedPolicy:
    """The policy in a training's folder.

    Raises:
        TrainingError: if the file is missing or damaged, or contains only a skill.
    """
    path = files.to_path(folder) / POLICY
    contents = checkpoint.read(path)
    try:
        planner, skill = Planner(reads=contents["training"]["kind"] == "sentence"), Skill()
        planner.load_state_dict(contents["weights"])
        skill.load_state_dict(contents["skill"])
    except Exception as error:
        raise TrainingError(f"{path} does not contain a policy: {error}") from error
    return ConditionedPolicy(planner, skill)
