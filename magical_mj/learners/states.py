"""What learners of the state track see: the last four states, as the robot sees them, whatever the order of the blocks.

Networks take histories of shape (n, HISTORY, len(STATE_NAMES)), oldest first, as they come from the environment.
Everything else is computed from these: coordinates in the robot's frame, movements, and one row for each block and
each goal region. Velocities are not used, so poses and finger angles from any source will do.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical_mj.learners.settings import HEADS, Network
from magical_mj.scene.actions import ACTIONS
from magical_mj.scene.state_vector import FINGERS, MAX_BLOCKS, MAX_REGIONS, STATE_NAMES
from magical_mj.utils.errors import check_name

HISTORY: Final = 4
"""States in an observation, as many as there are frames in the paper's pictures."""

_ROBOT: Final = sum(name.startswith("robot.") for name in STATE_NAMES)
_BLOCKS: Final = sum(name.startswith("block") for name in STATE_NAMES)
_MOVEMENT: Final = 0.1
"""Units or radians that count as 1 in movements between two states; positions and angles count as they are.

These scales are fixed. Scaled by their deviation in the demonstrations, positions that hardly vary there would
dominate as soon as they vary a little, as in the Jitter variant.
"""

Part = Literal["translation", "rotation", "noise"]
AUGMENTATIONS: Final[Mapping[str, tuple[Part, ...]]] = MappingProxyType(
    {"all": ("translation", "rotation", "noise"), "no-trans-rot": ("noise",), "none": ()}
)
"""The counterparts of the picture augmentations of the same names. Names of colours cannot be shifted a little."""
TRANSLATION: Final = 0.02  # units: the bound of the uniform draws along each axis
ROTATION: Final = 2.0  # degrees, likewise
NOISE: Final = 0.01  # standard deviation, in units and radians, of the poses and finger angles of the present state
PAST_NOISE: Final = 0.2  # likewise of the earlier states
"""So much, that a policy cannot just repeat the action that it reads off the latest movements (de Haan et al., 2019:
"Causal Confusion in Imitation Learning"), as it could in demonstrations, where four of five actions are repeated."""


def histories(states: NDArray[np.float32]) -> NDArray[np.float32]:
    """The latest states at each step, (steps, HISTORY, names), of states (steps, names); the first one is repeated."""
    steps = np.arange(len(states))[:, None] + np.arange(1 - HISTORY, 1)
    return states[np.maximum(steps, 0)]


class History:
    """Keeps the latest HISTORY states of one or several episodes."""

    def __init__(self, states: NDArray[np.float32]) -> None:
        """Episodes begin with `states`, which are repeated."""
        self.states = np.repeat(states[..., None, :], HISTORY, axis=-2)
        """Shape (..., HISTORY, names), oldest first; a new array after each change."""

    def add(self, states: NDArray[np.float32]) -> NDArray[np.float32]:
        """Takes in what came next, shape (..., names); returns `states`."""
        self.states = np.concatenate([self.states[..., 1:, :], states[..., None, :]], axis=-2)
        return self.states

    def restart(self, which: NDArray[np.bool_], states: NDArray[np.float32]) -> None:
        """Other episodes begin in some rows, `which` (n,), with their rows of `states` (n, names)."""
        self.states = np.where(which[:, None, None], states[:, None], self.states)


class StateTorso(nn.Module):
    """From histories to features: attention between blocks and regions, then the maxima over them.

    The order in which blocks and regions are listed changes nothing, and there may be any number of them.

    Args:
        network: the layers' sizes.
        actions: join one-hot actions to what the last two layers get; the discriminator and AL's encoder do.
        features: units of the last layer, instead of `network.hidden`.
    """

    def __init__(self, network: Network, *, actions: bool = False, features: int | None = None) -> None:
        super().__init__()
        size = network.entity
        self.entity = nn.Sequential(
            nn.Linear(_ROBOT_FEATURES + _ENTITY_FEATURES, size), nn.ReLU(), nn.Linear(size, size)
        )
        self.attention = nn.ModuleList(Attention(size) for _ in range(network.attention))
        self.features = features or network.hidden
        inputs = _ROBOT_FEATURES + size + (len(ACTIONS) if actions else 0)
        self.linear = nn.Sequential(
            nn.Linear(inputs, network.hidden), nn.ReLU(), nn.Linear(network.hidden, self.features), nn.ReLU()
        )

    def forward(self, observations: Tensor, actions: Tensor | None = None) -> Tensor:
        """Features, shape (n, features), of histories (n, HISTORY, names) and actions (n,), if it has any."""
        robot, entities, present = features_of(observations)
        rows = self.entity(torch.cat([entities, robot[:, None].expand(-1, entities.shape[1], -1)], 2))
        for layer in self.attention:
            rows = layer(rows, present)
        parts = [robot, rows.masked_fill(~present[..., None], -10.0).amax(1)]
        if actions is not None:
            parts.append(nn.functional.one_hot(actions, len(ACTIONS)).to(robot.dtype))
        return self.linear(torch.cat(parts, dim=1))


