"""Behavioural cloning (section 4.1), and two methods that change its loss: inverse soft Q-learning and POINT."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final, cast

import torch
from torch import Tensor, nn

from magical_mj.actions import NOOP
from magical_mj.demos import Demonstration
from magical_mj.learners.augmentation import augmentation
from magical_mj.learners.data import Batch, Demonstrations, TrainingData, shares
from magical_mj.learners.encoder import Frozen, load_encoder
from magical_mj.learners.learner import Learner, seeded, threads_for
from magical_mj.learners.networks import Actor, Torso, as_input
from magical_mj.learners.policy import TrainedPolicy
from magical_mj.learners.run_folder import RunFolder
from magical_mj.learners.settings import InverseSettings, TrainingSettings
from magical_mj.policies.facts import Learnt
from magical_mj.policies.models import torch_settings
from magical_mj.tasks.registry import EVERY_VARIANT
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError

CALIBRATION: Final = 20
"""The number of batches for batch norm's averages."""

LEAST_SAMPLES: Final = 4
"""The least number of samples for a distance correlation."""


class BehaviouralCloning(Learner):
    """Minimises -E log pi(a | s) over the demonstrations without their no-ops.

    No-ops are dropped because the policy would otherwise get stuck at states where the demonstrator waited (appendix).
    With several tasks, the loss is the mean of the tasks' losses: each batch has equally many samples of each task.

    Attributes:
        data: the training data; its method `sample` draws batches.
        rng: draws batches.
        noise_rng: draws augmentations, on the learner's device.
        optimizer: the optimizer of the actor.
    """

    parts: ClassVar[tuple[str, ...]] = ("network", "bc")
    drop_noop: ClassVar[bool] = True

    def __init__(self, settings: TrainingSettings, demonstrations: Demonstrations | None = None) -> None:
        super().__init__(settings)
        self.updates = settings.bc.batches
        self.data = self.dataset(demonstrations)
        given = [] if demonstrations is None else [demo for task in settings.tasks for demo in demonstrations[task]]
        self._variants = {demo.variant for demo in given if isinstance(demo, Demonstration)} or {"Demo"}
        self.rng = torch.Generator().manual_seed(settings.seed)
        self.noise_rng = torch.Generator(self.device).manual_seed(settings.seed)
        self._augment = augmentation(settings)
        with seeded(settings.seed):
            self.actor = Actor(
                settings.network,
                len(settings.tasks),
                states=settings.states,
                batch_norm=True,
                normal=settings.bc.heads == "normal",
            )
        self._encoder = load_encoder(settings)
        if self._encoder is not None:
            torso = cast("Torso", self.actor.torso)
            torso.convolutions.load_state_dict(self._encoder.weights)
            torso.convolutions = Frozen(torso.convolutions)
        self.actor.to(self.device)
        self.optimizer: torch.optim.Optimizer
        if settings.bc.optimizer == "sgd":
            self.optimizer = torch.optim.SGD(self.actor.parameters(), settings.bc.learning_rate, settings.bc.momentum)
        else:
            self.optimizer = torch.optim.Adam(self.actor.parameters(), settings.bc.learning_rate, fused=True)
        self._rate = torch.optim.lr_scheduler.LinearLR(
            self.optimizer, 1.0, settings.bc.final_learning_rate / settings.bc.learning_rate, self.updates
        )
        self.stateful = {
            "actor": self.actor,
            "optimizer": self.optimizer,
            "rate": self._rate,
            "draw": self.rng,
            "noise": self.noise_rng,
        }

    @classmethod
    def check_settings(cls, settings: TrainingSettings) -> None:
        """Also checks the encoder."""
        super().check_settings(settings)
        load_encoder(settings)

    @property
    def learnt(self) -> Learnt:
        """With the variants of the given demonstrations, as far as they are known, and the encoder's training."""
        variants, others = set(self._variants), list[str]()
        if self._encoder is not None:
            variants |= set(self._encoder.played_in.split(","))
            others = [task for task in self._encoder.tasks if task not in self.settings.tasks]
        return Learnt(self.settings.demos.set, ",".join(filter(variants.__contains__, EVERY_VARIANT)), others)

    def dataset(self, demonstrations: Demonstrations | None) -> Any:
        """New training data, for `data`."""
        return TrainingData(self.settings, drop_noop=self.drop_noop, demonstrations=demonstrations)

    def update(self) -> Mapping[str, float]:
        """Trains on one batch; returns its loss, and the share of samples whose action is the most probable."""
        self.actor.train()
        loss, logits, actions, others = self.loss()
        self.optimizer.zero_grad()
        loss.backward()
        self.optimizer.step()
        self._rate.step()
        return {"loss": loss.item(), "accuracy": (logits.argmax(1) == actions).float().mean().item(), **others}

    def loss(self) -> tuple[Tensor, Tensor, Tensor, Mapping[str, float]]:
        """The loss of a new batch, the logits (n, 18), the demonstrator's actions (n,), and other metrics."""
        observations, actions, tasks = self.data.sample(self.settings.bc.batch_size, self.rng)
        inputs = self.augmented(observations, self.noise_rng)
        actions = actions.to(self.device)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.settings.precision == "bfloat16"):
            logits = self.actor(inputs, tasks.to(self.device))
        return nn.functional.cross_entropy(logits.float(), actions), logits, actions, {}

    def augmented(self, observations: Tensor, noise: torch.Generator) -> Tensor:
        """Augmented observations of a batch as inputs of the network."""
        return self._augment(as_input(observations, self.device), noise)

    def recalibrate(self) -> None:
        """Recomputes batch norm's averages on new batches: those kept during training lag behind the weights."""
        self.actor.train()
        norms = [layer for layer in self.actor.modules() if isinstance(layer, nn.BatchNorm2d) and layer.training]
        draw = torch.Generator().manual_seed(self.settings.seed)
        noise = torch.Generator(self.device).manual_seed(self.settings.seed)
        for norm in norms:
            norm.reset_running_stats()
            norm.momentum = None  # an unweighted mean
        for _ in range(CALIBRATION if norms else 0):
            observations, _, tasks = self.data.sample(self.settings.bc.batch_size, draw)
            with torch.no_grad():
                self.actor(self.augmented(observations, noise), tasks.to(self.device))
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
        with folder.locked(learner):
            learner.save_policy(folder.path)
    return learner.policy()


