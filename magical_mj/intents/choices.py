"""The final scenes of questions: one that satisfies an intent, and wrong ones, each the end of another reading.

A reading is an intent, or a shortcut (`magical_mj.intents.shortcuts`). Each wrong end is the end of a plan for its
reading, and refutes the intent.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache, partial
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical_mj.intents.ambiguity import Ends, Judge, all_conjuncts, rivals
from magical_mj.intents.cues import CUES, alone, different_blocks, success
from magical_mj.intents.floors import shortcuts
from magical_mj.intents.intent import Intent, intent_of
from magical_mj.intents.plans import CLEAR, solved
from magical_mj.intents.readings import moved_blocks
from magical_mj.intents.relations import STAYED, Conjunct
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
"""A question's wrong ends are selected from this number."""
INNER: Final = 0.6
"""At positions within this square (half side), the robot touches no wall with any heading."""
HARD: Final = ("most moved", "same ends")
"""Cues that count more in a selection: most intents move more blocks than their readings, and to the same places."""
SHORTCUTS: Final = ("all blocks", "demonstrated places", "nearest blocks")
"""The shortcuts behind wrong options."""


class Option(NamedTuple):
    """A final scene, and the reading that it is the end of: the text of an intent, or one of `SHORTCUTS`."""

    end: Scene
    reading: str


@lru_cache(maxsize=8)  # the two questions of an intent have the same demonstrations
def allowed_readings(demonstrations: tuple[Ends, ...]) -> tuple[Intent, ...]:
    """The simplest intents that all demonstrations allow."""
    return tuple(rivals(demonstrations, READING_BITS)[:MOST_READINGS])


def doubtful_readings(intent: Intent, demonstrations: tuple[Ends, ...], rng: np.random.Generator) -> list[Intent]:
    """Intents that at least half of the demonstrations allow, and at least one refutes, in random order.

    Half of them are simple, the others are the intent with one or two relations replaced by others of the same kind.
    """
    simple = _doubtful(Judge(allowed_readings(demonstrations[:1])), demonstrations)
    parts = _judge_of_parts(frozenset(one.relation for one in intent.conjuncts))
    replacements = [one.conjuncts[0] for one in _doubtful(parts, demonstrations, at_start=True)]
    changed = _doubtful(Judge(list(dict.fromkeys(_with_replacements(intent, replacements, rng)))), demonstrations)
    drawn = [simple[place] for place in rng.permutation(len(simple)).tolist()]
    return [one for pair in itertools.zip_longest(changed, drawn) for one in pair if one is not None]


def shortcut_ends(intent: Intent, demonstrations: Sequence[Ends], scene: Scene) -> Iterator[Option]:
    """The ends of the shortcuts in a scene, as far as a demonstration refutes them: it moved other blocks."""
    demo = demonstrations[0][0]
    for name in SHORTCUTS:
        end = partial(shortcuts[name].end, intent, demo)
        if any(moved_blocks(start, final) != moved_blocks(start, end(start)) for start, final in demonstrations):
            legal = first_legal(end(scene))
            if legal is not None:
                yield Option(legal, name)


def end_of(intent: Intent, scene: Scene, noise: Noise | None = None) -> Scene | None:
    """The end of a plan from a scene without overlaps of bodies, or None."""
    if not intent.grounded(scene) or intent.holds(scene, scene):
        return None
    end = solved(intent, scene, noise)
    return None if end is None else first_legal(end)


def first_legal(scene: Scene) -> Scene | None:
    """The scene without overlaps of bodies, if need be with the robot at another position, or None."""
    return next((free for free in _with_free_robot(scene) if is_legal(free)), None)


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


def distinct(intent: Intent, options: Iterable[Option], scene: Scene, right: Scene) -> Iterator[Option]:
    """The options that refute the intent, each different from the right end and from those before."""
    ends = [right]
    for option in options:
        if not intent.holds(scene, option.end) and not any(_alike(option.end, other) for other in ends):
            ends.append(option.end)
            yield option


def reading_ends(readings: Iterable[Intent], scene: Scene) -> Iterator[Option]:
    """The ends of readings in a scene, where they have one."""
    for reading in readings:
        end = end_of(reading, scene)
        if end is not None:
            yield Option(end, str(reading))


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


@lru_cache(maxsize=64)
def _judge_of_parts(relations: frozenset[str]) -> Judge:
    """The judge of all intents with one of these relations."""
    return Judge([Intent((one,)) for one in all_conjuncts() if one.relation in relations])


def _doubtful(judge: Judge, demonstrations: Sequence[Ends], *, at_start: bool = False) -> list[Intent]:
    """The judge's intents that at least half of the demonstrations allow, but not all.

    `at_start`: they may hold there.
    """
    allows = judge.holds if at_start else judge.reached
    counts = np.sum([allows(*ends) for ends in demonstrations], axis=0)
    number = len(demonstrations)
    return [one for one, count in zip(judge.intents, counts, strict=True) if number / 2 <= count < number]


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
        except IntentError:  # such as others and all
            continue
        if other != intent:
            yield other


def _alike(one: Scene, other: Scene) -> bool:
    """Whether all bodies are at the same positions, up to `STAYED`."""
    bodies = zip((one.robot, *one.blocks), (other.robot, *other.blocks), strict=True)
    return all(math.hypot(here.x - there.x, here.y - there.y) <= STAYED for here, there in bodies)
