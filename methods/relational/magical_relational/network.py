"""The network of `relational`: the blocks and regions in the robot's frame, and their relations to each other.

It observes one state, in the robot's frame, and does not depend on the order of blocks and regions. Each block and
region is a node of a graph. It receives messages from all others, as in the graph networks of Battaglia et al. 2018
(arXiv:1806.01261). A policy consists of several such networks with different initial weights. Their probabilities are
averaged.
"""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor, nn

from magical_mj.learners.networks import COLOURS, ONE_HOT, SHAPES, blocks_of, check_size, maxima, regions_of
from magical_mj.observations import FINGERS
from magical_relational.settings import RelationalSettings

ARENA: Final = 4 + 4
"""The number of a node's features in the arena's frame: the robot's pose, its own position, and their difference."""
NODE: Final = 5 + 2 + 4 + 4 + 6 + 1 + 2 + ARENA
_FINGERS: Final = slice(NODE - ARENA - 2, NODE - ARENA)
EDGE: Final = 6
MOTION: Final = (0.01, 0.03)
"""A robot rests if it moves less in a step: in units or rad, and a finger in rad."""
STANDING: Final = 0.25
"""The sharpness of probabilities while the robot rests, as a share of `RelationalSettings.sharpness`."""


class RelationalNetwork(nn.Module):
    """Maps states to logits of the 18 actions."""

    arena: Tensor

    def __init__(self, hidden: int) -> None:
        super().__init__()
        check_size(hidden * (NODE + 2 * EDGE + 11 * hidden + 2 * 2 * hidden + 2 * ONE_HOT))
        self.register_buffer("arena", torch.ones(()))  # 0: positions in the arena are hidden
        self.node = nn.Sequential(nn.Linear(NODE, hidden), nn.ReLU(), nn.Linear(hidden, hidden))
        self.rounds = nn.ModuleList(Messages(hidden) for _ in range(2))
        self.share = nn.Linear(hidden, 1)
        self.action = nn.Sequential(
            nn.Linear(2 * hidden + 2, 2 * hidden),
            nn.ReLU(),
            nn.Linear(2 * hidden, 2 * hidden),
            nn.ReLU(),
            nn.Linear(2 * hidden, ONE_HOT),
        )

    def forward(self, states: Tensor) -> Tensor:
        """Logits, shape (n, 18), of states (n, names)."""
        return self.act(*graph(states, self.arena))

    def act(self, nodes: Tensor, edges: Tensor, present: Tensor) -> Tensor:
        """The logits for the results of `graph`."""
        fingers = nodes[:, 0, _FINGERS]
        nodes = self.node(nodes)
        receives = present[:, None] & ~torch.eye(present.shape[1], dtype=torch.bool, device=present.device)
        for messages in self.rounds:
            nodes = messages(nodes, edges, receives)
        shares = self.share(nodes)[..., 0].masked_fill(~present, -1e4).softmax(1)
        largest = maxima(nodes, present)
        return self.action(torch.cat([(shares[..., None] * nodes).sum(1), largest, fingers], 1))


class Messages(nn.Module):
    """One round of messages. Each node receives the maxima of the others' messages."""

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.edge = nn.Linear(EDGE, hidden)
        self.speaker = nn.Linear(hidden, hidden, bias=False)
        self.listener = nn.Linear(hidden, hidden, bias=False)
        self.update = nn.Sequential(nn.Linear(2 * hidden, hidden), nn.ReLU(), nn.Linear(hidden, hidden))

    def forward(self, nodes: Tensor, edges: Tensor, receives: Tensor) -> Tensor:
        """New nodes (n, k, hidden), from nodes, edges (n, k, k, EDGE), and a mask of the messages (n, k, k)."""
        sent = self.edge(edges) + self.listener(nodes)[:, :, None] + self.speaker(nodes)[:, None]
        received = sent.relu().masked_fill(~receives[..., None], 0.0).amax(2)
        return nodes + self.update(torch.cat([nodes, received], 2))


