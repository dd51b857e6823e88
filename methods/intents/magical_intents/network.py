"""Parts of the scorer: graphs of objects, attention between them, and sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import torch
from torch import Tensor, nn

from magical_intents.symmetries import LENGTH, WORDS
from magical_mj.learners.networks import COLOURS, SHAPES, blocks_of, regions_of
from magical_mj.observations import FINGERS

SIZE: Final = 64
HEADS: Final = 4
SIDES: Final = (0.6, 0.7, 0.8)
"""Coordinates (units), for features that say whether an object is beyond them, to each side."""
WAYS: Final = (0.1, 0.2)
"""The same for the distance that an object moved."""
GAPS: Final = (0.4, 0.5, 0.7)
"""The same for distances between objects."""
STEP: Final = 0.03
"""These features rise from 0 to 1 within a few times this distance (units)."""
NODE: Final = 2 + 2 + 2 + 4 + 4 + 2 + 1 + 3 + 4 * len(SIDES) + len(WAYS)
EDGE: Final = 2 * 5 + 2 + 1 + len(GAPS)


class Graph(NamedTuple):
    """Blocks, the robot and regions, as nodes of n graphs.

    Attributes:
        nodes: features, shape (n, k, NODE).
        edges: features of pairs, shape (n, k, k, EDGE).
        present: which nodes exist, shape (n, k).
        blocks: the number of nodes of blocks. The robot's node follows.
    """

    nodes: Tensor
    edges: Tensor
    present: Tensor
    blocks: int


def graph(initial: Tensor, now: Tensor) -> Graph:
    """The graphs of states (n, names) at the start and now, with as many blocks and regions as the scenes have."""
    count = int(blocks_of(now)[..., 0].sum(1).max())
    blocks, began = blocks_of(now)[:, :count], blocks_of(initial)[:, :count]
    regions = regions_of(now)
    regions = regions[:, regions[..., 0].any(0)]
    k = count + 1 + regions.shape[1]
    half = (regions[..., 3:5] - regions[..., 1:3]) / 2
    centre = regions[..., 1:3] + half
    at, before = (
        torch.cat([rows[..., 1:3], state[:, None, :2], centre], 1) for rows, state in ((blocks, now), (began, initial))
    )

    def placed(values: Tensor, first: int) -> Tensor:
        """Values (n, rows, width) in the nodes' rows from `first` on. All other rows are 0."""
        return nn.functional.pad(values, (0, 0, first, k - first - values.shape[1]))

    shapes = placed(blocks[..., SHAPES], 0)
    colours = placed(blocks[..., COLOURS], 0) + placed(regions[..., 5:], count + 1)
    fingers = now[:, None, FINGERS]
    kind = torch.eye(3)[torch.tensor([0] * count + [1] + [2] * regions.shape[1])].expand(len(now), -1, -1)
    sides = torch.cat([_beyond(at, SIDES), _beyond(-at, SIDES)], 2)
    ways = _beyond((at - before).norm(dim=2, keepdim=True), WAYS)
    parts = [at, before, at - before, shapes, colours, placed(half, count + 1), sides, ways]
    nodes = torch.cat([*parts, placed(fingers[..., :1] - fingers[..., 1:], count), kind], 2)
    edges = []
    for positions in (before, at):
        apart = positions[:, :, None] - positions[:, None]
        depth = nn.functional.pad(
            (half[:, None] - apart[:, :, count + 1 :].abs()).amin(3).clamp(-0.5, 0.5), (count + 1, 0)
        )
        depth = (depth + depth.transpose(1, 2))[..., None]
        edges += [apart, apart.norm(dim=3, keepdim=True), depth, _beyond(depth, (0.0,))]
    edges += [(values @ values.transpose(1, 2))[..., None] for values in (colours, shapes)]
    there = torch.ones_like(now[:, :1])
    present = torch.cat([blocks[..., 0], there, regions[..., 0]], 1) > 0
    gaps = edges[1].masked_fill(~present[:, :, None, None] | torch.eye(k, dtype=torch.bool)[..., None], 9.0)
    nearest = gaps <= gaps[:, :count].amin(1, keepdim=True)
    edges += [nearest.float(), _beyond(edges[5], GAPS)]
    return Graph(nodes, torch.cat(edges, 3), present, count)


def _beyond(values: Tensor, limits: Sequence[float]) -> Tensor:
    """Whether values (..., size) are larger than limits, between 0 and 1, shape (..., size * limits)."""
    return ((values[..., None] - torch.tensor(limits)) / STEP).sigmoid().flatten(-2)


