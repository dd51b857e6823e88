"""Networks of a policy that receives an instruction: a planner chooses an object and its target, and a skill acts.

The planner observes the scene at the start of the episode and now, and attends to a context: the words of a sentence,
or the objects of demonstrations, each at the start and at the end. It predicts the next object, a block or
the robot, and its target position. The skill observes the scene in the robot's frame, the object and its target. Both
are trained on the same demonstrations, with labels in hindsight (`subgoals`).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import torch
from torch import Tensor, nn

from magical_intents.subgoals import DONE, ROBOT, UNDONE
from magical_intents.symmetries import LENGTH, WORDS
from magical_mj.learners.networks import COLOURS, ONE_HOT, SHAPES, blocks_of, maxima, regions_of
from magical_mj.observations import FINGERS

SIZE: Final = 96
HEADS: Final = 4
LAYERS: Final = 3
HIDDEN: Final = 256
NODE: Final = 2 + 2 + 2 + 4 + 4 + 2 + 1 + 3
EDGE: Final = 10
PLACES: Final = 4
"""The number of target positions that the planner proposes for an object."""
SPREAD: Final = (0.03, 0.5)
"""The smallest and the largest standard deviation (units) around a proposed position."""


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
    """A transformer's layer: attention between rows, attention to a context, and a network for each row."""

    def __init__(self, *, context: bool) -> None:
        super().__init__()
        self.norms = nn.ModuleList(nn.LayerNorm(SIZE) for _ in range(2 + context))
        self.qkv, self.out = nn.Linear(SIZE, 3 * SIZE), nn.Linear(SIZE, SIZE)
        if context:
            self.asked, self.known, self.told = nn.Linear(SIZE, SIZE), nn.Linear(SIZE, 2 * SIZE), nn.Linear(SIZE, SIZE)
        self.mlp = nn.Sequential(nn.Linear(SIZE, 2 * SIZE), nn.ReLU(), nn.Linear(2 * SIZE, SIZE))

    def forward(self, rows: Tensor, bias: Tensor, context: Tensor | None = None, known: Tensor | None = None) -> Tensor:
        """New rows (n, k, SIZE). `bias` (n, HEADS, k, k) is added to similarities.

        A context has the shape (g, l, SIZE), and `known` (g, l) marks its rows that are not padding. n is a multiple
        of g: each context belongs to n / g successive graphs.
        """
        query, key, value = self.qkv(self.norms[0](rows)).chunk(3, 2)
        rows = rows + self.out(_attended(query, key, value, bias))
        if context is not None and known is not None:
            groups = len(context)
            asked = self.asked(self.norms[2](rows)).reshape(groups, -1, SIZE)
            hidden = torch.where(known, 0.0, -1e4)[:, None, None]
            key, value = self.known(context).chunk(2, 2)
            rows = rows + self.told(_attended(asked, key, value, hidden)).view_as(rows)
        return rows + self.mlp(self.norms[1](rows))


def _attended(query: Tensor, key: Tensor, value: Tensor, bias: Tensor) -> Tensor:
    """Attention of several heads, shape of `query`."""
    query, key, value = (part.unflatten(2, (HEADS, -1)).transpose(1, 2) for part in (query, key, value))
    similarity = query @ key.transpose(2, 3) / math.sqrt(query.shape[3]) + bias
    return (similarity.softmax(3) @ value).transpose(1, 2).flatten(2)


class Objects(nn.Module):
    """Maps graphs to rows (n, k, SIZE) for their nodes, with attention between them and to a context."""

    def __init__(self, layers: int, *, context: bool) -> None:
        super().__init__()
        self.first = nn.Sequential(nn.Linear(NODE, SIZE), nn.ReLU(), nn.Linear(SIZE, SIZE))
        self.pairs = nn.Sequential(nn.Linear(EDGE, 32), nn.ReLU(), nn.Linear(32, layers * HEADS))
        self.layers = nn.ModuleList(Layer(context=context) for _ in range(layers))

    def forward(self, seen: Graph, context: Tensor | None = None, known: Tensor | None = None) -> Tensor:
        """The rows of the nodes."""
        absent = torch.where(seen.present, 0.0, -1e4)[:, None, None]
        biases = self.pairs(seen.edges).movedim(3, 1).chunk(len(self.layers), 1)
        rows = self.first(seen.nodes)
        for layer, bias in zip(self.layers, biases, strict=True):
            rows = layer(rows, bias + absent, context, known)
        return rows