class Ensemble(nn.Module):
    """Several networks whose probabilities are averaged, and sharpened: the actor of `relational`."""

    def __init__(self, settings: RelationalSettings) -> None:
        super().__init__()
        check_size(settings.networks * settings.hidden**2)
        self.settings = settings
        self.networks = nn.ModuleList(RelationalNetwork(settings.hidden) for _ in range(settings.networks))

    @property
    def members(self) -> list[RelationalNetwork]:
        """The networks."""
        return [network for network in self.networks if isinstance(network, RelationalNetwork)]

    def forward(self, histories: Tensor, tasks: Tensor) -> Tensor:
        """Logits, shape (n, 18), for histories (n, HISTORY, names) of one task. Only the last two states are used.

        If the robot rests, the logits are less sharp, so that a robot that is stuck tries other actions.
        """
        del tasks
        change = (histories[:, -1] - histories[:, -2]).abs()
        rests = (change[:, :3] < MOTION[0]).all(1) & (change[:, FINGERS] < MOTION[1]).all(1)
        return self.logits(histories[:, -1]) * torch.where(rests, STANDING, 1.0)[:, None]

    def logits(self, states: Tensor) -> Tensor:
        """The logits for states (n, names) of a moving robot."""
        probabilities = torch.stack([network(states).softmax(1) for network in self.networks]).mean(0)
        return self.settings.sharpness * probabilities.clamp(min=1e-9).log()


def graph(states: Tensor, arena: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The blocks and regions of states (n, names) in the robot's frame. Rows that are empty in all states are left out.

    Returns:
        Nodes (n, k, NODE); edges (n, k, k, EDGE), from the second node to the first; which nodes exist (n, k).
    """
    blocks, regions = blocks_of(states), regions_of(states)
    if not torch.compiler.is_exporting():  # the shapes in an exported network are fixed
        blocks, regions = blocks[:, blocks[..., 0].any(0)], regions[:, regions[..., 0].any(0)]
    b, r = blocks.shape[1], regions.shape[1]
    position, angle = states[:, None, :2], states[:, 2:3]
    sin, cos = angle.sin(), angle.cos()
    frame = torch.stack([cos, sin, -sin, cos], 2).unflatten(2, (2, 2))[:, 0]

    half = (regions[..., 3:5] - regions[..., 1:3]) / 2
    positions = torch.cat([blocks[..., 1:3], regions[..., 1:3] + half], 1)
    seen = (positions - position) @ frame.transpose(1, 2)
    distance = seen.norm(dim=2, keepdim=True)
    heading = blocks[..., 3] - angle

    def padded(values: Tensor, before: int, after: int) -> Tensor:
        return nn.functional.pad(values, (0, 0, before, after))

    # A square region is symmetric under quarter turns, and all regions under half turns.
    difference = half[..., 0] - half[..., 1]
    turned = torch.cat([(2 * angle).cos(), (2 * angle).sin(), (4 * angle).cos(), (4 * angle).sin()], 1)
    inside = half - (position - positions[:, b:]).abs()
    form = [
        half.mean(2),
        difference * turned[:, :1],
        difference * turned[:, 1:2],
        turned[:, 2:3].expand(-1, r),
        turned[:, 3:4].expand(-1, r),
        inside.amin(2).clamp(-0.5, 0.5),
    ]
    where = torch.cat([position, sin[..., None], cos[..., None]], 2).expand(-1, b + r, -1)
    nodes = torch.cat(
        [
            seen,
            seen / (distance + 1e-3),
            0.3 / (0.2 + distance),
            padded(torch.stack([heading.sin(), heading.cos()], 2), 0, r),
            padded(blocks[..., SHAPES], 0, r),
            torch.cat([blocks[..., COLOURS], regions[..., 5:]], 1),
            padded(torch.stack(form, 2), b, 0),
            padded(torch.ones_like(half[..., :1]), b, 0),
            states[:, None, FINGERS].expand(-1, b + r, -1),
            arena * torch.cat([where, positions, positions - position], 2),
        ],
        2,
    )
    apart = seen[:, :, None] - seen[:, None]
    colours = torch.cat([blocks[..., COLOURS], regions[..., 5:]], 1)
    shapes = padded(blocks[..., SHAPES], 0, r)
    # The depth of each node's centre in each region, in units; negative outside.
    depth = (half[:, None] - (positions[:, :, None] - positions[:, None, b:]).abs()).amin(3).clamp(-0.5, 0.5)
    depth = nn.functional.pad(depth, (b, 0))
    edges = torch.cat(
        [
            apart,
            apart.norm(dim=3, keepdim=True),
            (colours @ colours.transpose(1, 2))[..., None],
            (shapes @ shapes.transpose(1, 2))[..., None],
            (depth + depth.transpose(1, 2))[..., None],
        ],
        3,
    )
    return nodes, edges, torch.cat([blocks[..., 0], regions[..., 0]], 1) > 0