class Layer(nn.Module):
    """A transformer's layer: attention between rows, and a network for each row.

    A row receives the values of the rows that it attends to, and the features of the pairs that they form.

    Args:
        edge: the number of features of a pair; 0 if there are none.
    """

    def __init__(self, edge: int = 0) -> None:
        super().__init__()
        self.norms = nn.ModuleList(nn.LayerNorm(SIZE) for _ in range(2))
        self.query, self.keys, self.out = nn.Linear(SIZE, SIZE), nn.Linear(SIZE, 2 * SIZE), nn.Linear(SIZE, SIZE)
        self.read = nn.Linear(HEADS * edge, SIZE) if edge else None
        self.mlp = nn.Sequential(nn.Linear(SIZE, 2 * SIZE), nn.ReLU(), nn.Linear(2 * SIZE, SIZE))

    def forward(self, rows: Tensor, bias: Tensor, edges: Tensor | None = None, context: Tensor | None = None) -> Tensor:
        """New rows (n, k, SIZE).

        Args:
            rows: shape (n, k, SIZE).
            bias: added to similarities, shape (n, HEADS, k, k), or with t more columns.
            edges: features of pairs, shape (n, k, k, edge).
            context: t more rows that are attended to, shape (n, t, SIZE).
        """
        own = self.norms[0](rows)
        key, value = self.keys(own if context is None else torch.cat([own, context], 1)).chunk(2, 2)
        query, key, value = (part.unflatten(2, (HEADS, -1)).transpose(1, 2) for part in (self.query(own), key, value))
        weights = (query @ key.transpose(2, 3) / math.sqrt(query.shape[3]) + bias).softmax(3)
        found = self.out((weights @ value).transpose(1, 2).flatten(2))
        if self.read is not None and edges is not None:
            found = found + self.read((weights[..., : rows.shape[1]].transpose(1, 2) @ edges).flatten(2))
        rows = rows + found
        return rows + self.mlp(self.norms[1](rows))


class Objects(nn.Module):
    """Maps graphs to rows (n, k, SIZE) for their nodes, with attention between them, and to a context."""

    def __init__(self, layers: int) -> None:
        super().__init__()
        self.first = nn.Sequential(nn.Linear(NODE, SIZE), nn.ReLU(), nn.Linear(SIZE, SIZE))
        self.pairs = nn.Sequential(nn.Linear(EDGE, 32), nn.ReLU(), nn.Linear(32, layers * HEADS))
        self.layers, self.norm = nn.ModuleList(Layer(EDGE) for _ in range(layers)), nn.LayerNorm(SIZE)

    def forward(self, seen: Graph, known: Tensor | None = None, context: Tensor | None = None) -> Tensor:
        """The rows of the nodes. `known` rows (n, k, SIZE) are added to the first ones.

        All attend also to the rows (n, t, SIZE) of the context, of which rows of zeros do not exist.
        """
        biases = self.pairs(seen.edges).movedim(3, 1) + torch.where(seen.present, 0.0, -1e4)[:, None, None]
        if context is not None:
            absent = torch.where((context != 0).any(2), 0.0, -1e4)[:, None, None]
            biases = torch.cat([biases, absent.expand(*biases.shape[:3], -1)], 3)
        rows = self.first(seen.nodes) if known is None else self.first(seen.nodes) + known
        for layer, bias in zip(self.layers, biases.chunk(len(self.layers), 1), strict=True):
            rows = layer(rows, bias, seen.edges, context)
        return self.norm(rows)


class Sentences(nn.Module):
    """Maps words to contexts."""

    def __init__(self) -> None:
        super().__init__()
        self.words, self.places = nn.Embedding(WORDS, SIZE, padding_idx=0), nn.Embedding(LENGTH, SIZE)
        self.layers = nn.ModuleList(Layer() for _ in range(2))

    def forward(self, words: Tensor) -> tuple[Tensor, Tensor]:
        """Contexts (n, l, SIZE) of sentences, given as numbers of words (n, LENGTH), and which rows are words."""
        words = words[:, : int((words > 0).sum(1).max())]
        known = words > 0
        rows, hidden = self.words(words) + self.places.weight[: words.shape[1]], torch.where(known, 0.0, -1e4)
        for layer in self.layers:
            rows = layer(rows, hidden[:, None, None])
        return rows, known
