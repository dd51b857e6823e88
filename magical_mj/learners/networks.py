"""Networks: the paper's for pictures (appendix, "Network architecture"), one for states, and a head for each task."""

from __future__ import annotations

import math
from typing import Any, Final

import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical_mj.actions import ACTIONS
from magical_mj.learners.settings import HEADS, NetworkSettings
from magical_mj.observations import FINGERS, MAX_BLOCKS, MAX_REGIONS, STATE_NAMES
from magical_mj.policies.interface import HISTORY
from magical_mj.utils.errors import SettingsError

SHAPE: Final = (96, 96, 12)
"""The shape of networks' pictures: four RGB frames, stacked along the channels."""
ONE_HOT: Final = len(ACTIONS)
MOST_PARAMETERS: Final = 50_000_000
"""The size limit of networks, 30 times the paper's. The weights take 200 MB, and training needs several times that."""

BLOCKS: Final = slice(STATE_NAMES.index("block0.present"), STATE_NAMES.index("region0.present"))
"""The columns of all blocks. For each block: whether it is present, x, y, angle, three velocities, four shapes and four
colours."""
REGIONS: Final = slice(BLOCKS.stop, len(STATE_NAMES))
"""The columns of all regions. For each region: whether it is present, x_min, y_min, x_max, y_max and four colours."""
SHAPES: Final = slice(7, 11)
"""The columns of a block with its shape."""
COLOURS: Final = slice(11, 15)
"""The columns of a block with its colour. A region's colour is in its last four columns."""
_MOVEMENT: Final = 0.1
"""The scale of movements between two states, in units or radians. Positions and angles are not scaled.

The scale is fixed. If features were scaled by their deviation in the demonstrations, positions that hardly vary there
would dominate as soon as they vary a little, as in the Jitter variant.
"""

ENTITY_FEATURES: Final = 2 + 2 + 2 + 4 + 4 + 3 * (HISTORY - 1) + 2 + 1
"""The number of features of a block or a region: position and heading (sine and cosine) in the robot's frame, position,
shape, colour, movements, half size, and 1 for a region. Features that do not apply are 0, as is a region's angle."""
ROBOT_FEATURES: Final = 6 + 5 * (HISTORY - 1)


def as_input(observations: NDArray[Any] | Tensor, device: torch.device) -> Tensor:
    """Observations as inputs of networks: pictures (n, side, side, 3k) from 0 to 255, or histories of states.

    Pictures become stacks (n, 3k, side, side) with values in [0, 1], in the memory format channels-last, which is
    faster. Histories (n, HISTORY, names) are unchanged.
    """
    values = torch.as_tensor(observations).to(device).float()
    # `float` copies the pictures, which are bytes. Scaling the copy in place is faster than a second copy.
    return values.div_(255).permute(0, 3, 1, 2) if values.dim() == 4 else values


def check_size(numbers: int, what: str = "parameters") -> None:
    """Raises a `SettingsError` if a network is too large: a file from elsewhere may contain any sizes."""
    if numbers > MOST_PARAMETERS:
        raise SettingsError(
            f"a network with {numbers:,} {what} is too large, at most {MOST_PARAMETERS:,} are allowed: choose smaller "
            "sizes (network.*, features.size)"
        )


def convolutions(network: NetworkSettings) -> list[tuple[int, int, int]]:
    """Channels, kernel and stride of each convolution, from the pictures inwards."""
    return [(network.first_channels, network.first_kernel, network.first_stride)] + 4 * [(network.channels, 3, 2)]


def last_layers(inputs: int, hidden: int, features: int) -> nn.Sequential:
    """The last two linear layers of both torsos."""
    return nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, features), nn.ReLU())