class Attention(nn.Module):
    """One layer of a transformer's encoder (Vaswani et al., 2017), without normalisation: two suffice without it."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.asked = nn.Linear(size, 3 * size)
        self.answered = nn.Linear(size, size)
        self.alone = nn.Sequential(nn.ReLU(), nn.Linear(size, size), nn.ReLU(), nn.Linear(size, size))

    def forward(self, rows: Tensor, present: Tensor) -> Tensor:
        """New rows, (n, rows, size), that know of the other rows that are `present`, (n, rows)."""
        query, key, value = self.asked(rows).unflatten(2, (3, HEADS, -1)).permute(2, 0, 3, 1, 4)
        # PyTorch's own attention has no second derivative, which WGAIL-GP's penalty needs.
        similarity = query @ key.transpose(2, 3) / math.sqrt(query.shape[3])
        found = similarity.masked_fill(~present[:, None, None], -1e4).softmax(3) @ value
        rows = rows + self.answered(found.transpose(1, 2).flatten(2))
        return rows + self.alone(rows)


def features_of(histories: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Histories as the robot sees them.

    Returns:
        The robot's features (n, features); those of each block and region (n, rows, features); which of these rows
        stand for something (n, rows). Rows that stand for nothing in the whole batch are left out.
    """
    now = histories[:, -1]
    angle = now[:, 2]
    sin, cos = angle.sin(), angle.cos()
    frame = torch.stack([cos, sin, -sin, cos], 1).unflatten(1, (2, 2))

    def rotated(vectors: Tensor) -> Tensor:
        """Vectors of the world, (n, ..., 2), in the robot's frame."""
        return torch.einsum("nij,n...j->n...i", frame, vectors)

    def movements(poses: Tensor) -> Tensor:
        """From each earlier pose of (n, HISTORY, ..., 3) to the present one, (n, ..., 3 * (HISTORY - 1))."""
        moved = (poses[:, -1:] - poses[:, :-1]) / _MOVEMENT
        return torch.cat([rotated(moved[..., :2]), moved[..., 2:]], -1).movedim(1, -2).flatten(-2)

    fingers = (now[:, None] - histories[:, :-1])[..., FINGERS].flatten(1) / _MOVEMENT
    robot = [now[:, :2], sin[:, None], cos[:, None], now[:, FINGERS], movements(histories[..., :3]), fingers]

    blocks = histories[..., _ROBOT : _ROBOT + _BLOCKS].unflatten(2, (MAX_BLOCKS, -1))
    blocks = blocks[:, :, blocks[:, -1, :, 0].any(0)]  # present, x, y, angle, three velocities, shapes, colours
    latest = blocks[:, -1]
    heading = latest[..., 3:4] - angle[:, None, None]
    place = latest[..., 1:3]
    seen = [rotated(place - now[:, None, :2]), heading.sin(), heading.cos(), place, latest[..., 7:]]
    of_blocks = torch.cat([*seen, movements(blocks[..., 1:4]), torch.zeros_like(latest[..., :3])], -1)

    regions = now[:, _ROBOT + _BLOCKS :].unflatten(1, (MAX_REGIONS, -1))
    regions = regions[:, regions[..., 0].any(0)]  # present, x_min, y_min, x_max, y_max, colours
    place, half = (regions[..., 1:3] + regions[..., 3:5]) / 2, (regions[..., 3:5] - regions[..., 1:3]) / 2
    heading = -angle[:, None, None].expand_as(place[..., :1])
    seen = [rotated(place - now[:, None, :2]), heading.sin(), heading.cos(), place]
    shapes, still = place.new_zeros(*place.shape[:2], 4), place.new_zeros(*place.shape[:2], 3 * (HISTORY - 1))
    of_regions = torch.cat([*seen, shapes, regions[..., 5:], still, half, torch.ones_like(half[..., :1])], -1)

    present = torch.cat([latest[..., 0], regions[..., 0]], 1) > 0
    return torch.cat(robot, 1), torch.cat([of_blocks, of_regions], 1), present


class StateAugmentation:
    """Changes histories at random.

    The counterparts of a moved and turned picture are a robot that stands and looks a little elsewhere than it does,
    similarity in the four states of a history; noise of pixels corresponds to noise of poses, drawn for each state, and
    larger in the earlier ones.

    Attributes:
        parts: what it does.
    """

    def __init__(self, preset: str = "all") -> None:
        """Takes the name of one of the `AUGMENTATIONS`; any other raises UnknownNameError."""
        check_name("augmentation", preset, AUGMENTATIONS)
        self.parts: tuple[Part, ...] = AUGMENTATIONS[preset]

    @torch.no_grad()
    def __call__(self, histories: Tensor, generator: torch.Generator) -> Tensor:
        """Augments histories (n, HISTORY, names); they stay as they are, and are returned if there is nothing to do."""
        if not self.parts:
            return histories
        count = len(histories)
        shifts = torch.rand((count, 1, 3), generator=generator, device=generator.device).mul_(2).sub_(1).to(histories)
        shifts *= shifts.new_tensor([TRANSLATION, TRANSLATION, math.radians(ROTATION)])
        shifts *= shifts.new_tensor(["translation" in self.parts] * 2 + ["rotation" in self.parts])
        noise = torch.randn(histories.shape, generator=generator, device=generator.device).to(histories)
        sizes = noise.new_full((HISTORY, 1), PAST_NOISE)
        sizes[-1] = NOISE
        changed = histories + sizes * noise * _noisy(histories)
        changed[..., :3] += shifts
        return changed


def _noisy(histories: Tensor) -> Tensor:
    """1 for the entries that get noise: poses of what is present, and fingers."""
    mask = torch.zeros_like(histories)
    mask[..., :3] = mask[..., FINGERS] = 1
    blocks = mask[..., _ROBOT : _ROBOT + _BLOCKS].unflatten(-1, (MAX_BLOCKS, -1))
    blocks[..., 1:4] = histories[..., _ROBOT : _ROBOT + _BLOCKS].unflatten(-1, (MAX_BLOCKS, -1))[..., :1]
    return mask


_ROBOT_FEATURES: Final = 6 + 5 * (HISTORY - 1)
_ENTITY_FEATURES: Final = 6 + 8 + 3 * (HISTORY - 1) + 3
