"""Policies that are told what to do by a sentence, or by demonstrations, and their file in a training's folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from magical_intents.network import Conditioned, moments_of, words_of
from magical_mj.learners import checkpoint
from magical_mj.learners.settings import STATE
from magical_mj.policies.interface import Episode
from magical_mj.policies.models import Model, torch_settings
from magical_mj.utils import files
from magical_mj.utils.errors import TrainingError

POLICY: Final = "conditioned.safetensors"


class ConditionedPolicy(Model):
    """Draws actions from the network's probabilities with the episode's generator.

    Attributes:
        uses_instruction: whether sentences say what to do, and
        uses_demonstrations: whether demonstrations do.
    """

    def __init__(self, network: Conditioned, *, reads: bool) -> None:
        super().__init__(self._drawn, remembers=True)
        self._network = network.eval()
        self.uses_instruction, self.uses_demonstrations, self.preset = reads, not reads, STATE

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Begins episodes that are played together."""
        super().reset_batch(episodes)
        given = np.stack([self._given(episode) for episode in episodes])
        with torch_settings(1), torch.inference_mode():
            self._context = self._network.context(torch.from_numpy(given))
        self._rngs = [episode.rng() for episode in episodes]

    def _given(self, episode: Episode) -> NDArray[Any]:
        if self.uses_instruction:
            return words_of(episode.instruction)
        return np.concatenate([moments_of(np.asarray(demo.observations)) for demo in episode.demonstrations])

    def _drawn(self, histories: NDArray[Any]) -> NDArray[np.int64]:
        with torch_settings(1), torch.inference_mode():
            logits = self._network(torch.from_numpy(histories), self._context[: len(histories)])
        shares = logits.double().softmax(dim=1).cumsum(dim=1).numpy()
        points = np.array([rng.random() for rng in self._rngs[: len(histories)]])
        return np.minimum((shares < points[:, None]).sum(axis=1), shares.shape[1] - 1)


@torch_settings()
def load_policy(folder: Path | str) -> ConditionedPolicy:
    """The policy in a training's folder.

    Raises:
        TrainingError: if the file is missing or damaged.
    """
    path = files.to_path(folder) / POLICY
    contents = checkpoint.read(path)
    try:
        network = Conditioned(reads=contents["reads"])
        network.load_state_dict(contents["weights"])
    except Exception as error:
        raise TrainingError(f"{path} does not contain a policy: {error}") from error
    return ConditionedPolicy(network, reads=contents["reads"])