class Sentences(nn.Module):
    """Maps words to contexts."""

    def __init__(self) -> None:
        super().__init__()
        self.words, self.places = nn.Embedding(WORDS, SIZE, padding_idx=0), nn.Embedding(LENGTH, SIZE)
        self.layers = nn.ModuleList(Layer(context=False) for _ in range(2))

    def forward(self, words: Tensor) -> tuple[Tensor, Tensor]:
        """Contexts (n, l, SIZE) of sentences, given as numbers of words (n, LENGTH), and which rows are words."""
        words = words[:, : int((words > 0).sum(1).max())]
        known = words > 0
        rows, hidden = self.words(words) + self.places.weight[: words.shape[1]], torch.where(known, 0.0, -1e4)
        for layer in self.layers:
            rows = layer(rows, hidden[:, None, None])
        return rows, known


class Demonstrations(nn.Module):
    """Maps the first and the last states of demonstrations to contexts."""

    def __init__(self) -> None:
        super().__init__()
        self.objects = Objects(2, context=False)

    def forward(self, ends: Tensor) -> tuple[Tensor, Tensor]:
        """Contexts (n, m k, SIZE) of states (n, m, 2, names), and which rows exist. Missing demonstrations are 0."""
        flat = ends.flatten(0, 1)
        seen = graph(flat[:, 0], flat[:, 1])
        shown = blocks_of(flat[:, 1])[..., 0].any(1)
        rows = self.objects(seen).unflatten(0, ends.shape[:2]).flatten(1, 2)
        return rows, (seen.present & shown[:, None]).unflatten(0, ends.shape[:2]).flatten(1, 2)


