"""Networks: the paper's for pictures (appendix, "Network architecture"), one for states, and a head for each task."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical_mj.learners.settings import HEADS, NetworkSettings
from magical_mj.policies.interface import HISTORY
from magical_mj.scene.actions import ACTIONS
from magical_mj.scene.state_vector import FINGERS, MAX_BLOCKS, MAX_REGIONS, STATE_NAMES
from magical_mj.utils.errors import SettingsError

SHAPE: Final = (96, 96, 12)
"""The shape of pictures that networks look at: four RGB frames, stacked along the channels."""
ONE_HOT: Final = len(ACTIONS)
MOST_PARAMETERS: Final = 50_000_000
"""The largest network that is built, 30 times the paper's: its weights are 200 MB, and training needs some more."""

BLOCKS: Final = slice(STATE_NAMES.index("block0.present"), STATE_NAMES.index("region0.present"))
"""Columns of all blocks: for each present, x, y, angle, three velocities, four shapes, four colours."""
REGIONS: Final = slice(BLOCKS.stop, len(STATE_NAMES))
"""Columns of all regions: for each present, x_min, y_min, x_max, y_max, four colours."""
SHAPES: Final = slice(7, 11)
"""The columns of a block that tell its shape."""
COLOURS: Final = slice(11, 15)
"""The columns of a block that tell its colour; of a region, these are the last four."""
_MOVEMENT: Final = 0.1
"""Units or radians that count as 1 in movements between two states; positions and angles count as they are.

These scales are fixed. Scaled by their deviation in the demonstrations, positions that hardly vary there would
dominate as soon as they vary a little, as in the Jitter variant.
"""

_ENTITY: Final[Mapping[str, int]] = {
    "place seen by the robot": 2,
    "heading seen by the robot": 2,  # sine and cosine; all regions are parallel to the axes
    "place": 2,
    "shape": 4,
    "colour": 4,
    "movements": 3 * (HISTORY - 1),
    "half size": 2,
    "is a region": 1,
}
"""The features of a block or a region and their widths, in order; those that one of the two lacks are 0 there."""
ENTITY_FEATURES: Final = sum(_ENTITY.values())
ROBOT_FEATURES: Final = 6 + 5 * (HISTORY - 1)


def as_input(observations: NDArray[Any] | Tensor, device: torch.device) -> Tensor:
    """Observations of environments as inputs of networks: pictures (n, side, side, 3k) from 0 to 255, or histories.

    Pictures become stacks (n, 3k, side, side) with values in [0, 1], in memory format channels-last, which is faster;
    histories (n, HISTORY, names) stay as they are.
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
        """Features, shape (n, features), of stacks (n, 3k, 96, 96) in [0, 1] and actions (n,), if it has any."""
        flat = self.convolutions(stacks[:, -self.channels :]).flatten(1)
        if actions is not None:
            flat = torch.cat([flat, nn.functional.one_hot(actions, ONE_HOT).to(flat.dtype)], dim=1)
        return self.linear(flat)


class StateTorso(nn.Module):
    """From histories to features: attention between blocks and regions, then the maxima over them.

    The order in which blocks and regions are listed changes nothing, and there may be any number of them. One-hot
    actions are joined to what the last two layers get; otherwise the arguments are those of a `Torso`.
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

    With `normal`, weights are initialised from N(0, 1), as the original's released learners do; the paper's SGD hardly
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
    """A policy: logits of the 18 actions, for pictures, perhaps with batch norm, or for histories of states."""

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


def blocks_of(states: Tensor) -> Tensor:
    """The blocks' columns, a view of shape (..., MAX_BLOCKS, columns), of states (..., names)."""
    return states[..., BLOCKS].unflatten(-1, (MAX_BLOCKS, -1))


def regions_of(states: Tensor) -> Tensor:
    """The regions' columns, a view of shape (..., MAX_REGIONS, columns), of states (..., names)."""
    return states[..., REGIONS].unflatten(-1, (MAX_REGIONS, -1))


