"""The scores of all tasks, of whole batches: the formulas of `magical_mj.tasks`, on tensors.

Every function takes the worlds at the start (`start`) and the poses at the end (`now`), and gives a score in [0, 1] for
each world. Shapes: `now` (worlds, 1 + blocks, 3), the robot first; results (worlds,), float64.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

import torch
from torch import Tensor

from magical_mj.batched.scenes import ABSENT, SceneArrays
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.tasks.cluster import NEARER, ZERO_SCORE_SHARE
from magical_mj.tasks.make_line import INLIER_DISTANCE, MAX_GAP, RELEASED_LEAST
from magical_mj.tasks.move_to_corner import CORNER, FULL_SCORE_DISTANCE, ZERO_SCORE_DISTANCE
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import check_name


class Start(NamedTuple):
    """The initial scenes of a batch, as tensors; see `SceneArrays`."""

    poses: Tensor
    shapes: Tensor
    colours: Tensor
    regions: Tensor
    region_colours: Tensor

    @classmethod
    def of(cls, scenes: SceneArrays, device: torch.device | str = "cpu") -> Start:
        """The tensors of these scenes."""
        return cls(*(torch.from_numpy(getattr(scenes, name)).to(device) for name in cls._fields))

    @property
    def present(self) -> Tensor:
        """Which slots hold a block. Shape (worlds, blocks)."""
        return self.shapes != ABSENT

    def inside(self, poses: Tensor) -> Tensor:
        """Which blocks, at these poses, have their centre in which region. Shape (worlds, regions, blocks)."""
        x, y = poses[:, None, 1:, 0], poses[:, None, 1:, 1]
        x_min, y_min, x_max, y_max = (self.regions[..., side, None] for side in range(4))
        found = (x_min <= x) & (x <= x_max) & (y_min <= y) & (y <= y_max)
        return found & self.present[:, None] & (self.region_colours != ABSENT)[..., None]


def move_to_corner(start: Start, now: Tensor, rules: Rules) -> Tensor:
    """How close the block is to the corner."""
    del start, rules
    distance = torch.hypot(now[:, 1, 0] - CORNER[0], now[:, 1, 1] - CORNER[1])
    return ((ZERO_SCORE_DISTANCE - distance) / (ZERO_SCORE_DISTANCE - FULL_SCORE_DISTANCE)).clamp(0.0, 1.0)


def move_to_region(start: Start, now: Tensor, rules: Rules) -> Tensor:
    """Whether the robot is in the region."""
    del rules
    x_min, y_min, x_max, y_max = start.regions[:, 0].unbind(-1)
    x, y = now[:, 0, 0], now[:, 0, 1]
    return ((x_min <= x) & (x <= x_max) & (y_min <= y) & (y <= y_max)).double()


def match_regions(start: Start, now: Tensor, rules: Rules) -> Tensor:
    """The share of targets in the region, times the share of targets among what is in it."""
    del rules
    found = start.inside(now)[:, 0]
    targets = (start.colours == start.region_colours[:, :1]) & start.present
    right = (found & targets).sum(-1).double()
    return right / targets.sum(-1) * (right / found.sum(-1).clamp(min=1))


def find_dupe(start: Start, now: Tensor, rules: Rules) -> Tensor:
    """The share of the query's kind in the region, if the query and a duplicate are in it."""
    query = start.inside(start.poses)[:, 0].int().argmax(-1, keepdim=True)
    found = start.inside(now)[:, 0]
    alike = (start.shapes == start.shapes.gather(1, query)) & (start.colours == start.colours.gather(1, query))
    right = (found & alike).sum(-1)
    satisfied = right >= 2
    if rules == "paper":
        satisfied &= found.gather(1, query)[:, 0]
    return satisfied * right.double() / found.sum(-1).clamp(min=1)


def fix_colour(start: Start, now: Tensor, rules: Rules) -> Tensor:
    """Whether the mismatched block has left its region, and every other region holds just its own block."""
    del rules
    homes, found = start.inside(start.poses), start.inside(now)
    own = homes.int().argmax(-1)
    real = start.region_colours != ABSENT
    odd = real & (start.colours.gather(1, own) != start.region_colours)
    left = ~found.gather(-1, own[..., None])[..., 0]
    same = (found == homes).all(-1)
    return torch.where(odd, left, same | ~real).all(-1).double()


