"""Your own learner: behavioural cloning that cannot simply repeat its last action.

Half of its training observations repeat the present frame, so that they do not show motion. This file trains it for a
few batches and evaluates it. `magical_mj.learners.Learner` explains the interface.

    python examples/own_learner.py
"""

from collections.abc import Mapping
from typing import Any

import torch
from torch import nn

import magical_mj
from magical_mj.learners import Learner, TrainingSettings, load_settings, train
from magical_mj.learners.augmentation import Augmentation
from magical_mj.learners.data import TrainingData
from magical_mj.learners.learner import seeded
from magical_mj.learners.networks import Actor, as_input


class Forgetful(Learner):
    """Behavioural cloning from stacks of frames, half of them without motion."""

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
        self.updates = settings.bc.batches
        self.data = TrainingData(settings, drop_noop=True)
        self.augment = Augmentation(settings.augment)
        self.generator = torch.Generator().manual_seed(settings.seed)
        with seeded(settings.seed):
            self.actor = Actor(settings.network, len(settings.tasks), batch_norm=True).to(self.device)
        self.optimizer = torch.optim.Adam(self.actor.parameters(), 3e-4)

    def update(self) -> Mapping[str, float]:
        """Trains on one batch. Returns the values for metrics.csv."""
        images, actions, tasks = self.data.sample(32, self.generator)
        stacks = self.augment(as_input(images, self.device), self.generator)
        forget = torch.rand(len(stacks), 1, 1, 1, generator=self.generator).to(self.device) < 0.5
        stacks = torch.where(forget, stacks[:, -3:].repeat(1, 4, 1, 1), stacks)
        self.actor.train()
        logits = self.actor(stacks, tasks.to(self.device))
        loss = nn.functional.cross_entropy(logits, actions.to(self.device))
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        return {"loss": loss.item()}

    def get_state(self) -> dict[str, Any]:
        """The content of a checkpoint."""
        weights, optimizer = self.actor.state_dict(), self.optimizer.state_dict()
        return {"weights": weights, "optimizer": optimizer, "generator": self.generator.get_state()}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continues from a checkpoint."""
        self.actor.load_state_dict(state["weights"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.generator.set_state(state["generator"])


few = {"bc.batches": 20, "evaluations": 1, "episodes": 2}  # so that this file runs in seconds
train(load_settings("forgetful", "MoveToRegion", quick=True, **few), "runs/forgetful-0", learner=Forgetful)
scores = magical_mj.evaluate("runs/forgetful-0", tasks="MoveToRegion", variants="Demo,Layout", split="dev", episodes=2)
print(scores.groupby("variant")["score"].mean())
