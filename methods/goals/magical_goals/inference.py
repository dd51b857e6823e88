"""Infers an intent from demonstrations, by minimum description length (Rissanen, 1978).

The intent is the one that gives the final scenes of the demonstrations the shortest description: the bits of the intent
itself, plus the bits that select each final scene among all scenes that satisfy the intent. The fewer scenes satisfy
an intent, the fewer bits this takes. So the strictest of the intents that all demonstrations have reached is preferred.
In Bayesian concept learning this is called the size principle (Tenenbaum, 1999). The bits that an intent saves are the
logarithm of its posterior probability, up to a constant.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical_mj.intents import Intent, rivals
from magical_mj.intents.ambiguity import Ends, Judge
from magical_mj.intents.intent import MOST_CONJUNCTS, conjunct_bits, intent_of
from magical_mj.intents.plans import plan, solved
from magical_mj.intents.relations import Conjunct
from magical_mj.intents.selectors import REST
from magical_mj.scene import Scene
from magical_mj.scene.scene import Pose
from magical_mj.tasks.planning import REACHABLE, Noise, scene_after
from magical_mj.utils.errors import PlacementError, TrainingError

BITS: Final = 28.0
"""Intents of one or two relations are considered up to this length."""
MOST: Final = 2000
"""At most this number of them are compared, the simplest ones."""
EXTENDED: Final = 8
"""The number of the best intents that are extended by another relation, in each round."""
PLANS: Final = 2
"""The number of plans in each scene, for estimating how likely another relation holds without being a goal."""
SAMPLES: Final = 50
"""The number of random ends of each demonstration, for estimating how likely an intent holds by chance."""
COMPARED: Final = 40
"""The number of the most probable intents whose plans are compared in a scene."""
MOVED: Final = 0.05
"""A block or the robot counts as moved if it is farther (units) from its start."""


class Goal(NamedTuple):
    """An intent, and the number of bits that it saves in the description of the demonstrations."""

    intent: Intent
    saved: float


def infer(ends: Sequence[Ends]) -> list[Goal]:
    """The intents that all demonstrations have reached, the best first. Equal scenes give equal intents.

    Args:
        ends: the first and the last scene of each demonstration.

    Raises:
        TrainingError: if no intent was reached by all demonstrations.
    """
    found = rivals(ends, BITS)[:MOST]
    if not found:
        raise TrainingError(
            f"the {len(ends)} demonstrations show no goal: every intent fails at the end of some of them, or already "
            "held at the start"
        )
    rng = np.random.default_rng(0)
    starts = [start for start, _ in ends]
    random = [list(_random_ends(*pair, rng)) for pair in ends]
    reached = _holds(found, starts, random) & ~_holds(found, starts, [[start] for start in starts])
    chance = (reached.sum(2) + 1) / (SAMPLES + 2)  # with Laplace smoothing
    saved = -np.log2(chance).sum(1)
    longest = [Goal(intent, float(bits) - intent.bits) for intent, bits in zip(found, saved, strict=True)]
    goals = {goal.intent: goal for goal in longest}
    parts = sorted({one for intent in found for one in intent.conjuncts if one.selector != REST})
    scenes = list(dict.fromkeys(starts))
    while longest:
        best = [goal for goal in sorted(longest, key=_order) if _may_be_extended(goal.intent)][:EXTENDED]
        longest = [longer for goal in best for longer in _extended(goal, parts, scenes, rng)]
        goals |= {goal.intent: goal for goal in longest}
    return sorted(goals.values(), key=_order)


def best_intent(goals: Sequence[Goal], scene: Scene) -> Intent | None:
    """The intent to pursue in a scene: that whose plan has the largest expected score.

    The expectation is over the most probable intents that apply to objects in the scene and do not hold yet. Their
    saved bits give their posterior probabilities. A plan for several relations often satisfies the simpler intents as
    well, so it is a good choice while it is not clear which of them is meant. If none has a plan, it is None.

    Args:
        goals: the result of `infer`.
        scene: the initial scene.
    """
    possible = [one for one in goals if one.intent.grounded(scene) and not one.intent.holds(scene, scene)][:COMPARED]
    ends = {end: one.intent for one in reversed(possible) if (end := solved(one.intent, scene))}
    if not ends:
        return None
    weights = np.exp2([one.saved - possible[0].saved for one in possible])
    scores = [[one.intent.score(scene, end) for end in ends] for one in possible]
    return list(ends.values())[int((weights @ np.array(scores)).argmax())]


def _order(goal: Goal) -> tuple[float, float, str]:
    """The key for sorting goals: the most saved bits first, then the simplest intent, then by its text."""
    return -round(goal.saved, 6), round(goal.intent.bits, 6), str(goal.intent)


def _may_be_extended(intent: Intent) -> bool:
    """Whether one more relation is possible, and does not change the meaning of `others`."""
    return len(intent.conjuncts) < MOST_CONJUNCTS and all(one.selector != REST for one in intent.conjuncts)


def _extended(
    goal: Goal, parts: Sequence[Conjunct], starts: Sequence[Scene], rng: np.random.Generator
) -> Iterator[Goal]:
    """The goal with each part that saves further bits.

    A part saves bits if all demonstrations reach it, but plans for the goal alone do so rarely. A coincidence in a
    scene repeats in all demonstrations of the scene, so each scene counts once.
    """
    noise = Noise(rng, 1.0)
    planned = [[_planned(goal.intent, start, noise) for _ in range(PLANS)] for start in starts]
    held = _holds([Intent((part,)) for part in parts], starts, planned).sum((1, 2))
    for part, count in zip(parts, held, strict=True):
        bits = -math.log2((count + 0.5) / (len(starts) * PLANS + 1))
        gain = len(starts) * bits - conjunct_bits(part)
        longer = intent_of([*goal.intent.conjuncts, part])
        if gain > 0 and len(longer.conjuncts) > len(goal.intent.conjuncts):  # the goal does not imply the part
            yield Goal(longer, goal.saved + gain)


def _planned(intent: Intent, start: Scene, noise: Noise) -> Scene:
    """The scene after a plan for an intent."""
    try:
        return scene_after(start, plan(intent, start, start, noise))
    except PlacementError:
        return start


def _random_ends(start: Scene, final: Scene, rng: np.random.Generator) -> Iterator[Scene]:
    """Scenes with random positions of as many blocks as were moved, and of the robot if it was moved."""
    poses = [block.pose for block in start.blocks]
    moved = sum(_apart(block.pose, pose) for block, pose in zip(final.blocks, poses, strict=True))
    drove = _apart(start.robot.pose, final.robot.pose)
    for _ in range(SAMPLES):
        changed = list(poses)
        for index in rng.permutation(len(poses))[:moved]:
            changed[index] = _pose(rng)
        yield start.moved(_pose(rng) if drove else start.robot.pose, changed)


def _pose(rng: np.random.Generator) -> Pose:
    x, y = rng.uniform(-REACHABLE, REACHABLE, 2).tolist()
    return x, y, 0.0


def _apart(pose: Pose, other: Pose) -> bool:
    """Whether the positions differ by more than `MOVED`."""
    return math.dist(pose[:2], other[:2]) > MOVED


def _holds(intents: Sequence[Intent], starts: Sequence[Scene], ends: Sequence[Sequence[Scene]]) -> NDArray[np.bool_]:
    """Which intents hold at the ends of each start, shape (intents, starts, ends)."""
    judge = Judge(intents)
    rows = [[judge.holds(start, end) for end in group] for start, group in zip(starts, ends, strict=True)]
    return np.moveaxis(np.array(rows, np.bool_), 2, 0)
