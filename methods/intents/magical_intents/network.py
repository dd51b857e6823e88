"""Parts of the scorer: graphs of objects, attention between them, and sentences."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import torch
from torch import Tensor, nn

from magical_intents.symmetries import LENGTH, WORDS
from magical_mj.learners.networks import COLOURS, SHAPES, blocks_of, regions_of
from magical_mj.observations import FINGERS

SIZE: Final = 64
HEADS: Final = 4
NODE: Final = 2 + 2 + 2 + 4 + 4 + 2 + 1 + 3
EDGE: Final = 10


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
    parts = [at, before, at - before, shapes, colours, placed(half, count + 1)]
    nodes = torch.cat([*parts, placed(fingers[..., :1] - fingers[..., 1:], count), kind], 2)
    edges = []
    for positions in (before, at):
        apart = positions[:, :, None] - positions[:, None]
        depth = nn.functional.pad(
            (half[:, None] - apart[:, :, count + 1 :].abs()).amin(3).clamp(-0.5, 0.5), (count + 1, 0)
        )
        edges += [apart, apart.norm(dim=3, keepdim=True), (depth + depth.transpose(1, 2))[..., None]]
    edges += [(values @ values.transpose(1, 2))[..., None] for values in (colours, shapes)]
    there = torch.ones_like(now[:, :1])
    present = torch.cat([blocks[..., 0], there, regions[..., 0]], 1) > 0
    return Graph(nodes, torch.cat(edges, 3), present, count)


class Layer(nn.Module):
    """A transformer's layer: attention between rows, and a network for each row."""

    def __init__(self) -> None:
        super().__init__()
        self.norms = nn.ModuleList(nn.LayerNorm(SIZE) for _ in range(2))
        self.qkv, self.out = nn.Linear(SIZE, 3 * SIZE), nn.Linear(SIZE, SIZE)
        self.mlp = nn.Sequential(nn.Linear(SIZE, 2 * SIZE), nn.ReLU(), nn.Linear(2 * SIZE, SIZE))

    def forward(self, rows: Tensor, bias: Tensor) -> Tensor:
        """New rows (n, k, SIZE). `bias` (n, HEADS, k, k) is added to similarities."""
        query, key, value = self.qkv(self.norms[0](rows)).chunk(3, 2)
        rows = rows + self.out(_attended(query, key, value, bias))
        return rows + self.mlp(self.norms[1](rows))


def _attended(query: Tensor, key: Tensor, value: Tensor, bias: Tensor) -> Tensor:
    """Attention of several heads, shape of `query`."""
    query, key, value = (part.unflatten(2, (HEADS, -1)).transpose(1, 2) for part in (query, key, value))
    similarity = query @ key.transpose(2, 3) / math.sqrt(query.shape[3]) + bias
    return (similarity.softmax(3) @ value).transpose(1, 2).flatten(2)


class Objects(nn.Module):
    """Maps graphs to rows (n, k, SIZE) for their nodes, with attention between them."""

    def __init__(self, layers: int) -> None:
        super().__init__()
        self.first = nn.Sequential(nn.Linear(NODE, SIZE), nn.ReLU(), nn.Linear(SIZE, SIZE))
        self.pairs = nn.Sequential(nn.Linear(EDGE, 32), nn.ReLU(), nn.Linear(32, layers * HEADS))
        self.layers = nn.ModuleList(Layer() for _ in range(layers))

    def forward(self, seen: Graph) -> Tensor:
        """The rows of the nodes."""
        absent = torch.where(seen.present, 0.0, -1e4)[:, None, None]
        biases = self.pairs(seen.edges).movedim(3, 1).chunk(len(self.layers), 1)
        rows = self.first(seen.nodes)
        for layer, bias in zip(self.layers, biases, strict=True):
            rows = layer(rows, bias + absent)
        return rows


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
