"""Infers a goal from demonstrations, by minimum description length (Rissanen, 1978).

The goal is the relation that gives the final states of the demonstrations the shortest description: the bits of the
relation itself, plus the bits that select each final state among all layouts that fulfil the relation. The fewer
layouts fulfil a relation, the fewer bits this takes. So the strictest of the relations that hold in all final states
is preferred. In Bayesian concept learning this is called the size principle (Tenenbaum, 1999).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from magical_goals.arrangements import ATTRIBUTES, Grouped, InLine, Together
from magical_goals.regions import LANDMARKS, WHO, Near, RobotInside, formulas
from magical_goals.relation import Floats, Layouts, Relation, Situation, layouts_of, random_layouts
from magical_mj.scene import Scene
from magical_mj.tasks.planning import Noise, Subgoal
from magical_mj.utils.errors import TrainingError

FAILURE: Final = 0.05
"""The expected share of demonstrations that miss the goal."""
UNTRUE: Final = 0.25
"""The largest share of the demonstrations that can be left out when limits are fitted."""

Example = tuple[Scene, Scene]
"""The first and the last scene of a demonstration."""


@dataclass(frozen=True)
class InferredGoal:
    """A relation with limits.

    Attributes:
        relation: the relation that should hold at the end.
        limits: the largest deviations that fulfil it, one for each measure.
        saved: the number of bits that it saves in the description of the demonstrations.
    """

    relation: Relation
    limits: tuple[float, ...]
    saved: float

    def score(self, initial: Scene, now: Scene) -> float:
        """The share of blocks (or of the robot) within the limits; 1 if the goal is reached."""
        off = self.relation.deviations(layouts_of(initial, [now]))
        return float((off <= self.limits).all(axis=2).mean())

    def subgoals(self, initial: Scene, now: Scene, noise: Noise, stuck: Collection[int] = ()) -> tuple[Subgoal, ...]:
        """The remaining subgoals. Empty if the goal is reached. In lines and groups, stuck blocks stay, if possible."""
        if self.score(initial, now) == 1.0:
            return ()
        return tuple(self.relation.subgoals(Situation(initial, now, self.limits, noise, stuck)))

    def __str__(self) -> str:
        return self.relation.text.format(*self.limits)


def vocabulary(scenes: Sequence[Scene]) -> Iterator[Relation]:
    """All relations that are meaningful in these initial scenes."""
    blocks = min(len(scene.blocks) for scene in scenes)
    if all(scene.regions for scene in scenes):
        yield RobotInside()
        if blocks:
            yield from formulas(scenes)
    if blocks:
        yield from (InLine(), Together(), *(Grouped(attribute) for attribute in ATTRIBUTES))
    for who in WHO if blocks else ("the robot",):
        yield from (Near(who, landmark) for landmark in LANDMARKS)


def infer(examples: Sequence[Example]) -> list[InferredGoal]:
    """The goals that shorten the description, the best first. Equal ones are in the order of the vocabulary.

    Raises:
        TrainingError: if there are none.
    """
    rng = np.random.default_rng(0)
    chance = {initial: random_layouts(initial, rng) for initial, _ in examples}
    fitted = [_fitted(relation, examples, chance) for relation in vocabulary(list(chance))]
    goals = sorted((goal for goal in fitted if goal.saved > 0), key=lambda goal: -goal.saved)
    if not goals:
        raise TrainingError(
            f"the {len(examples)} demonstrations show no goal: every relation of blocks, robot, regions and corners "
            "fails at the end of too many of them, or already held at the start, or is likely to hold by chance"
        )
    return goals


def _fitted(relation: Relation, examples: Sequence[Example], chance: dict[Scene, Layouts]) -> InferredGoal:
    """The relation with the limits that save most. They hold in all final states, or in all except the worst few."""
    deviations = [relation.deviations(layouts_of(initial, [initial, final])) for initial, final in examples]
    worst = np.array([off[1].max(axis=0) for off in deviations])  # (demonstrations, measures)
    order = (worst / np.maximum(worst.max(axis=0), 1e-9)).max(axis=1).argsort(kind="stable")
    by_chance = {initial: relation.deviations(layouts).max(axis=1) for initial, layouts in chance.items()}
    options = []
    for missed in range(int(UNTRUE * len(examples)) + 1):
        limits = worst[order[: len(order) - missed]].max(axis=0)
        share = {initial: _share(off, limits) for initial, off in by_chance.items()}
        saved = sum(_saved(off, limits, share[initial]) for off, (initial, _) in zip(deviations, examples, strict=True))
        options.append(InferredGoal(relation, tuple(limits.tolist()), saved - relation.bits))
    return max(options, key=lambda goal: goal.saved)


def _share(off: Floats, limits: Floats) -> float:
    """The share of random layouts that fulfil the relation, with Laplace smoothing."""
    return float(((off <= limits).all(axis=1).sum() + 1) / (len(off) + 2))


def _saved(off: Floats, limits: Floats, share: float) -> float:
    """The bits saved for one demonstration. 0 if the relation already held at its start."""
    true = off <= limits
    if not true[1].all():
        return math.log2(FAILURE)
    return 0.0 if true[0].all() else math.log2((1 - FAILURE) / share + FAILURE)
