"""The final scenes of questions: one that satisfies an intent, and wrong ones, each the end of another reading.

A reading is an intent, or a shortcut: to move all blocks, those at the demonstrated places, or the one nearest to the
robot. Each wrong end is the end of a plan for its reading, and refutes the intent.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical_mj.intents.ambiguity import Ends, Judge, all_conjuncts, all_selectors, rivals
from magical_mj.intents.cues import CUES, alone, different_blocks, success
from magical_mj.intents.intent import Intent, intent_of
from magical_mj.intents.plans import CLEAR, solved
from magical_mj.intents.readings import DemonstratedBlocks, readings
from magical_mj.intents.relations import STAYED, Conjunct
from magical_mj.intents.scenes import keeps
from magical_mj.intents.selectors import ALL, ROBOT, Selector, Test, UngroundedError, selected
from magical_mj.scene import Scene
from magical_mj.scene.geometry import check_scene
from magical_mj.tasks.planning import Noise, places_anywhere
from magical_mj.utils.errors import IntentError, InvalidSceneError

READING_BITS: Final = 24.0
"""The longest readings, in bits."""
MOST_READINGS: Final = 400
"""The number of the simplest readings that are compared."""
REPLACED: Final = 150
"""The number of draws of intents with replaced relations."""
WRONG: Final = 3
"""The number of wrong options."""
CANDIDATES: Final = 20
"""The number of wrong ends from which a question's are selected."""
INNER: Final = 0.6
"""At positions within this square (half side), the robot touches no wall with any heading."""
HARD: Final = ("most moved", "same ends")
"""Cues that count more in a selection: most intents move more blocks than their readings, and to the same places."""
SHORTCUTS: Final = ("all blocks", "same place", "nearest")


class Option(NamedTuple):
    """A final scene, and the reading that it is the end of: the text of an intent, or one of `SHORTCUTS`."""

    end: Scene
    reading: str


def allowed_readings(demonstrations: Sequence[Ends]) -> list[Intent]:
    """The simplest intents that all demonstrations allow."""
    return rivals(demonstrations, READING_BITS)[:MOST_READINGS]


def doubtful_readings(intent: Intent, demonstrations: Sequence[Ends], rng: np.random.Generator) -> list[Intent]:
    """Intents that at least half of the demonstrations allow, and at least one refutes, in random order.

    Half of them are simple, the others are the intent with one or two relations replaced by others of the same kind.
    """
    simple = _doubtful(rivals(demonstrations[:1], READING_BITS)[:MOST_READINGS], demonstrations)
    kinds = {one.relation for one in intent.conjuncts}
    parts = [Intent((one,)) for one in all_conjuncts() if one.relation in kinds]
    replacements = [one.conjuncts[0] for one in _doubtful(parts, demonstrations, at_start=True)]
    changed = _doubtful(list(dict.fromkeys(_with_replacements(intent, replacements, rng))), demonstrations)
    drawn = [simple[place] for place in rng.permutation(len(simple)).tolist()]
    return [one for pair in itertools.zip_longest(changed, drawn) for one in pair if one is not None]


def shortcuts(intent: Intent, demonstrations: Sequence[Ends], scene: Scene) -> Iterator[tuple[str, Intent]]:
    """The intent as each shortcut reads it in a scene: it moves other blocks instead of the intended ones."""
    blocks = readings(DemonstratedBlocks.of(demonstrations[:1]), scene)["same place"]
    selectors = {"all blocks": ALL, "same place": _selector_of(blocks, scene), "nearest": (Test("nearest", ROBOT),)}
    for name, selector in selectors.items():
        if selector is not None and (redirected := _redirected(intent, selector)) is not None:
            yield name, redirected


def end_of(intent: Intent, scene: Scene, noise: Noise | None = None) -> Scene | None:
    """The end of a plan from a scene, in which no bodies overlap. None if there is none."""
    if not intent.grounded(scene) or intent.holds(scene, scene):
        return None
    end = solved(intent, scene, noise)
    return None if end is None else next((free for free in _with_free_robot(end) if is_legal(free)), None)


def is_legal(scene: Scene) -> bool:
    """Whether all bodies are inside the walls and none overlap."""
    try:
        check_scene(scene)
    except InvalidSceneError:
        return False
    return True


