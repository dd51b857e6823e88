"""Policies with a scorer, which receive a sentence or demonstrations at test time, and their file in a folder."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from magical_intents.carrier import Carrier
from magical_intents.scenes import ROBOT, positions_of
from magical_intents.scorer import Scorer
from magical_intents.search import searched
from magical_intents.skill import Skill
from magical_intents.symmetries import words_of
from magical_mj.learners import checkpoint
from magical_mj.learners.settings import STATE
from magical_mj.policies.interface import Episode
from magical_mj.policies.models import torch_settings
from magical_mj.utils import files
from magical_mj.utils.errors import TrainingError

POLICY: Final = "conditioned.safetensors"
SENTENCE, DEMONSTRATIONS = "sentence", "demonstrations"
"""What policies receive."""


class ConditionedPolicy:
    """Searches a final scene at the start of an episode, and brings one object after the other to its place there.

    Attributes:
        uses_instruction: whether it receives a sentence.
        uses_demonstrations: whether it receives demonstrations.
        scorer: the network that scores final scenes.
    """

    preset = STATE

    def __init__(self, scorer: Scorer, skill: Skill, given: str) -> None:
        self.scorer, self._skill = scorer.eval(), skill.eval()
        self.uses_instruction, self.uses_demonstrations = given == SENTENCE, given == DEMONSTRATIONS

    def reset(self, episode: Episode) -> None:
        """Begins an episode."""
        with torch_settings(1), torch.inference_mode():
            self._context = self._context_of(episode)
        self._rng, self._carrier = episode.rng(), None

    def _context_of(self, episode: Episode) -> Tensor:
        if self.uses_instruction:
            return self.scorer.read(torch.from_numpy(words_of(episode.instruction))[None])
        pairs = np.stack([np.asarray(demo.observations)[[0, -1]] for demo in episode.demonstrations])
        starts, ends = torch.from_numpy(pairs)[None].unbind(2)
        return self.scorer.shown(starts, ends)

    def __call__(self, observation: Any) -> int:
        """The action for a state."""
        now = torch.from_numpy(observation)
        if self._carrier is None:
            with torch_settings(1):
                (end,) = searched(self.scorer, self._context, now[None])
            places = positions_of(end)
            if torch.equal(end[:2], now[:2]):  # the robot need not return
                places[ROBOT] = math.nan
            self._carrier = Carrier(self._skill, self._rng, places)
        return self._carrier(now)


@torch_settings()
def load_policy(folder: Path | str) -> ConditionedPolicy:
    """The policy in a training's folder.

    Raises:
        TrainingError: if the file is missing or damaged, or contains only a skill.
    """
    path = files.to_path(folder) / POLICY
    contents = checkpoint.read(path)
    try:
        scorer, skill = Scorer(), Skill()
        scorer.load_state_dict(contents["scorer"])
        skill.load_state_dict(contents["skill"])
        given = contents["given"]
    except Exception as error:
        raise TrainingError(f"{path} does not contain a policy: {error}") from error
    return ConditionedPolicy(scorer, skill, given)
