"""What learners of the state track see: the last four states, as the robot sees them, whatever the order of the blocks.

Networks take histories of shape (n, HISTORY, len(STATE_NAMES)), oldest first, as they come from the environment.
Everything else is computed from these: coordinates in the robot's frame, movements, and one row for each block and
each goal region. Velocities are not used, so poses and finger angles from any source will do.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import torch
from torch import Tensor

from magical_mj.policies.history import HISTORY
from magical_mj.scene.state_vector import FINGERS, MAX_BLOCKS, MAX_REGIONS, STATE_NAMES

_ROBOT: Final = sum(name.startswith("robot.") for name in STATE_NAMES)
_BLOCKS: Final = slice(_ROBOT, _ROBOT + sum(name.startswith("block") for name in STATE_NAMES))
_REGIONS: Final = slice(_BLOCKS.stop, len(STATE_NAMES))
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


def features_of(histories: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Histories (n, HISTORY, names) as the robot sees them.

    Returns:
        The robot's features (n, ROBOT_FEATURES); those of each block and region (n, rows, ENTITY_FEATURES); which of
        these rows stand for something (n, rows). Rows that stand for nothing in the whole batch are left out, but in a
        network that is exported.
    """
    robot = _Robot(histories)
    blocks = histories[..., _BLOCKS].unflatten(2, (MAX_BLOCKS, -1))
    regions = histories[:, -1, _REGIONS].unflatten(1, (MAX_REGIONS, -1))
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
    blocks = mask[..., _BLOCKS].unflatten(-1, (MAX_BLOCKS, -1))
    blocks[..., 1:4] = histories[..., _BLOCKS].unflatten(-1, (MAX_BLOCKS, -1))[..., :1]
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
    """Features (n, rows, ENTITY_FEATURES) of blocks (n, HISTORY, rows, columns).

    The columns are: present, x, y, angle, three velocities, four shapes, four colours.
    """
    now = blocks[:, -1]
    view = robot.view(now[..., 1:3], now[..., 3:4])
    return _rows(
        {**view, "shape": now[..., 7:11], "colour": now[..., 11:], "movements": robot.movements(blocks[..., 1:4])}
    )


def _of_regions(regions: Tensor, robot: _Robot) -> Tensor:
    """Features (n, rows, ENTITY_FEATURES) of regions (n, rows, columns).

    The columns are: present, x_min, y_min, x_max, y_max, four colours.
    """
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