class IQLearn(BehaviouralCloning):
    """Inverse soft Q-learning (Garg et al. 2021, arXiv:2106.12142) in its offline form: cloning with another loss.

    One network represents a soft Q function. It determines a policy, pi(a | s) = exp((Q(s, a) - V(s)) / temperature),
    where V is the temperature times the log of the sum of exp(Q / temperature) over actions. It also determines a
    reward, r(s, a) = Q(s, a) - discount V(s'). With its regulariser chi^2, the paper maximises over the demonstrations

        E[r - r^2 / (4 alpha)] - E[V(s) - discount V(s')].

    Without the square this is behavioural cloning. The square keeps the rewards that explain the demonstrator small, so
    that the values of successive states have to agree. No episodes are played. The actor's logits are Q / temperature,
    so that it draws actions from pi.

    As in behavioural cloning, steps with the no-op are left out, but they may be successors. The last step of each
    demonstration is also left out, since it has no successor.
    """

    parts = ("network", "bc", "iq")
    unused = ("precision", "bc.encoder")
    observes = "states"
    drop_noop = False
    learns_reward = True

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
        self._usable = [usable(self.data, task) for task in range(len(settings.tasks))]

    def loss(self) -> tuple[Tensor, Tensor, Tensor, Mapping[str, float]]:
        """The loss of `iq_loss`, the logits, the actions, and the mean reward in the batch."""
        batch, following = successive(self.data, self._usable, self.settings.bc.batch_size, self.rng)
        actions, tasks = batch.actions.to(self.device), batch.tasks.to(self.device)
        logits = self.actor(self.augmented(batch.observations, self.noise_rng), tasks)
        next_logits = self.actor(self.augmented(following, self.noise_rng), tasks)
        loss, rewards = iq_loss(logits, next_logits, actions, self.settings.iq)
        return loss, logits, actions, {"reward": rewards.mean().item()}

    @torch.no_grad()
    def learnt_reward(self, observations: Tensor, following: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """Q(s, a) - discount V(s'), shape (n,)."""
        self.actor.eval()
        logits, next_logits = self.actor(observations, tasks), self.actor(following, tasks)
        return soft_rewards(logits, next_logits, actions, self.settings.iq)


def soft_rewards(logits: Tensor, next_logits: Tensor, actions: Tensor, settings: InverseSettings) -> Tensor:
    """The rewards Q(s, a) - discount V(s'), shape (n,). Arguments: see `iq_loss`."""
    chosen = logits.gather(1, actions[:, None])[:, 0]
    return settings.temperature * (chosen - settings.discount * next_logits.logsumexp(1))


def usable(data: TrainingData, task: int) -> Tensor:
    """The indices of a task's rows that have a successor, and whose action is not the no-op."""
    return (~data.last[task] & (data.actions[task] != NOOP)).nonzero()[:, 0]


def successive(
    data: TrainingData, indices: Sequence[Tensor], size: int, generator: torch.Generator
) -> tuple[Batch, Tensor]:
    """Draws a batch from the rows with these indices, given for each task. Also returns the following observations."""
    counts = shares(size, len(indices), generator)
    rows = [
        usable_rows[torch.randint(len(usable_rows), (count,), generator=generator)]
        for usable_rows, count in zip(indices, counts, strict=True)
    ]
    return data.rows(rows), data.rows([drawn + 1 for drawn in rows]).observations


def iq_loss(logits: Tensor, next_logits: Tensor, actions: Tensor, settings: InverseSettings) -> tuple[Tensor, Tensor]:
    """The loss divided by the temperature, comparable with behavioural cloning's, and the rewards (n,).

    Args:
        logits: Q / temperature, shape (n, 18).
        next_logits: Q / temperature of the successors, shape (n, 18).
        actions: the demonstrator's, shape (n,).
        settings: the method's settings.
    """
    rewards = soft_rewards(logits, next_logits, actions, settings)
    # E[r] - E[V(s) - discount V(s')] = E[Q(s, a) - V(s)] = temperature E[log pi(a | s)]
    cloning = nn.functional.cross_entropy(logits, actions)
    return cloning + rewards.square().mean() / (4 * settings.alpha * settings.temperature), rewards.detach()


class Point(BehaviouralCloning):
    """POINT: also penalises features that contain the picture positions of the objects that the policy attends to.

    "Spatial generalization of visual imitation learning with position-invariant regularization" (Yin, Gao and Chen,
    workshop of RSS 2023) penalises features that contain absolute positions of objects, so that relations between
    objects remain. We know only its abstract, and this form is ours. The position is the centre of the Grad-CAM map
    (Selvaraju et al. 2017, arXiv:1610.02391) of the demonstrator's action. No gradient flows through it. The penalty is
    the squared distance correlation (Székely and Rizzo 2014, arXiv:1310.2926) of features and positions in a batch.
    """

    parts = ("network", "bc", "point")
    unused = ("precision", "bc.encoder")
    observes = "pictures"

    @classmethod
    def check_settings(cls, settings: TrainingSettings) -> None:
        """Also checks that batches are large enough, and convolutions are trained."""
        if settings.bc.encoder:
            raise SettingsError("point trains its own convolutions: leave out bc.encoder, or use the method bc")
        super().check_settings(settings)
        if settings.bc.batch_size < LEAST_SAMPLES:
            raise SettingsError(
                f"point compares samples: bc.batch_size={settings.bc.batch_size} must be at least {LEAST_SAMPLES}"
            )

    def loss(self) -> tuple[Tensor, Tensor, Tensor, Mapping[str, float]]:
        """The loss with the penalty, the logits, the actions, and the penalty without its weight."""
        observations, actions, tasks = self.data.sample(self.settings.bc.batch_size, self.rng)
        inputs = self.augmented(observations, self.noise_rng)
        actions, tasks = actions.to(self.device), tasks.to(self.device)
        torso = cast("Torso", self.actor.torso)
        maps = torso.convolutions(inputs[:, -torso.channels :])
        features = torso.linear(maps.flatten(1))
        logits = self.actor.head(features, tasks)
        penalty = distance_correlation(features, looked_at(maps, logits.gather(1, actions[:, None]).sum()))
        loss = nn.functional.cross_entropy(logits, actions) + self.settings.point.weight * penalty
        return loss, logits, actions, {"penalty": penalty.item()}


def looked_at(maps: Tensor, chosen: Tensor) -> Tensor:
    """The centres of Grad-CAM's maps, (n, 2), from -1 to 1 to the right and down.

    Args:
        maps: the last convolution's output, shape (n, channels, height, width).
        chosen: the explained value, summed over the samples, as a function of the maps.
    """
    (slopes,) = torch.autograd.grad(chosen, maps, retain_graph=True)
    with torch.no_grad():
        cam = (slopes.mean((2, 3), keepdim=True) * maps).sum(1).relu() + 1e-9  # a map of zeros has its centre at (0, 0)
        cam = cam / cam.sum((1, 2), keepdim=True)
        down, right = (torch.linspace(-1, 1, size, device=maps.device) for size in cam.shape[1:])
        return torch.stack([(cam.sum(1) * right).sum(1), (cam.sum(2) * down).sum(1)], 1)


def distance_correlation(first: Tensor, second: Tensor) -> Tensor:
    """The bias-corrected squared distance correlation of samples (n, size): about 0 if independent, at most 1."""
    one, other = centred_distances(first), centred_distances(second)
    return (one * other).sum() / (one.square().sum() * other.square().sum()).clamp(min=1e-12).sqrt()


def centred_distances(samples: Tensor) -> Tensor:
    """U-centred distances (n, n) of samples (n, size): the sum of each row is 0, and so is the diagonal."""
    count = len(samples)
    apart = torch.eye(count, device=samples.device) == 0
    # Not torch.cdist, whose gradient is not a number where two samples are equal.
    squares = (samples[:, None] - samples[None]).square().sum(2)
    distances = squares.clamp(min=1e-12).sqrt() * apart
    rows, total = distances.sum(1) / (count - 2), distances.sum() / ((count - 1) * (count - 2))
    return (distances - rows[:, None] - rows[None] + total) * apart
