"""Sight: networks that map pictures of the arena to states of the scene, without velocities and angles of blocks.

The picture is divided into cells. For each, a network tells whether it contains the centre of a block, of a region or
of the robot, and where exactly, with colour and box. Two smaller networks look at the parts of the picture that show a
block or the robot. They tell the block's shape, and the robot's heading and fingers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical_intents.scenery import SIZE, View
from magical_intents.symmetries import Symmetry, changed, drawn
from magical_mj.learners.networks import COLOURS, SHAPES, blocks_of, regions_of
from magical_mj.observations import FINGERS, MAX_BLOCKS, MAX_REGIONS, STATE_NAMES
from magical_mj.scene.constants import SHAPES as SHAPE_NAMES
from magical_mj.scene.constants import VISIBLE_SIZE

SIDE: Final = 24
"""The number of cells in a row."""
CELL: Final = VISIBLE_SIZE / SIDE
"""The side of a cell (units)."""
BATCH: Final = 32
"""The number of pictures in a batch."""
CHANNELS: Final = 40
DILATIONS: Final = (1, 1, 2, 1)
"""The spacing of the pixels that the convolutions combine, in cells."""
WIDTHS: Final = {"block": (1, 2, 4), "region": (1, 4, 4), "robot": (1, 2)}
"""The numbers of outputs for each cell: presence; then offset, colour; or box, colour; or offset."""
OUTPUTS: Final = 19
PRESENCE, RARE = [0, 7, 16], -5.0
"""The outputs that tell of presence, as logits, and their values before the training."""
PRESENT: Final = 0.2
"""The weight of presence in the loss."""
AT: Final = {"block": 0.5, "region": 1.0, "robot": 0.5}
"""An object is at the cells whose centres are nearer to its own, in x and y (cells)."""
DOUBTFUL: Final = 0.25
"""Cells up to this farther may also say that it is there."""
NEAREST: Final = {"block": 0.17, "region": 0.3}
"""Objects whose centres are nearer (units) are one."""
BLOCK_PIXELS, ROBOT_PIXELS = 16, 40
"""The sides of the parts of the picture that show a block, or the robot."""
FINGER: Final = 0.4
"""The scale of the fingers' angles (rad)."""
INEXACT: Final = 0.01
"""The standard deviation of noise on the centres of these parts in the training (units)."""


