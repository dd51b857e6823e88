"""Behavioural cloning (section 4.1)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Final

import torch
from torch import Tensor, nn

from magical_mj.learners.augmentation import augmentation
from magical_mj.learners.data import Dataset, Demonstrations
from magical_mj.learners.learner import Learner, seeded, threads_for
from magical_mj.learners.networks import Actor, as_input
from magical_mj.learners.policy import TrainedPolicy
from magical_mj.learners.run_folder import RunFolder
from magical_mj.learners.settings import CloningSettings, TrainingSettings
from magical_mj.policies.models import torch_settings
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError

CALIBRATION: Final = 20
"""The number of batches for batch norm's averages."""


class BehaviouralCloning(Learner):
    """Minimises -E log pi(a | s) over the demonstrations without their no-ops.

    No-ops are dropped because the policy would otherwise get stuck at states where the demonstrator waited (appendix).
    With several tasks, the loss is the mean of the tasks' losses: each batch has equally many samples of each task.
    """

    drop_noop: ClassVar[bool] = True

    def __init__(self, settings: TrainingSettings, demonstrations: Demonstrations | None = None) -> None:
        super().__init__(settings)
        self.updates = settings.bc.batches
        self._data = self.dataset(demonstrations)
        self._draw = torch.Generator().manual_seed(settings.seed)
        self._noise = torch.Generator(self.device).manual_seed(settings.seed)
        self._augment = augmentation(settings)
        with seeded(settings.seed):
            self._actor = Actor(
                settings.network,
                len(settings.tasks),
                states=settings.states,
                batch_norm=True,
                normal=settings.bc.heads == "normal",
            ).to(self.device)
        self._optimizer = _optimizer(settings.bc, self._actor)
        self._rate = torch.optim.lr_scheduler.LinearLR(
            self._optimizer, 1.0, settings.bc.final_learning_rate / settings.bc.learning_rate, self.updates
        )
        self.stateful = {
            "actor": self._actor,
            "optimizer": self._optimizer,
            "rate": self._rate,
            "draw": self._draw,
            "noise": self._noise,
        }

    @property
    def actor(self) -> Actor:
        """The current policy."""
        return self._actor

    def dataset(self, demonstrations: Demonstrations | None) -> Any:
        """The data set. Its method `sample` draws batches."""
        return Dataset(self.settings, drop_noop=self.drop_noop, demonstrations=demonstrations)

    def update(self) -> Mapping[str, float]:
        """Trains on one batch; returns its loss, and the share of samples whose action is the most probable."""
        self._actor.train()
        loss, logits, actions, others = self.loss()
        self._optimizer.zero_grad()
        loss.backward()
        self._optimizer.step()
        self._rate.step()
        return {"loss": loss.item(), "accuracy": (logits.argmax(1) == actions).float().mean().item(), **others}

    def loss(self) -> tuple[Tensor, Tensor, Tensor, Mapping[str, float]]:
        """The loss of a new batch, the logits (n, 18), the demonstrator's actions (n,), and other metrics."""
        observations, actions, tasks = self._data.sample(self.settings.bc.batch_size, self._draw)
        actions, inputs = actions.to(self.device), self._augmented(observations, self._noise)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.settings.precision == "bfloat16"):
            logits = self._actor(inputs, tasks.to(self.device))
        return nn.functional.cross_entropy(logits.float(), actions), logits, actions, {}

    def _augmented(self, observations: Tensor, noise: torch.Generator) -> Tensor:
        return self._augment(as_input(observations, self.device), noise)

    def recalibrate(self) -> None:
        """Recomputes batch norm's averages on new batches: those kept during training lag behind the weights."""
        norms = [layer for layer in self._actor.modules() if isinstance(layer, nn.BatchNorm2d)]
        draw = torch.Generator().manual_seed(self.settings.seed)
        noise = torch.Generator(self.device).manual_seed(self.settings.seed)
        for norm in norms:
            norm.reset_running_stats()
            norm.momentum = None  # an unweighted mean
        self._actor.train()
        for _ in range(CALIBRATION if norms else 0):
            observations, _, tasks = self._data.sample(self.settings.bc.batch_size, draw)
            with torch.no_grad():
                self._actor(self._augmented(observations, noise), tasks.to(self.device))
        for norm in norms:
            norm.momentum = 0.1  # PyTorch's default


def clone(
    settings: TrainingSettings, demonstrations: Demonstrations | None = None, out: Path | str | None = None
) -> TrainedPolicy:
    """Trains a policy by behavioural cloning in memory.

    Args:
        settings: settings of the method "bc". If `settings.demonstrations` is a number, the seed chooses that
            number of demonstrations of each task.
        demonstrations: task -> demonstrations. All are used by default. None: those in the settings.
        out: a new folder for the policy, from where `evaluate` loads it; None: it is not saved. Only `train` saves its
            progress and can be resumed.

    Raises:
        DemonstrationError: if there are too few demonstrations, or one does not fit the settings.
        SettingsError: if the settings are for another method.
        TrainingError: if the folder is not empty.
    """
    if settings.method != "bc":
        raise SettingsError(f"clone does behavioural cloning, but these settings are for {settings.method}: use train")
    folder = None if out is None else RunFolder(files.to_path(out), settings, resume=False)
    with torch_settings(threads_for(settings)):
        learner = BehaviouralCloning(settings, demonstrations)
        for _ in range(learner.updates):
            learner.update()
        learner.recalibrate()
    if folder is not None:
        with folder.locked():
            learner.save_policy(folder.path)
    return learner.policy()


def _optimizer(bc: CloningSettings, actor: Actor) -> torch.optim.Optimizer:
    if bc.optimizer == "sgd":
        return torch.optim.SGD(actor.parameters(), bc.learning_rate, bc.momentum)
    return torch.optim.Adam(actor.parameters(), bc.learning_rate, fused=True)
