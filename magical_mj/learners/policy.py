"""Trained policies: what the evaluation plays, and the file they are kept in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from magical_mj.learners import checkpoint
from magical_mj.learners.networks import SHAPE, Actor, as_input
from magical_mj.learners.relational_network import Ensemble
from magical_mj.learners.settings import LEARNABLE, STATE, NetworkSettings, RelationalSettings, TrainingSettings
from magical_mj.policies.history import History
from magical_mj.policies.interface import Episode
from magical_mj.policies.models import torch_settings
from magical_mj.scene.state_vector import STATE_NAMES
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError, TrainingError, check_name, short_repr
from magical_mj.utils.settings import changed

POLICY: Final = "policy.safetensors"
"""In a run's folder."""


class TrainedPolicy:
    """A trained policy: samples actions from the network's probabilities with the episode's generator.

    Args:
        actor: the network.
        tasks: the tasks on which it was trained, in the order of its heads.
        preset: the preset of the observations on which it was trained.

    Attributes:
        actor: the network.
    """

    def __init__(self, actor: Actor | Ensemble, tasks: Sequence[str], preset: str) -> None:
        self.tasks, self.preset = tuple(tasks), preset
        self.actor = actor
        self._device = next(actor.parameters()).device

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Episodes begin, side by side."""
        unknown = sorted({episode.task for episode in episodes} - set(self.tasks))
        if unknown:
            raise SettingsError(f"this policy was trained on {', '.join(self.tasks)}, and cannot act in {unknown[0]}")
        self._heads = torch.tensor([self.tasks.index(episode.task) for episode in episodes], device=self._device)
        self._history: History | None = None
        self._rngs = [episode.rng() for episode in episodes]

    def act_batch(self, observations: NDArray[Any]) -> NDArray[np.int64]:
        """An action for each episode, shape (n,), for stacks of shape (n, 96, 96, 12) or states of shape (n, names)."""
        shape = (len(STATE_NAMES),) if self.preset == STATE else SHAPE
        if observations.shape[1:] != shape:
            raise SettingsError(
                f"this policy looks at arrays of shape {shape} (preset {self.preset}), not {observations.shape[1:]}"
            )
        if self.preset == STATE:
            self._history = self._history or History(observations)
            observations = self._history.add(observations)
        self.actor.eval()
        with torch_settings(1), torch.inference_mode():
            logits = self.actor(as_input(observations, self._device), self._heads[: len(observations)])
        if not logits.isfinite().all():
            raise ValueError("the network's answer is not finite")
        shares = logits.double().softmax(dim=1).cumsum(dim=1).cpu().numpy()
        points = np.array([rng.random() for rng in self._rngs[: len(observations)]])
        return np.minimum((shares < points[:, None]).sum(axis=1), shares.shape[1] - 1)

    def reset(self, episode: Episode) -> None:
        """An episode begins."""
        self.reset_batch([episode])

    def __call__(self, observation: NDArray[Any]) -> int:
        """An action, for a stack of shape (96, 96, 12) or a state of shape (names,)."""
        return int(self.act_batch(observation[None])[0])


def save_policy(folder: Path, actor: Actor | Ensemble, settings: TrainingSettings) -> None:
    """Writes the policy into a run's folder, with everything that is needed to use it.

    Args:
        folder: the run's folder.
        actor: the network.
        settings: the settings of the run.
    """
    if isinstance(actor, Ensemble):
        kind = {"relational": asdict(settings.relational)}
    else:
        kind = {"batch_norm": actor.batch_norm, "network": asdict(settings.network)}
    contents = {
        "weights": actor.state_dict(),
        **kind,
        "tasks": list(settings.tasks),
        "preset": settings.preset,
    }
    checkpoint.write(folder / POLICY, contents)


@torch_settings()
def load_policy(folder: Path | str) -> TrainedPolicy:
    """The policy in a run's folder, on the CPU.

    Raises:
        TrainingError: if there is none, or the file is damaged.
    """
    path = files.to_path(folder) / POLICY
    contents = checkpoint.read(path)
    try:
        tasks, preset = contents["tasks"], contents["preset"]
        if not tasks or not all(isinstance(task, str) for task in tasks):
            raise TypeError(f"tasks are names, not {short_repr(tasks)}")
        check_name("preset", preset, LEARNABLE)
        if "relational" in contents:
            actor = Ensemble(changed(RelationalSettings(), contents["relational"]))
        else:
            network = changed(NetworkSettings(), contents["network"])
            actor = Actor(network, len(tasks), states=preset == STATE, batch_norm=contents["batch_norm"])
        actor.load_state_dict(contents["weights"])
    except Exception as error:
        raise TrainingError(f"{path} holds something else than a policy: {error}") from error
    return TrainedPolicy(actor, tasks, preset)
