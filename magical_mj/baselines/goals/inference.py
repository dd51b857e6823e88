"""From demonstrations to the goal that they have in common.

Of all relations of the vocabulary, the goal is the one with which the demonstrations are told in the fewest bits: those
of the relation, and for each demonstration those that say in which of the scenes that fulfil the relation it ended. The
fewer scenes fulfil it, the fewer bits: the likeliest of the relations that all demonstrations fulfil is the strictest,
for if nobody had wanted it, it would be a strange coincidence. This is minimum description length (Rissanen, 1978), or
Bayesian concept learning with its size principle (Tenenbaum, 1999).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from magical_mj.baselines.goals.arrangements import ATTRIBUTES, Grouped, InLine, Together
from magical_mj.baselines.goals.layouts import Floats, Layouts, by_chance, layouts_of
from magical_mj.baselines.goals.places import LANDMARKS, Near
from magical_mj.baselines.goals.regions import RobotInside, formulas
from magical_mj.baselines.goals.relation import Relation, Situation
from magical_mj.errors import TrainingError
from magical_mj.planning import Noise, Subgoal
from magical_mj.scene import Scene

FAILURE: Final = 0.05
"""The share of demonstrations that are expected to miss the goal."""
UNTRUE: Final = 0.25
"""The share of the demonstrations that may miss it, at most."""

Example = tuple[Scene, Scene]
"""How a demonstration began, and how it ended."""


@dataclass(frozen=True)
class Goal:
    """A relation, and how far off still counts as true.

    Attributes:
        relation: what is wanted.
        limits: one for each of its measures.
        saved: how many bits shorter the demonstrations are told with it than without any goal.
    """

    relation: Relation
    limits: tuple[float, ...]
    saved: float

    def score(self, initial: Scene, now: Scene) -> float:
        """The share of things that are not too far off: 1 if the goal is reached."""
        off = self.relation.off(layouts_of(initial, [now]))
        return float((off <= self.limits).all(axis=2).mean())

    def subgoals(self, initial: Scene, now: Scene, noise: Noise, stuck: Collection[int] = ()) -> tuple[Subgoal, ...]:
        """What is still to be done; nothing if the goal is reached. Blocks that are stuck stay, if possible."""
        if self.score(initial, now) == 1.0:
            return ()
        return tuple(self.relation.subgoals(Situation(initial, now, self.limits, noise, stuck)))

    def __str__(self) -> str:
        return self.relation.text.format(*self.limits)


def vocabulary(scenes: Sequence[Scene]) -> Iterator[Relation]:
    """All relations that can be asked for in these initial scenes."""
    blocks = min(len(scene.blocks) for scene in scenes)
    if all(scene.regions for scene in scenes):
        yield RobotInside()
        if blocks:
            yield from formulas(scenes)
    if blocks:
        yield from (InLine(), Together(), *(Grouped(attribute) for attribute in ATTRIBUTES))
    for who in ("every block", "the robot") if blocks else ("the robot",):
        yield from (Near(who, landmark) for landmark in LANDMARKS)


def infer(examples: Sequence[Example]) -> list[Goal]:
    """The goals that the demonstrations speak for, the likeliest first; equally likely ones in the vocabulary's order.

    Raises:
        TrainingError: if they have nothing in common that can be said.
    """
    rng = np.random.default_rng(0)
    chance = {initial: by_chance(initial, rng) for initial, _ in examples}
    goals = [goal for relation in vocabulary(list(chance)) for goal in _fitted(relation, examples, chance)]
    goals = sorted((goal for goal in goals if goal.saved > 0), key=lambda goal: -goal.saved)
    if not goals:
        raise TrainingError(
            f"the {len(examples)} demonstrations show no goal: no relation of blocks, robot, regions and corners holds "
            "at the end of most of them that did not hold at the beginning, and would hardly hold by chance"
        )
    return goals


def _fitted(relation: Relation, examples: Sequence[Example], chance: dict[Scene, Layouts]) -> Iterator[Goal]:
    """The relation with limits that all demonstrations fulfil, or all but a few."""
    found = [relation.off(layouts_of(initial, [initial, final])) for initial, final in examples]
    worst = np.array([off[1].max(axis=0) for off in found])  # (demonstrations, measures)
    order = (worst / np.maximum(worst.max(axis=0), 1e-9)).max(axis=1).argsort(kind="stable")
    by_accident = {initial: relation.off(layouts).max(axis=1) for initial, layouts in chance.items()}
    options = []
    for missed in range(int(UNTRUE * len(examples)) + 1):
        limits = worst[order[: len(order) - missed]].max(axis=0)
        share = {initial: _share(off, limits) for initial, off in by_accident.items()}
        saved = sum(_saved(off, limits, share[initial]) for off, (initial, _) in zip(found, examples, strict=True))
        options.append(Goal(relation, tuple(limits.tolist()), saved - relation.bits))
    yield max(options, key=lambda goal: goal.saved)


def _share(off: Floats, limits: Floats) -> float:
    """Of scenes in which the relation holds by chance, never quite 0 or 1."""
    return float(((off <= limits).all(axis=1).sum() + 1) / (len(off) + 2))


def _saved(off: Floats, limits: Floats, share: float) -> float:
    """The bits by which one demonstration is told shorter. One that began with the relation says nothing of it."""
    true = off <= limits
    if not true[1].all():
        return math.log2(FAILURE)
    return 0.0 if true[0].all() else math.log2((1 - FAILURE) / share + FAILURE)
