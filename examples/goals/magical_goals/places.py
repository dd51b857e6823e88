"""Relations to landmarks of the workspace: its corners and its middle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from magical_goals.relation import LIMIT_BITS, Floats, Layouts, Relation, Situation, choice_bits
from magical_mj.tasks.planning import TOLERANCE, Subgoal, bring, drive, places_anywhere, scene_after
from magical_mj.utils.errors import check_name

LANDMARKS: Final[Mapping[str, tuple[float, float]]] = MappingProxyType(
    {
        "top left corner": (-1.0, 1.0),
        "top right corner": (1.0, 1.0),
        "bottom left corner": (-1.0, -1.0),
        "bottom right corner": (1.0, -1.0),
        "middle": (0.0, 0.0),
    }
)

WHO: Final = ("every block", "the robot")


@dataclass(frozen=True)
class Near(Relation):
    """All blocks, or the robot, are near a landmark. The deviation is the distance.

    Attributes:
        who: one of `WHO`.
        landmark: one of `LANDMARKS`.
    """

    who: str
    landmark: str

    def __post_init__(self) -> None:
        """Raises an `UnknownNameError` for what does not exist."""
        check_name("subject", self.who, WHO)
        check_name("landmark", self.landmark, LANDMARKS)

    @property
    def bits(self) -> float:
        """Of the subject, the landmark and the limit."""
        return choice_bits(len(WHO)) + choice_bits(len(LANDMARKS)) + LIMIT_BITS

    def deviations(self, layouts: Layouts) -> Floats:
        """Distances from the landmark."""
        who = layouts.robot[:, None] if self.who == "the robot" else layouts.blocks
        return np.linalg.norm(who - LANDMARKS[self.landmark], axis=2, keepdims=True)

    def subgoals(self, at: Situation) -> list[Subgoal]:
        """Moves what is too far away to the nearest place that is near enough, with a margin."""
        landmark = LANDMARKS[self.landmark]
        places = sorted(places_anywhere(), key=lambda place: math.dist(place, landmark))
        places = [place for place in places if math.dist(place, landmark) <= at.limits[0] - TOLERANCE] or places[:1]
        if self.who == "the robot":
            return [drive(at.now, places, at.noise, TOLERANCE)]
        todo: list[Subgoal] = []
        for number, block in enumerate(at.now.blocks):
            if math.dist((block.x, block.y), landmark) > at.limits[0]:
                todo.append(bring(scene_after(at.now, todo), number, places, at.noise))
        return todo

    @property
    def text(self) -> str:
        """Such as "the robot is within 0.50 of the middle"."""
        return f"{self.who} is within {{0:.2f}} of the {self.landmark}"
