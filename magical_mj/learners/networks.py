"""Networks: the paper's for pictures (appendix, "Network architecture"), one for states, and a head for each task."""

from __future__ import annotations

import math
from typing import Any, Final

import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical_mj.learners.settings import HEADS, NetworkSettings
from magical_mj.learners.state_features import ENTITY_FEATURES, ROBOT_FEATURES, features_of, maxima
from magical_mj.scene.actions import ACTIONS
from magical_mj.utils.errors import SettingsError

SHAPE: Final = (96, 96, 12)
"""Of what networks look at: four RGB frames, stacked along the channels."""
ONE_HOT: Final = len(ACTIONS)
MOST_PARAMETERS: Final = 50_000_000
"""The largest network that is built, 30 times the paper's: its weights are 200 MB, and training needs some more."""


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
    # Pictures are bytes, of which `float` makes a copy; to scale it in place is faster than to make another.
    return values.div_(255).permute(0, 3, 1, 2) if values.dim() == 4 else values


def check_size(numbers: int, what: str = "parameters") -> None:
    """Raises a `SettingsError` for so many numbers in a network, which may be what a stranger's file asks for."""
    if numbers > MOST_PARAMETERS:
        raise SettingsError(
            f"a network with {numbers:,} {what} is too large, for {MOST_PARAMETERS:,} is the most: choose smaller "
            "sizes (network.*, features.size)"
        )


def convolutions(network: NetworkSettings) -> list[tuple[int, int, int]]:
    """Channels, kernel and stride of each convolution, from the pictures inwards."""
    return [(network.first_channels, network.first_kernel, network.first_stride)] + 4 * [(network.channels, 3, 2)]


def last_layers(inputs: int, hidden: int, features: int) -> nn.Sequential:
    """The two linear layers with which both torsos end."""
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, features), nn.ReLU())


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
        network: NetworkSettings,
        *,
        batch_norm: bool = False,
        actions: bool = False,
        features: int | None = None,
    ) -> None:
        super().__init__()
        self.features = features or network.hidden
        side, self.channels = SHAPE[0], 3 * network.frames
        channels, parameters, units = self.channels, 0, 0
        for outputs, kernel, stride in convolutions(network):
            parameters += channels * outputs * kernel**2
            channels, side = outputs, math.ceil(side / stride)
            units += channels * side**2
        self.flat = channels * side * side
        inputs = self.flat + (ONE_HOT if actions else 0)
        check_size(parameters + (inputs + self.features) * network.hidden)
        check_size(units, "activations for each picture")
        layers: list[nn.Module] = []
        channels = self.channels
        for outputs, kernel, stride in convolutions(network):
            layers.append(nn.Conv2d(channels, outputs, kernel, stride, padding=kernel // 2, bias=not batch_norm))
            layers += [nn.BatchNorm2d(outputs)] if batch_norm else []
            layers.append(nn.ReLU())
            channels = outputs
        self.convolutions = nn.Sequential(*layers).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self.linear = last_layers(inputs, network.hidden, self.features)

    def forward(self, stacks: Tensor, actions: Tensor | None = None) -> Tensor:
        """Features, shape (n, features), of stacks (n, 3k, 96, 96) in [0, 1] and actions (n,), if it has any."""
        flat = self.convolutions(stacks[:, -self.channels :]).flatten(1)
        if actions is not None:
            flat = torch.cat([flat, nn.functional.one_hot(actions, ONE_HOT).to(flat.dtype)], dim=1)
        return self.linear(flat)


class StateTorso(nn.Module):
    """From histories to features: attention between blocks and regions, then the maxima over them.

    The order in which blocks and regions are listed changes nothing, and there may be any number of them.

    Args:
        network: the layers' sizes.
        actions: join one-hot actions to what the last two layers get; the discriminator and AL's encoder do.
        features: units of the last layer, instead of `network.hidden`.
    """

    def __init__(self, network: NetworkSettings, *, actions: bool = False, features: int | None = None) -> None:
        super().__init__()
        size, self.features = network.entity, features or network.hidden
        inputs = ROBOT_FEATURES + size + (ONE_HOT if actions else 0)
        layer = (3 + 1 + 2) * size**2
        check_size(network.attention * layer + size**2 + (inputs + self.features) * network.hidden)
        self.entity = nn.Sequential(nn.Linear(ROBOT_FEATURES + ENTITY_FEATURES, size), nn.ReLU(), nn.Linear(size, size))
        self.attention = nn.ModuleList(Attention(size) for _ in range(network.attention))
        self.linear = last_layers(inputs, network.hidden, self.features)

    def forward(self, observations: Tensor, actions: Tensor | None = None) -> Tensor:
        """Features, shape (n, features), of histories (n, HISTORY, names) and actions (n,), if it has any."""
        robot, entities, present = features_of(observations)
        rows = self.entity(torch.cat([entities, robot[:, None].expand(-1, entities.shape[1], -1)], 2))
        for layer in self.attention:
            rows = layer(rows, present)
        parts = [robot, maxima(rows, present)]
        if actions is not None:
            parts.append(nn.functional.one_hot(actions, ONE_HOT).to(robot.dtype))
        return self.linear(torch.cat(parts, dim=1))


class Attention(nn.Module):
    """One layer of a transformer's encoder (Vaswani et al., 2017), without normalisation: two suffice without it."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.qkv = nn.Linear(size, 3 * size)
        self.out_proj = nn.Linear(size, size)
        self.mlp = nn.Sequential(nn.ReLU(), nn.Linear(size, size), nn.ReLU(), nn.Linear(size, size))

    def forward(self, rows: Tensor, present: Tensor) -> Tensor:
        """New rows, (n, rows, size), that know of the other rows that are `present`, (n, rows)."""
        query, key, value = self.qkv(rows).unflatten(2, (3, HEADS, -1)).permute(2, 0, 3, 1, 4)
        # PyTorch's own attention has no second derivative, which WGAIL-GP's penalty needs.
        similarity = query @ key.transpose(2, 3) / math.sqrt(query.shape[3])
        attended = similarity.masked_fill(~present[:, None, None], -1e4).softmax(3) @ value
        rows = rows + self.out_proj(attended.transpose(1, 2).flatten(2))
        return rows + self.mlp(rows)


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
        check_size(tasks * outputs * inputs)
        self.weight = nn.Parameter(torch.empty(tasks, outputs, inputs))
        self.bias = nn.Parameter(torch.empty(tasks, outputs))
        bound = 1 / math.sqrt(inputs)
        for values in (self.weight, self.bias):
            nn.init.normal_(values) if normal else nn.init.uniform_(values, -bound, bound)

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
        self,
        network: NetworkSettings,
        tasks: int,
        *,
        states: bool = False,
        batch_norm: bool = False,
        normal: bool = False,
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