def features_of(histories: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Histories (n, HISTORY, names) as the robot sees them, in its frame, whatever the order of the blocks.

    Velocities are not used, so poses and finger angles from any source will do.

    Returns:
        The robot's features (n, ROBOT_FEATURES); those of each block and region (n, rows, ENTITY_FEATURES); which of
        these rows stand for something (n, rows). Rows that stand for nothing in the whole batch are left out, but in a
        network that is exported.
    """
    robot = _Robot(histories)
    blocks, regions = blocks_of(histories), regions_of(histories[:, -1])
    if not torch.compiler.is_exporting():  # the shapes in an exported network do not depend on what it sees
        blocks = blocks[:, :, blocks[:, -1, :, 0].any(0)]
        regions = regions[:, regions[..., 0].any(0)]
    present = torch.cat([blocks[:, -1, :, 0], regions[..., 0]], 1) > 0
    return robot.features(), torch.cat([_of_blocks(blocks, robot), _of_regions(regions, robot)], 1), present


def maxima(rows: Tensor, present: Tensor) -> Tensor:
    """The largest values, (n, size), of the rows (n, rows, size) that are `present` (n, rows)."""
    # An exported network keeps all empty rows. A scene that is alone in its batch has none: they must not count there.
    empty = -1e4 if torch.compiler.is_exporting() else -10.0
    if not rows.shape[1]:  # a scene without blocks and regions
        return rows.new_full((len(rows), rows.shape[2]), empty)
    return rows.masked_fill(~present[..., None], empty).amax(1)


def pose_mask(histories: Tensor) -> Tensor:
    """1 for the poses of the robot and of blocks that are present, and for the fingers; else 0: as `histories`."""
    mask = torch.zeros_like(histories)
    mask[..., :3] = mask[..., FINGERS] = 1
    blocks_of(mask)[..., 1:4] = blocks_of(histories)[..., :1]
    return mask


class _Robot:
    """The robot of each history, (n, HISTORY, names), and its view of other things."""

    def __init__(self, histories: Tensor) -> None:
        self._histories, self._now = histories, histories[:, -1]
        self.place, self.angle = self._now[:, :2], self._now[:, 2]
        self._sin, self._cos = self.angle.sin(), self.angle.cos()
        self._frame = torch.stack([self._cos, self._sin, -self._sin, self._cos], 1).unflatten(1, (2, 2))

    def features(self) -> Tensor:
        """Shape (n, ROBOT_FEATURES): its pose, its fingers, and the movements of both."""
        fingers = (self._now[:, None] - self._histories[:, :-1])[..., FINGERS].flatten(1) / _MOVEMENT
        pose = [self.place, self._sin[:, None], self._cos[:, None], self._now[:, FINGERS]]
        return torch.cat([*pose, self.movements(self._histories[..., :3]), fingers], 1)

    def rotated(self, vectors: Tensor) -> Tensor:
        """Vectors of the world, (n, ..., 2), in the robot's frame."""
        return torch.einsum("nij,n...j->n...i", self._frame, vectors)

    def movements(self, poses: Tensor) -> Tensor:
        """From each earlier pose of (n, HISTORY, ..., 3) to the present one, (n, ..., 3 * (HISTORY - 1))."""
        moved = (poses[:, -1:] - poses[:, :-1]) / _MOVEMENT
        return torch.cat([self.rotated(moved[..., :2]), moved[..., 2:]], -1).movedim(1, -2).flatten(-2)

    def view(self, place: Tensor, angle: Tensor) -> dict[str, Tensor]:
        """Where it sees things at these places (n, rows, 2) with these angles (n, rows, 1): some of the `_ENTITY`."""
        heading = angle - self.angle[:, None, None]
        return {
            "place seen by the robot": self.rotated(place - self.place[:, None]),
            "heading seen by the robot": torch.cat([heading.sin(), heading.cos()], -1),
            "place": place,
        }


def _of_blocks(blocks: Tensor, robot: _Robot) -> Tensor:
    """Features (n, rows, ENTITY_FEATURES) of blocks (n, HISTORY, rows, columns)."""
    now = blocks[:, -1]
    view = robot.view(now[..., 1:3], now[..., 3:4])
    names = {"shape": now[..., SHAPES], "colour": now[..., COLOURS]}
    return _rows({**view, **names, "movements": robot.movements(blocks[..., 1:4])})


def _of_regions(regions: Tensor, robot: _Robot) -> Tensor:
    """Features (n, rows, ENTITY_FEATURES) of regions (n, rows, columns)."""
    lower, upper = regions[..., 1:3], regions[..., 3:5]
    view = robot.view((lower + upper) / 2, torch.zeros_like(regions[..., :1]))
    half = (upper - lower) / 2
    return _rows({**view, "colour": regions[..., 5:], "half size": half, "is a region": torch.ones_like(half[..., :1])})


def _rows(features: Mapping[str, Tensor]) -> Tensor:
    """Some of the `_ENTITY`, each of shape (n, rows, width), in their order; the others are 0."""
    place = features["place"]
    columns = []
    for name, width in _ENTITY.items():
        columns.append(features[name] if name in features else place.new_zeros(*place.shape[:2], width))
    return torch.cat(columns, -1)