def _with_free_robot(scene: Scene) -> Iterator[Scene]:
    """The scene, and if a block or a wall is where the robot stands, with other headings, then at free positions."""
    robot = scene.robot
    yield scene
    gap = min((math.dist(block.pose[:2], robot.pose[:2]) for block in scene.blocks), default=math.inf)
    if gap >= CLEAR:
        yield from (scene.moved(robot=(robot.x, robot.y, turn * math.pi / 4)) for turn in range(8))
        return
    free = [(x, y) for x, y in places_anywhere() if max(abs(x), abs(y)) <= INNER]
    for x, y in sorted(free, key=lambda place: math.dist(place, robot.pose[:2])):
        if all(math.dist(block.pose[:2], (x, y)) >= CLEAR for block in scene.blocks):
            yield scene.moved(robot=(x, y, robot.angle))


def wrong_ends(intent: Intent, named: Iterable[tuple[str, Intent]], scene: Scene, right: Scene) -> Iterator[Option]:
    """The ends of named readings that refute the intent, each different from the right end and from those before."""
    ends = [right]
    for name, reading in named:
        end = end_of(reading, scene)
        if end is not None and not intent.holds(scene, end) and not any(_alike(end, other) for other in ends):
            ends.append(end)
            yield Option(end, name)


def selection(
    demonstrations: Sequence[Ends], scene: Scene, right: Scene, wrong: Sequence[Option], rng: np.random.Generator
) -> list[Option] | None:
    """`WRONG` of the wrong options, such that each cue prefers the right end with about a probability of a quarter.

    For each cue, it is drawn whether it should prefer the right end. The selection fulfils most of these draws.
    """
    if len(wrong) < WRONG:
        return None
    ends = [right, *(option.end for option in wrong)]
    groups = np.array([(0, *group) for group in itertools.combinations(range(1, len(ends)), WRONG)])
    distances = different_blocks(ends)[groups[:, :, None], groups[:, None, :]].sum(axis=2)
    values = [alone(cue, demonstrations, scene, ends)[groups] for cue in CUES[:-2]] + [-distances, distances]
    chosen = np.array([success(value) for value in values])  # (cues, groups)
    wanted = rng.random(len(values)) < 1 / (1 + WRONG)
    weight = np.where(np.isin(CUES, HARD), 3.0, 1.0)
    best = int((weight @ np.square(chosen - wanted[:, None])).argmin())
    return [wrong[number - 1] for number in groups[best, 1:].tolist()]


def weights(readings: Sequence[Intent]) -> NDArray[np.float64]:
    """The prior probabilities of readings up to a factor: 2 to the power of minus their bits."""
    return np.exp2([-reading.bits for reading in readings])


def _doubtful(intents: Sequence[Intent], demonstrations: Sequence[Ends], *, at_start: bool = False) -> list[Intent]:
    """The intents that at least half of the demonstrations allow, but not all. `at_start`: they may hold there."""
    judge = Judge(intents)
    allows = judge.holds if at_start else judge.reached
    counts = np.sum([allows(*ends) for ends in demonstrations], axis=0)
    number = len(demonstrations)
    return [one for one, count in zip(intents, counts, strict=True) if number / 2 <= count < number]


def _with_replacements(intent: Intent, parts: Sequence[Conjunct], rng: np.random.Generator) -> Iterator[Intent]:
    """The intent with one or two of its relations replaced by random ones of the same kind."""
    own = list(intent.conjuncts)
    for _ in range(REPLACED if parts else 0):
        changed = list(own)
        for place in rng.permutation(len(own))[: 1 + int(rng.integers(min(2, len(own))))].tolist():
            same = [part for part in parts if part.relation == own[place].relation]
            if same:
                changed[place] = same[int(rng.integers(len(same)))]
        try:
            other = intent_of(changed)
        except IntentError:  # such as others beside all
            continue
        if other != intent:
            yield other


def _selector_of(blocks: frozenset[int], scene: Scene) -> Selector | None:
    """The first selector that selects just these blocks in a scene, or None."""
    for selector in all_selectors():
        try:
            if frozenset(selected(selector, scene)) == blocks:
                return selector
        except UngroundedError:
            continue
    return None


def _redirected(intent: Intent, selector: Selector) -> Intent | None:
    """The intent with another selector in all relations that ask for a change, and without the others."""
    asking = [one for one in intent.conjuncts if not keeps(one)]
    if not any(one.definition.of_blocks for one in asking):
        return None
    changed = [replace(one, selector=selector, any_of=False) if one.definition.of_blocks else one for one in asking]
    try:
        return intent_of(changed)
    except IntentError:
        return None


def _alike(one: Scene, other: Scene) -> bool:
    """Whether all bodies are at the same positions, up to `STAYED`."""
    bodies = zip((one.robot, *one.blocks), (other.robot, *other.blocks), strict=True)
    return all(math.hypot(here.x - there.x, here.y - there.y) <= STAYED for here, there in bodies)
