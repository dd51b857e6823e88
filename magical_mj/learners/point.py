"""Behavioural cloning with a position-invariant regulariser, after POINT (Yin, Gao and Chen, workshop of RSS 2023)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, cast

import torch
from torch import Tensor, nn

from magical_mj.learners.bc import BehaviouralCloning
from magical_mj.learners.networks import Torso
from magical_mj.learners.settings import TrainingSettings
from magical_mj.utils.errors import SettingsError

LEAST: Final = 4
"""The least number of samples for a distance correlation."""


class Point(BehaviouralCloning):
    """Also penalises features that reveal the positions, in the picture, of the objects that the policy attends to.

    "Spatial generalization of visual imitation learning with position-invariant regularization" penalises features
    that contain absolute positions of objects, so that relations between objects remain. We know only its abstract, and
    this form is ours. The position is where Grad-CAM (Selvaraju et al. 2017, arXiv:1610.02391) locates the reason for
    the demonstrator's action. No gradient flows through it. The penalty is the squared distance correlation (Székely
    and Rizzo 2014, arXiv:1310.2926) of features and positions in a batch.
    """

    observes = "pictures"

    @classmethod
    def check_settings(cls, settings: TrainingSettings) -> None:
        """Also checks that batches are large enough."""
        super().check_settings(settings)
        if settings.bc.batch_size < LEAST:
            raise SettingsError(
                f"point compares samples: bc.batch_size={settings.bc.batch_size} must be at least {LEAST}"
            )

    def loss(self) -> tuple[Tensor, Tensor, Tensor, Mapping[str, float]]:
        """Also returns the penalty, without its weight."""
        observations, actions, tasks = self._data.sample(self.settings.bc.batch_size, self._draw)
        inputs, actions, tasks = (
            self._augmented(observations, self._noise),
            actions.to(self.device),
            tasks.to(self.device),
        )
        torso = cast("Torso", self._actor.torso)
        maps = torso.convolutions(inputs[:, -torso.channels :])
        features = torso.linear(maps.flatten(1))
        logits = self._actor.head(features, tasks)
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
        cam = (slopes.mean((2, 3), keepdim=True) * maps).sum(1).relu() + 1e-9  # if all are 0: the middle
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
