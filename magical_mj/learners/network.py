"""The paper's network (appendix, "Network architecture"): convolutions, two linear layers, and a head for each task."""

from __future__ import annotations

import math
from typing import Any, Final

import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical_mj.learners.settings import Network
from magical_mj.learners.states import StateTorso
from magical_mj.scene.actions import ACTIONS

SHAPE: Final = (96, 96, 12)
"""Of what networks look at: four RGB frames, stacked along the channels."""
ONE_HOT: Final = len(ACTIONS)


def as_input(observations: NDArray[Any] | Tensor, device: torch.device) -> Tensor:
    """Converts observations of environments to the inputs of networks.

    Args:
        observations: stacks of frames, shape (n, side, side, 3k), 0 to 255; or histories, shape (n, HISTORY, names).
        device: the device of the networks.

    Returns:
        Stacks of shape (n, 3k, side, side) with values in [0, 1], in memory format channels-last, which is faster.
        Histories unchanged.
    """
    values = torch.as_tensor(observations).to(device).float()
    return scaled(values).permute(0, 3, 1, 2) if values.dim() == 4 else values


def scaled(pixels: Tensor) -> Tensor:
    """Scales values from 0..255 to [0, 1] in place, and returns the tensor; allocating a new one would be slower."""
    return pixels.div_(255)


def convolutions(network: Network) -> list[tuple[int, int, int]]:
    """Channels, kernel and stride of each convolution, from the pictures inwards."""
    return [(network.first_channels, network.first_kernel, network.first_stride)] + 4 * [(network.channels, 3, 2)]


class Torso(nn.Module):
    """The layers that all tasks share: from stacks of frames to features.

    Args:
        network: the layers' sizes.
        batch_norm: after each convolution; BC's policy, the discriminator and AL's encoder have it.
        actions: join one-hot actions to the convolutions' output; the discriminator and AL's encoder do.
        features: units of the last layer, instead of `network.hidden`.
    """

    def __init__(
        self,
        network: Network,
        *,
        batch_norm: bool = False,
        actions: bool = False,
        features: int | None = None,
    ) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        side, _, channels = SHAPE
        for outputs, kernel, stride in convolutions(network):
            layers.append(nn.Conv2d(channels, outputs, kernel, stride, padding=kernel // 2, bias=not batch_norm))
            layers += [nn.BatchNorm2d(outputs)] if batch_norm else []
            layers.append(nn.ReLU())
            channels, side = outputs, math.ceil(side / stride)
        self.convolutions = nn.Sequential(*layers).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self.flat = channels * side * side
        self.features = features or network.hidden
        inputs = self.flat + (ONE_HOT if actions else 0)
        self.linear = nn.Sequential(
            nn.Linear(inputs, network.hidden), nn.ReLU(), nn.Linear(network.hidden, self.features), nn.ReLU()
        )

    def forward(self, stacks: Tensor, actions: Tensor | None = None) -> Tensor:
        """Features, shape (n, features), of stacks (n, 3k, 96, 96) in [0, 1] and actions (n,), if it has any."""
        flat = self.convolutions(stacks).flatten(1)
        if actions is not None:
            flat = torch.cat([flat, nn.functional.one_hot(actions, ONE_HOT).to(flat.dtype)], dim=1)
        return self.linear(flat)


class Heads(nn.Module):
    """The last layer: a linear map of its own for each task.

    Args:
        tasks: the number of tasks.
        inputs: the number of inputs of each map.
        outputs: the number of outputs of each map.
        normal: initialise the weights from N(0, 1), as the original's released learners do; the paper's SGD hardly
            learns without this. Otherwise nn.Linear's default is used.
    """

    def __init__(self, tasks: int, inputs: int, outputs: int, *, normal: bool = False) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(tasks, outputs, inputs))
        self.bias = nn.Parameter(torch.empty(tasks, outputs))
        bound = 1 / math.sqrt(inputs)
        for drawn in (self.weight, self.bias):
            nn.init.normal_(drawn) if normal else nn.init.uniform_(drawn, -bound, bound)

    def forward(self, features: Tensor, tasks: Tensor) -> Tensor:
        """Shape (n, outputs), for features (n, inputs) and the numbers of their tasks (n,)."""
        # The outputs for all tasks cost less than a copy of the weights for each sample.
        outputs = nn.functional.linear(features, self.weight.flatten(0, 1), self.bias.flatten())
        return outputs.unflatten(1, self.bias.shape)[torch.arange(len(tasks), device=tasks.device), tasks]


class Actor(nn.Module):
    """A policy: logits of the 18 actions.

    Args:
        network: the layers' sizes.
        tasks: the number of heads.
        states: whether its observations are histories of states instead of pictures.
        batch_norm: whether it has batch norm, if its observations are pictures.
        normal: see `Heads`.
    """

    def __init__(
        self, network: Network, tasks: int, *, states: bool = False, batch_norm: bool = False, normal: bool = False
    ) -> None:
        super().__init__()
        self.batch_norm = batch_norm
        self.torso = StateTorso(network) if states else Torso(network, batch_norm=batch_norm)
        self.head = Heads(tasks, self.torso.features, ONE_HOT, normal=normal)

    def forward(self, observations: Tensor, tasks: Tensor) -> Tensor:
        """Logits, shape (n, 18), for observations as of `as_input` and the numbers of their tasks (n,)."""
        return self.head(self.torso(observations), tasks)


@torch.no_grad()
def standardise(torso: Torso, stacks: Tensor) -> None:
    """Scales the weights of a new torso so that each unit has mean 0 and deviation 1 over the stacks, before its ReLU.

    Pictures are mostly background. Without batch norm, randomly initialised units respond mainly to it, and policies
    act almost equally in all states for tens of thousands of steps. Here each layer starts as if it had batch norm (the
    data-dependent initialisation of Salimans and Kingma, 2016). The paper does not say how weights are initialised.
    """
    values = stacks
    for layer in (*torso.convolutions, nn.Flatten(), *torso.linear):
        if isinstance(layer, nn.Conv2d | nn.Linear):
            answers = layer(values)
            over = [axis for axis in range(answers.dim()) if axis != 1]
            deviation = answers.std(over).clamp(min=1e-6)  # a unit may be constant
            weight, bias = layer.parameters()
            weight.div_(deviation.reshape(-1, *[1] * (weight.dim() - 1)))
            bias.sub_(answers.mean(over)).div_(deviation)
        values = layer(values)
