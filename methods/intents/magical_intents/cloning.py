"""Behavioural cloning at test time: a network is trained anew on the demonstrations of each task."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from magical_mj.demos import Transitions
from magical_mj.learners import clone, load_settings
from magical_mj.learners.policy import TrainedPolicy
from magical_mj.learners.settings import STATE
from magical_mj.policies.interface import Episode

HEAD: Final = "MoveToRegion"
"""The task's name in the settings, for the network's only head. The policy does not know the task."""
BATCHES: Final = 1000
"""The number of batches: a sixth of the learner `bc`'s from states, since each task trains a network."""


class Cloned:
    """Clones the given demonstrations, from states. Equal demonstrations are cloned once."""

    uses_demonstrations = True
    preset = STATE

    def __init__(self, batches: int = BATCHES) -> None:
        changes: dict[str, Any] = {"preset": STATE, "device": "cpu", "bc.batches": batches}
        self._settings = load_settings("bc", HEAD, **changes)
        self._trained: dict[str, TrainedPolicy] = {}

    def reset(self, episode: Episode) -> None:
        """Begins an episode, after a training if the demonstrations are new."""
        key = digest(episode.demonstrations)
        if key not in self._trained:
            self._trained[key] = clone(self._settings, {HEAD: list(episode.demonstrations)})
        self._policy = self._trained[key]
        self._policy.reset_batch([replace(episode, task=HEAD)])

    def __call__(self, observation: Any) -> int:
        """The action for a state."""
        return int(self._policy.act_batch(observation[None])[0])


def digest(demonstrations: Sequence[Transitions]) -> str:
    """The SHA-256 digest of states and actions."""
    every = hashlib.sha256()
    for demo in demonstrations:
        for array in (np.asarray(demo.observations), demo.actions):
            every.update(hashlib.sha256(array.tobytes()).digest())
    return every.hexdigest()