class Torso(nn.Module):
    """The layers that all tasks share. They map stacks of frames to features.

    Args:
        network: the layers' sizes.
        batch_norm: add batch norm after each convolution, as in BC's policy, the discriminator and AL's encoder.
        actions: append one-hot actions to the convolutions' output, as in the discriminator and AL's encoder.
        features: units of the last layer; None means `network.hidden`.
    """

    def __init__(
        self, network: NetworkSettings, *, batch_norm: bool = False, actions: bool = False, features: int | None = None
    ) -> None:
        super().__init__()
        self.features = features or network.hidden
        side, self.channels = SHAPE[0], 3 * network.frames
        channels, parameters, units = self.channels, 0, 0
        layers: list[nn.Module] = []
        for outputs, kernel, stride in convolutions(network):
            side = math.ceil(side / stride)
            parameters += channels * outputs * kernel**2
            units += outputs * side**2
            check_size(parameters)
            check_size(units, "activations for each picture")
            layers.append(nn.Conv2d(channels, outputs, kernel, stride, padding=kernel // 2, bias=not batch_norm))
            layers += [nn.BatchNorm2d(outputs)] if batch_norm else []
            layers.append(nn.ReLU())
            channels = outputs
        self.flat = channels * side * side
        inputs = self.flat + (ONE_HOT if actions else 0)
        check_size(parameters + (inputs + self.features) * network.hidden)
        self.convolutions = nn.Sequential(*layers).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self.linear = last_layers(inputs, network.hidden, self.features)

    def forward(self, stacks: Tensor, actions: Tensor | None = None) -> Tensor:
        """Features, shape (n, features), of stacks (n, 3k, 96, 96) in [0, 1] and actions (n,), if it uses them."""
        flat = self.convolutions(stacks[:, -self.channels :]).flatten(1)
        if actions is not None:
            flat = torch.cat([flat, nn.functional.one_hot(actions, ONE_HOT).to(flat.dtype)], dim=1)
        return self.linear(flat)


class StateTorso(nn.Module):
    """Maps histories of states to features: attention between blocks and regions, then the maxima over them.

    The order of blocks and regions has no effect, and their number may vary. One-hot actions are appended to the input
    of the last two layers. The arguments are those of a `Torso`.
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
        """Features, shape (n, features), of histories (n, HISTORY, names) and actions (n,), if it uses them."""
        robot, entities, present = features_of(observations)
        rows = self.entity(torch.cat([entities, robot[:, None].expand(-1, entities.shape[1], -1)], 2))
        for layer in self.attention:
            rows = layer(rows, present)
        parts = [robot, maxima(rows, present)]
        if actions is not None:
            parts.append(nn.functional.one_hot(actions, ONE_HOT).to(robot.dtype))
        return self.linear(torch.cat(parts, dim=1))


class Attention(nn.Module):
    """One layer of a transformer's encoder (Vaswani et al., 2017). Two such layers need no normalisation."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.qkv = nn.Linear(size, 3 * size)
        self.out_proj = nn.Linear(size, size)
        self.mlp = nn.Sequential(nn.ReLU(), nn.Linear(size, size), nn.ReLU(), nn.Linear(size, size))

    def forward(self, rows: Tensor, present: Tensor) -> Tensor:
        """New rows (n, rows, size), which depend on the other rows that are `present`, (n, rows)."""
        query, key, value = self.qkv(rows).unflatten(2, (3, HEADS, -1)).permute(2, 0, 3, 1, 4)
        # PyTorch's own attention has no second derivative, which WGAIL-GP's penalty needs.
        similarity = query @ key.transpose(2, 3) / math.sqrt(query.shape[3])
        attended = similarity.masked_fill(~present[:, None, None], -1e4).softmax(3) @ value
        rows = rows + self.out_proj(attended.transpose(1, 2).flatten(2))
        return rows + self.mlp(rows)


class Heads(nn.Module):
    """The last layer, with a separate linear map for each task.

    With `normal`, weights are initialised from N(0, 1), as in the original's released learners: the paper's SGD hardly
    learns otherwise. Without it, nn.Linear's default is used.
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
        samples = torch.arange(tasks.shape[0], device=tasks.device)  # len() would be a constant when it is exported
        return outputs.unflatten(1, self.bias.shape)[samples, tasks]


class Actor(nn.Module):
    """A policy network: logits of the 18 actions for pictures, optionally with batch norm, or for state histories."""

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
        """Logits, shape (n, 18), for observations from `as_input` and the numbers of their tasks (n,)."""
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


def blocks_of(states: Tensor) -> Tensor:
    """A view of the blocks' columns in states (..., names), of shape (..., MAX_BLOCKS, columns)."""
    return states[..., BLOCKS].unflatten(-1, (MAX_BLOCKS, -1))


def regions_of(states: Tensor) -> Tensor:
    """A view of the regions' columns in states (..., names), of shape (..., MAX_REGIONS, columns)."""
    return states[..., REGIONS].unflatten(-1, (MAX_REGIONS, -1))


def features_of(histories: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Features of histories (n, HISTORY, names) in the robot's frame, independent of the order of the blocks.

    Velocities are not used, so poses and finger angles are sufficient.

    Returns:
        The robot's features (n, ROBOT_FEATURES); those of each block and region (n, rows, ENTITY_FEATURES); which of
        these rows are present (n, rows). Rows that are empty in the whole batch are left out, except in an exported
        network.
    """
    robot = _Robot(histories)
    blocks, regions = blocks_of(histories), regions_of(histories[:, -1])
    if not torch.compiler.is_exporting():  # the shapes in an exported network are fixed
        blocks = blocks[:, :, blocks[:, -1, :, 0].any(0)]
        regions = regions[:, regions[..., 0].any(0)]
    present = torch.cat([blocks[:, -1, :, 0], regions[..., 0]], 1) > 0
    return robot.features(), torch.cat([_of_blocks(blocks, robot), _of_regions(regions, robot)], 1), present


def maxima(rows: Tensor, present: Tensor) -> Tensor:
    """The largest values, (n, size), of the rows (n, rows, size) that are `present` (n, rows)."""
    # An exported network keeps all empty rows, while here a batch with a single scene has none. With the lower value,
    # the exported network's empty rows do not affect its result.
    empty = -1e4 if torch.compiler.is_exporting() else -10.0
    if not rows.shape[1]:  # a scene without blocks and regions
        return rows.new_full((len(rows), rows.shape[2]), empty)
    return rows.masked_fill(~present[..., None], empty).amax(1)


def pose_mask(histories: Tensor) -> Tensor:
    """1 for the poses of the robot and of present blocks, and for the fingers; 0 otherwise. Shape of `histories`."""
    mask = torch.zeros_like(histories)
    mask[..., :3] = mask[..., FINGERS] = 1
    blocks_of(mask)[..., 1:4] = blocks_of(histories)[..., :1]
    return mask


class _Robot:
    """The robot of each history (n, HISTORY, names), and other objects in its frame."""

    def __init__(self, histories: Tensor) -> None:
        self._histories, self._now = histories, histories[:, -1]
        self.position, self.angle = self._now[:, :2], self._now[:, 2]
        self._sin, self._cos = self.angle.sin(), self.angle.cos()
        self._frame = torch.stack([self._cos, self._sin, -self._sin, self._cos], 1).unflatten(1, (2, 2))

    def features(self) -> Tensor:
        """Shape (n, ROBOT_FEATURES): its pose, its fingers, and the movements of both."""
        fingers = (self._now[:, None] - self._histories[:, :-1])[..., FINGERS].flatten(1) / _MOVEMENT
        pose = [self.position, self._sin[:, None], self._cos[:, None], self._now[:, FINGERS]]
        return torch.cat([*pose, self.movements(self._histories[..., :3]), fingers], 1)

    def rotated(self, vectors: Tensor) -> Tensor:
        """World vectors (n, ..., 2) in the robot's frame."""
        return torch.einsum("nij,n...j->n...i", self._frame, vectors)

    def movements(self, poses: Tensor) -> Tensor:
        """Differences of the last pose in (n, HISTORY, ..., 3) and the earlier ones, (n, ..., 3 * (HISTORY - 1))."""
        moved = (poses[:, -1:] - poses[:, :-1]) / _MOVEMENT
        return torch.cat([self.rotated(moved[..., :2]), moved[..., 2:]], -1).movedim(1, -2).flatten(-2)

    def view(self, position: Tensor, angle: Tensor) -> list[Tensor]:
        """Position and heading in the robot's frame, and the position in the world, for each object.

        Positions have the shape (n, rows, 2), and angles (n, rows, 1).
        """
        heading = angle - self.angle[:, None, None]
        seen = self.rotated(position - self.position[:, None])
        return [seen, torch.cat([heading.sin(), heading.cos()], -1), position]


def _of_blocks(blocks: Tensor, robot: _Robot) -> Tensor:
    """The features (n, rows, ENTITY_FEATURES) of blocks (n, HISTORY, rows, columns)."""
    now = blocks[:, -1]
    view, movements = robot.view(now[..., 1:3], now[..., 3:4]), robot.movements(blocks[..., 1:4])
    return nn.functional.pad(torch.cat([*view, now[..., SHAPES], now[..., COLOURS], movements], -1), (0, 3))


def _of_regions(regions: Tensor, robot: _Robot) -> Tensor:
    """The features (n, rows, ENTITY_FEATURES) of regions (n, rows, columns)."""
    lower, upper = regions[..., 1:3], regions[..., 3:5]
    view, half = robot.view((lower + upper) / 2, torch.zeros_like(regions[..., :1])), (upper - lower) / 2
    shape, movements = (regions.new_zeros(*regions.shape[:2], width) for width in (4, 3 * (HISTORY - 1)))
    return torch.cat([*view, shape, regions[..., 5:], movements, half, torch.ones_like(half[..., :1])], -1)