class Sight(nn.Module):
    """Finds objects in pictures, and then looks at blocks and at the robot."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = [nn.Conv2d(3, CHANNELS, 4, 4), nn.ReLU()]
        for spacing in DILATIONS:
            layers += [nn.Conv2d(CHANNELS, CHANNELS, 3, 1, spacing, spacing), nn.ReLU()]
        last = nn.Conv2d(CHANNELS, OUTPUTS, 1)
        with torch.no_grad():
            cast(Tensor, last.bias)[PRESENCE] = RARE
        self.layers = nn.Sequential(*layers, last).to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self.shape = _look(BLOCK_PIXELS, len(SHAPE_NAMES))
        self.robot = _look(ROBOT_PIXELS, 4)

    def forward(self, inputs: Tensor) -> dict[str, tuple[Tensor, ...]]:
        """The parts of the outputs, each (n, cells, width), for inputs (n, 3, 96, 96)."""
        seen = self.layers(inputs).flatten(2).transpose(1, 2)
        parts = iter(seen.split([width for widths in WIDTHS.values() for width in widths], 2))
        return {name: tuple(next(parts) for _ in widths) for name, widths in WIDTHS.items()}

    @torch.inference_mode()
    def states(self, pictures: NDArray[Any]) -> NDArray[np.float32]:
        """The states (n, names) of pictures (n, 96, 96, 3). Blocks and regions are in no particular order."""
        inputs = inputs_of(torch.from_numpy(np.ascontiguousarray(pictures)))
        seen, states = self(inputs), torch.zeros(len(pictures), len(STATE_NAMES))
        blocks, regions = blocks_of(states), regions_of(states)
        at, offset, colour = seen["block"]
        rows, cells, numbers = _peaks(at[..., 0], _CENTRES + CELL * offset, NEAREST["block"], MAX_BLOCKS)
        places = _CENTRES[cells] + CELL * offset[rows, cells]
        blocks[rows, numbers, 0] = 1
        blocks[rows, numbers, 1:3] = places
        blocks[rows, numbers, SHAPES] = _chosen(self.shape(parts_of(inputs, rows, places, BLOCK_PIXELS)))
        blocks[rows, numbers, COLOURS] = _chosen(colour[rows, cells])
        at, box, colour = seen["region"]
        boxes = _CENTRES.repeat(1, 2) + box
        middles = (boxes[..., :2] + boxes[..., 2:]) / 2
        rows, cells, numbers = _peaks(at[..., 0], middles, NEAREST["region"], MAX_REGIONS)
        regions[rows, numbers, 0] = 1
        regions[rows, numbers, 1:5] = boxes[rows, cells]
        regions[rows, numbers, 5:] = _chosen(colour[rows, cells])
        at, offset = seen["robot"]
        rows, cells = torch.arange(len(states)), at[..., 0].argmax(1)
        states[:, :2] = places = _CENTRES[cells] + CELL * offset[rows, cells]
        sin, cos, *fingers = self.robot(parts_of(inputs, rows, places, ROBOT_PIXELS)).unbind(1)
        states[:, 2] = torch.atan2(sin, cos)
        states[:, FINGERS] = FINGER * torch.stack(fingers, 1)
        return states.numpy()


def _look(side: int, outputs: int) -> nn.Sequential:
    """A network for parts of pictures."""
    return nn.Sequential(
        nn.Conv2d(3, 24, 3, 1, 1), nn.ReLU(), nn.MaxPool2d(2),
        nn.Conv2d(24, 32, 3, 1, 1), nn.ReLU(), nn.MaxPool2d(2),
        nn.Flatten(), nn.Linear(2 * side * side, 96), nn.ReLU(), nn.Linear(96, outputs),
    )  # fmt: skip


def inputs_of(pictures: Tensor) -> Tensor:
    """Inputs (n, 3, 96, 96) for pictures (n, 96, 96, 3) from 0 to 255. White becomes 0."""
    return 2 - pictures.permute(0, 3, 1, 2).float() / 127.5


def parts_of(inputs: Tensor, rows: Tensor, places: Tensor, side: int) -> Tensor:
    """The parts (k, 3, side, side) of the inputs of some rows (k,) around places (k, 2)."""
    steps = (torch.arange(side) - (side - 1) / 2) * (2 / SIZE)
    middles = places * torch.tensor([1.0, -1.0]) / (VISIBLE_SIZE / 2)
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    grid = middles[:, None, None] + torch.stack([x, y], 2)
    return nn.functional.grid_sample(inputs[rows], grid, padding_mode="border", align_corners=False)


def _chosen(logits: Tensor) -> Tensor:
    """One-hot vectors of the largest logits."""
    return nn.functional.one_hot(logits.argmax(1), logits.shape[1]).float()


def _peaks(logits: Tensor, places: Tensor, apart: float, most: int) -> tuple[Tensor, Tensor, Tensor]:
    """The cells where an object is more likely than not, without those near a more likely one.

    Returns:
        The row, the cell, and the number of each object in its picture, each of shape (k,).
    """
    found: list[tuple[int, int, int]] = []
    for row, (values, where) in enumerate(zip(logits, places, strict=True)):
        kept: list[int] = []
        cells = torch.nonzero(values > 0)[:, 0]
        for cell in cells[values[cells].argsort(descending=True)].tolist():
            if len(kept) < most and all(math.dist(where[cell], where[other]) > apart for other in kept):
                found.append((row, cell, len(kept)))
                kept.append(cell)
    rows, cells, numbers = torch.tensor(found, dtype=torch.int64).reshape(-1, 3).unbind(1)
    return rows, cells, numbers


def sight_loss(network: Sight, data: Sequence[View], rng: np.random.Generator, size: int = BATCH) -> Tensor:
    """The loss of random pictures, mirrored and turned: of presence, classes, and squared errors of the rest."""
    chosen = [data[number] for number in rng.integers(len(data), size=size)]
    pictures, states = (torch.from_numpy(np.stack(part)) for part in zip(*chosen, strict=True))
    same = torch.arange(4).expand(size, 4)
    by = drawn(size, rng)._replace(colours=same, shapes=same)
    states, inputs = changed(states[:, None], by)[:, 0], inputs_of(turned(pictures, by))
    seen, losses = network(inputs), list[Tensor]()
    for name, every in (("block", blocks_of(states)), ("region", regions_of(states))):
        rows, numbers = (every[..., 0] > 0).nonzero().unbind(1)
        which, (at, where, colour) = every[rows, numbers], seen[name]
        middles = which[:, 1:3] if name == "block" else (which[:, 1:3] + which[:, 3:5]) / 2
        objects, cells, presence = _placed(at, rows, middles, AT[name])
        losses.append(presence)
        if len(objects):
            wanted = which[objects, 1:3] / CELL if name == "block" else which[objects, 1:5]
            base = _CENTRES[cells] / CELL if name == "block" else _CENTRES[cells].repeat(1, 2)
            scale = 1.0 if name == "block" else 10.0
            losses.append(scale * _squared(where[rows[objects], cells], wanted - base))
            losses.append(_class(colour[rows[objects], cells], which[objects, -4:]))
        if name == "block":
            near = middles + INEXACT * torch.from_numpy(rng.standard_normal(middles.shape, np.float32))
            losses.append(_class(network.shape(parts_of(inputs, rows, near, BLOCK_PIXELS)), which[:, SHAPES]))
    at, offset = seen["robot"]
    rows, places, angle = torch.arange(size), states[:, :2], states[:, 2:3]
    _, cells, presence = _placed(at, rows, places, AT["robot"])
    near = places + INEXACT * torch.from_numpy(rng.standard_normal(places.shape, np.float32))
    wanted = torch.cat([angle.sin(), angle.cos(), states[:, FINGERS] / FINGER], 1)
    looks = network.robot(parts_of(inputs, rows, near, ROBOT_PIXELS))
    losses += [presence, _squared(offset[rows, cells], (places - _CENTRES[cells]) / CELL), 2 * _squared(looks, wanted)]
    return torch.stack(losses).sum()


def _placed(logits: Tensor, rows: Tensor, places: Tensor, reach: float) -> tuple[Tensor, Tensor, Tensor]:
    """The pairs of an object and a cell where it is, each (k,), and the loss of presence."""
    gaps = (_CENTRES - places[:, None]).abs().amax(2) / CELL
    objects, cells = (gaps <= reach).nonzero().unbind(1)
    weights, target = torch.ones_like(logits[..., 0]), torch.zeros_like(logits[..., 0])
    doubtful, unsure = (gaps < reach + DOUBTFUL).nonzero().unbind(1)
    weights[rows[doubtful], unsure] = 0
    weights[rows[objects], cells] = 1
    target[rows[objects], cells] = 1
    loss = nn.functional.binary_cross_entropy_with_logits(logits[..., 0], target, weights, reduction="sum")
    return objects, cells, PRESENT * loss / len(logits)


def _squared(values: Tensor, wanted: Tensor) -> Tensor:
    return (values - wanted).square().sum(1).mean()


def _class(logits: Tensor, wanted: Tensor) -> Tensor:
    return nn.functional.cross_entropy(logits, wanted.argmax(1))


def turned(pictures: Tensor, by: Symmetry) -> Tensor:
    """Pictures (n, side, side, 3), mirrored and turned."""
    found = []
    for picture, mirrored, turn in zip(pictures, by.mirrored, by.turn, strict=True):
        picture = picture.flip(1) if mirrored else picture
        found.append(torch.rot90(picture, round(float(turn) / (math.pi / 2))))
    return torch.stack(found)


def _centres() -> Tensor:
    """The centres of the cells (units), shape (cells, 2)."""
    at = (torch.arange(SIDE) + 0.5) * CELL - VISIBLE_SIZE / 2
    y, x = torch.meshgrid(at.flip(0), at, indexing="ij")
    return torch.stack([x, y], 2).flatten(0, 1)


_CENTRES: Final = _centres()
