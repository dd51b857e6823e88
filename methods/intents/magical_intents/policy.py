"""Policies that receive a sentence, or demonstrations, at test time, and their file in a training's folder."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_intents.network import Skill
from magical_intents.scorer import Scorer
from magical_intents.search import searched
from magical_intents.subgoals import ROBOT
from magical_intents.symmetries import words_of
from magical_mj.actions import NOOP
from magical_mj.learners import checkpoint
from magical_mj.learners.networks import blocks_of
from magical_mj.learners.settings import STATE
from magical_mj.observations import FINGERS, MAX_BLOCKS
from magical_mj.policies.interface import Episode
from magical_mj.policies.models import Model, torch_settings
from magical_mj.utils import files
from magical_mj.utils.errors import TrainingError

POLICY: Final = "conditioned.safetensors"
SENTENCE, DEMONSTRATIONS = "sentence", "demonstrations"
"""What policies receive."""
SHARPNESS: Final = 2.0
"""Actions are drawn from the skill's probabilities with this exponent."""
STANDING: Final = 0.5
"""The exponent if the robot rested in the last step, so that a robot that is stuck tries other actions."""
MOTION: Final = (0.01, 0.03)
"""A robot rests if it moves less in a step: in units or rad, and a finger in rad."""
ARRIVED: Final = 0.06
"""An object that is being brought arrives at this distance from its target (units)."""
LEFT: Final = 0.1
"""An object is brought if it is farther from its target (units)."""
NOTHING: Final = -1
"""The chosen object when none is left."""


class ConditionedPolicy(Model):
    """Searches a final scene at the start of an episode, and brings one object after the other to its place there.

    Actions are drawn from the skill's probabilities with the episode's generator.

    Attributes:
        uses_instruction: whether it receives a sentence.
        uses_demonstrations: whether it receives demonstrations.
        scorer: the network that scores final scenes.
    """

    def __init__(self, scorer: Scorer, skill: Skill, given: str) -> None:
        super().__init__(self._drawn, remembers=True)
        self.scorer, self._skill = scorer.eval(), skill.eval()
        self.uses_instruction, self.uses_demonstrations = given == SENTENCE, given == DEMONSTRATIONS
        self.preset = STATE

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Begins episodes that are played together."""
        super().reset_batch(episodes)
        with torch_settings(1), torch.inference_mode():
            self._scales = torch.cat([self._told(episode) for episode in episodes])
        self._rngs = [episode.rng() for episode in episodes]
        self._targets: Tensor | None = None
        self._objects = np.full(len(episodes), NOTHING)

    def _told(self, episode: Episode) -> Tensor:
        if self.uses_instruction:
            return self.scorer.told(torch.from_numpy(words_of(episode.instruction))[None])
        pairs = np.stack([np.asarray(demo.observations)[[0, -1]] for demo in episode.demonstrations])
        starts, ends = torch.from_numpy(pairs)[None].unbind(2)
        return self.scorer.shown(starts, ends)

    def _drawn(self, histories: NDArray[Any]) -> NDArray[np.int64]:
        count, states = len(histories), torch.from_numpy(histories)
        now = states[:, -1]
        with torch_settings(1), torch.inference_mode():
            if self._targets is None:
                self._targets = _targets(now, searched(self.scorer, self._scales, now))
            targets = self._targets[:count]
            self._objects = self._objects[:count]
            self._objects = np.array(list(map(_chosen, self._objects, now, targets)))
            objects = torch.from_numpy(self._objects).clamp(min=0)
            logits = self._skill(now, objects, targets[torch.arange(count), objects])
        change = (now - states[:, -2]).abs()
        rests = (change[:, :3] < MOTION[0]).all(1) & (change[:, FINGERS] < MOTION[1]).all(1)
        actions = drawn_actions(logits * torch.where(rests, STANDING, SHARPNESS)[:, None], self._rngs)
        return np.where(self._objects == NOTHING, NOOP, actions)


def _positions(states: Tensor) -> Tensor:
    """The positions of blocks and, last, the robot in states (n, names), shape (n, ROBOT + 1, 2)."""
    return torch.cat([blocks_of(states)[..., 1:3], states[:, None, :2]], 1)


def _targets(initial: Tensor, final: Tensor) -> Tensor:
    """The positions in final states, shape (n, ROBOT + 1, 2). Robots that stay have none: NaN."""
    targets = _positions(final)
    stays = (targets[:, ROBOT] == _positions(initial)[:, ROBOT]).all(1)
    targets[stays, ROBOT] = math.nan
    return targets


def _chosen(brought: int, state: Tensor, targets: Tensor) -> int:
    """The number of the object to bring now.

    It is the one being brought, until it arrives; then the nearest block that is not at its target; then the robot.
    """
    positions = _positions(state[None])[0]
    gaps = (positions - targets).norm(dim=1)
    if brought != NOTHING and gaps[brought] > ARRIVED:
        return brought
    present = blocks_of(state)[:, 0] > 0
    away = torch.where(present & (gaps[:MAX_BLOCKS] > LEFT), (positions - positions[ROBOT]).norm(dim=1)[:-1], math.inf)
    if away.min() < math.inf:
        return int(away.argmin())
    return ROBOT if gaps[ROBOT] > LEFT else NOTHING


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
        scorer, skill = Scorer(), Skill()
        scorer.load_state_dict(contents["scorer"])
        skill.load_state_dict(contents["skill"])
        given = contents["given"]
    except Exception as error:
        raise TrainingError(f"{path} does not contain a policy: {error}") from error
    return ConditionedPolicy(scorer, skill, given)