class Plan(NamedTuple):
    """The distribution of the next object, and of its target position, a mixture of normal distributions.

    Attributes:
        objects: logits of objects, shape (n, DONE + 1).
        places: the mixture's means for each object, shape (n, DONE, PLACES, 2).
        weights: the logits of its components, shape (n, DONE, PLACES).
        spreads: the logarithms of their standard deviations, shape (n, DONE, PLACES).
    """

    objects: Tensor
    places: Tensor
    weights: Tensor
    spreads: Tensor

    def likelihood(self, objects: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
        """Log-likelihoods (n,) of objects (n,), and of their targets (n, 2). `UNDONE` stands for all except `DONE`.

        The latter is 0 for `DONE` and `UNDONE`.
        """
        rows, chosen = torch.arange(len(objects)), objects.clamp(0, ROBOT)
        means, spread = self.places[rows, chosen], self.spreads[rows, chosen]
        squares = ((means - places[:, None]) ** 2).sum(2) / (2 * (2 * spread).exp())
        mixed = (self.weights[rows, chosen].log_softmax(1) - squares - 2 * spread).logsumexp(1)
        shares = self.objects.log_softmax(1)
        undone = shares[:, :DONE].logsumexp(1)
        named = (objects >= 0) & (objects < DONE)
        return torch.where(objects == UNDONE, undone, shares[rows, objects.clamp(0)]), mixed * named

    def best(self) -> tuple[Tensor, Tensor]:
        """The most probable objects (n,), and the most probable target of each, shape (n, 2)."""
        objects = self.objects.argmax(1)
        rows, chosen = torch.arange(len(objects)), objects.clamp(max=ROBOT)
        score = self.weights[rows, chosen] - 2 * self.spreads[rows, chosen]
        return objects, self.places[rows, chosen, score.argmax(1)]


class Planner(nn.Module):
    """Chooses the next object and its target position.

    Attributes:
        reads: whether it receives sentences.
        context: the part that maps a sentence or demonstrations to contexts.
    """

    def __init__(self, *, reads: bool) -> None:
        super().__init__()
        self.reads = reads
        self.context: Sentences | Demonstrations = Sentences() if reads else Demonstrations()
        self.objects = Objects(LAYERS, context=True)
        self.norm = nn.LayerNorm(SIZE)
        self.next, self.done = nn.Linear(SIZE, 1), nn.Linear(SIZE, 1)
        self.place = nn.Sequential(nn.Linear(SIZE + NODE, SIZE), nn.ReLU(), nn.Linear(SIZE, PLACES * 4))

    def forward(self, initial: Tensor, now: Tensor, context: tuple[Tensor, Tensor]) -> Plan:
        """The plans for states (n, names) at the start and now. Each context belongs to several successive states."""
        seen = graph(initial, now)
        rows = self.norm(self.objects(seen, *context))
        last = seen.blocks + 1  # blocks and the robot
        numbers = [*range(seen.blocks), ROBOT]
        objects = rows.new_full((len(rows), DONE + 1), -1e4)
        objects[:, numbers] = self.next(rows[:, :last])[..., 0].masked_fill(~seen.present[:, :last], -1e4)
        objects[:, DONE] = self.done(maxima(rows, seen.present))[:, 0]
        proposed = self.place(torch.cat([rows, seen.nodes], 2)[:, :last]).unflatten(2, (PLACES, 4))
        every = rows.new_zeros(len(rows), DONE, PLACES, 4)
        every[:, numbers] = proposed
        spreads = every[..., 3].sigmoid() * math.log(SPREAD[1] / SPREAD[0]) + math.log(SPREAD[0])
        return Plan(objects, every[..., :2], every[..., 2], spreads)


class Skill(nn.Module):
    """Acts to bring an object to a target position."""

    def __init__(self) -> None:
        super().__init__()
        self.other = nn.Sequential(nn.Linear(5 + 2 + 2 + 4, 64), nn.ReLU(), nn.Linear(64, 64))
        self.act = nn.Sequential(
            nn.Linear(64 + 2 + 4 + 1 + 5 + 2 + 4 + 5 + 3, HIDDEN),
            nn.ReLU(),
            nn.Linear(HIDDEN, HIDDEN),
            nn.ReLU(),
            nn.Linear(HIDDEN, HIDDEN),
            nn.ReLU(),
            nn.Linear(HIDDEN, ONE_HOT),
        )

    def forward(self, now: Tensor, objects: Tensor, places: Tensor) -> Tensor:
        """Logits (n, 18) for states (n, names), objects (n,), blocks or the robot, and their targets (n, 2)."""
        position, angle = now[:, None, :2], now[:, 2:3]
        sin, cos = angle.sin(), angle.cos()
        frame = torch.stack([cos, sin, -sin, cos], 2).unflatten(2, (2, 2))[:, 0].transpose(1, 2)
        blocks = blocks_of(now)
        blocks = blocks[:, : int(blocks[..., 0].sum(1).max())] if len(now) else blocks
        drives = (objects >= ROBOT)[:, None].float()
        own = nn.functional.one_hot(objects, DONE + 1)[:, : blocks.shape[1], None].to(now.dtype)
        seen = (blocks[..., 1:3] - position) @ frame
        goal = ((places[:, None] - position) @ frame)[:, 0]
        block = (own * torch.cat([blocks, seen], 2)).sum(1)
        hand, heading = block[:, -2:], (block[:, 3:4] - angle) * (1 - drives)
        left = (goal - hand) * (1 - drives)
        others = [_near(seen), seen - hand[:, None], seen - goal[:, None], blocks[..., SHAPES]]
        around = maxima(self.other(torch.cat(others, 2)), (blocks[..., 0] > 0) & (own[..., 0] < 0.5))
        parts = [around, now[:, FINGERS], now[:, :2], sin, cos, drives, _near(hand), heading.sin(), heading.cos()]
        parts += [block[:, SHAPES], _near(goal), left, left.norm(dim=1, keepdim=True)]
        return self.act(torch.cat(parts, 1))


def _near(seen: Tensor) -> Tensor:
    """Features (..., 5) of positions (..., 2) in the robot's frame: the position, its direction, and the nearness."""
    distance = seen.norm(dim=-1, keepdim=True)
    return torch.cat([seen, seen / (distance + 1e-3), 0.3 / (0.2 + distance)], -1)