def make_line(start: Start, now: Tensor, rules: Rules) -> Tensor:
    """1 if all blocks are in one line, 0.5 if all but one are."""
    present, total = start.present, start.present.sum(-1)
    places = now[:, 1:, :2]
    count = places.shape[1]
    longest = torch.ones_like(total)
    for one in range(count):
        for other in range(one + 1, count):
            way = places[:, other] - places[:, one]
            length = torch.hypot(way[:, 0], way[:, 1])
            ux, uy = (way / length[:, None].clamp(min=1e-300)).unbind(-1)
            x, y = (places - places[:, one, None]).unbind(-1)
            near = (ux[:, None] * y - uy[:, None] * x).abs() <= INLIER_DISTANCE
            along = torch.where(near & present, ux[:, None] * x + uy[:, None] * y, math.inf).sort(-1).values
            gaps = along[:, 1:] - along[:, :-1]  # infinite or not a number behind the last block in line
            run = torch.ones_like(total)
            best = run
            for step in range(count - 1):
                run = torch.where(gaps[:, step] <= MAX_GAP, run + 1, 1)
                best = torch.maximum(best, run)
            defined = present[:, one] & present[:, other] & (length > 0)
            longest = torch.where(defined, torch.maximum(longest, best), longest)
    nearly = longest == total - 1
    if rules == "released":
        nearly &= longest >= RELEASED_LEAST
    return torch.where(longest == total, 1.0, 0.5 * nearly.double())


def _cluster(start: Start, now: Tensor, kinds: Tensor, number: int, rules: Rules) -> Tensor:
    """The share of blocks that lie with their own kind, beyond the share that counts for nothing."""
    members = torch.nn.functional.one_hot(kinds.long().clamp(min=0), number) * start.present[..., None]
    sizes = members.sum(1)
    places = now[:, 1:, :2]
    centres = torch.einsum("wbk,wbc->wkc", members.double(), places) / sizes[..., None].clamp(min=1)
    squares = ((places[:, :, None] - centres[:, None]) ** 2).sum(-1)
    squares = torch.where((sizes > 0)[:, None], squares, math.inf)
    own = squares.gather(-1, kinds.long().clamp(min=0)[..., None])[..., 0]
    nearest = torch.where(members.bool(), math.inf, squares).min(-1).values
    right = own.sqrt() < nearest.sqrt() - 2 * own if rules == "released" else own < nearest / NEARER
    nothing = ZERO_SCORE_SHARE[rules]
    share = (right & start.present).sum(-1).double() / start.present.sum(-1)
    return ((share - nothing) / (1 - nothing)).clamp(min=0.0)


def cluster_colour(start: Start, now: Tensor, rules: Rules) -> Tensor:
    """How well the blocks are clustered by colour."""
    return _cluster(start, now, start.colours, len(COLOURS), rules)


def cluster_shape(start: Start, now: Tensor, rules: Rules) -> Tensor:
    """How well the blocks are clustered by shape."""
    return _cluster(start, now, start.shapes, len(SHAPES), rules)


SCORES: Final[Mapping[str, Callable[[Start, Tensor, Rules], Tensor]]] = MappingProxyType(
    {
        "MoveToCorner": move_to_corner,
        "MoveToRegion": move_to_region,
        "MatchRegions": match_regions,
        "MakeLine": make_line,
        "FindDupe": find_dupe,
        "FixColour": fix_colour,
        "ClusterColour": cluster_colour,
        "ClusterShape": cluster_shape,
    }
)
"""The tasks whose scores are computed on tensors, by name; other tasks have no batched worlds."""


def score(task: str, start: Start, now: Tensor, rules: Rules = "paper") -> Tensor:
    """The score of each world if the episode ended now. Shape (worlds,), float64.

    Args:
        task: one of the eight tasks; others have no batched score.
        start: the initial scenes.
        now: x, y, angle of the robot and each block. Shape (worlds, 1 + blocks, 3), float64.
        rules: "paper" or "released".

    Raises:
        UnknownNameError: if the task has no batched score.
    """
    check_name("batched task", task, SCORES)
    return SCORES[task](start, now, rules)
