"""What the tests of the learners share: trainings that take a second."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from magical_mj.learners import Progress, TrainingSettings, checkpoint, load_settings, train
from magical_mj.learners.policy import POLICY
from magical_mj.learners.run_folder import CHECKPOINT

TINY = {
    "network.first_stride": 4,
    "network.first_channels": 4,
    "network.channels": 4,
    "network.hidden": 8,
    "network.entity": 8,
    "evaluations": 0,
    "checkpoints": 4,
    "demonstrations": 2,
    "device": "cpu",
}


def tiny(method: str = "bc", tasks: str = "MoveToRegion", **changes: Any) -> TrainingSettings:
    """Settings with a network of a few weights."""
    quick = changes.get("preset") != "State"
    return load_settings(method, tasks, quick=quick, **{**TINY, "bc.batches": 12, "bc.batch_size": 4, **changes})


def from_states(**changes: Any) -> TrainingSettings:
    """A tiny training from states."""
    return tiny(preset="State", **changes)


RELATIONAL = {
    "relational.hidden": 8,
    "relational.trial": 1,
    "relational.batch_size": 8,
    "relational.rollouts": 2,
    "relational.ways": 100,
    "relational.plays": 1,
    "relational.grips": 50,
}
PLAYING = {
    "ppo.environments": 4,
    "ppo.steps": 4,
    "ppo.minibatch": 8,
    "ppo.epochs": 2,
    "ppo.total_steps": 64,
    "discriminator.steps": 2,
    "discriminator.batch_size": 8,
    "features.batches": 2,
    "features.batch_size": 4,
    "features.samples": 24,
}


def playing(method: str = "gail", tasks: str = "MoveToRegion", **changes: Any) -> TrainingSettings:
    """Settings of a method that plays: four updates of 4 x 4 steps."""
    return tiny(method, tasks, **{**PLAYING, **changes})


def is_done(folder: Path) -> bool:
    """Whether the training in this folder has come to its end."""
    if not (folder / POLICY).is_file() or not (folder / CHECKPOINT).is_file():
        return False
    kept = checkpoint.read(folder / CHECKPOINT)
    return kept["update"] == kept["updates"]


def stopped(folder: Path, settings: TrainingSettings | None = None) -> None:
    """Leaves a training, tiny unless told otherwise, that was stopped after its third update."""

    def stop(progress: Progress) -> None:
        if progress.update == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(settings or tiny(), folder, watch=stop)
