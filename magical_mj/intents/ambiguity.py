"""Rivals: all intents that demonstrations, or the end of one episode, are consistent with.

All relations are judged for all selectors at once: each selector is a mask over blocks, each relation a truth value for
each block, and both are combined by numpy.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from magical_mj.intents.canonical import implies
from magical_mj.intents.intent import Intent, conjunct_bits, intent_bits, intent_of
from magical_mj.intents.relations import RELATIONS, Conjunct, Each
from magical_mj.intents.selectors import (
    ALL,
    NEGATABLE,
    PAIRS,
    REST,
    VALUES,
    Selector,
    Test,
    UngroundedError,
    names_one,
    selected,
)
from magical_mj.scene import Scene, check_scene_type
from magical_mj.utils.errors import SettingsError, short_repr

MOST_IN_REGION: Final = 3
"""The largest number that rivals with "exactly" name."""
Masks = NDArray[np.bool_]


class HasScenes(Protocol):
    """A demonstration, or another object with the scenes of its steps."""

    def scenes(self) -> Sequence[Scene]:
        """The scenes of all steps."""
        ...


Ends = tuple[Scene, Scene]
"""The initial and the final scene of an episode."""


def rivals(demonstrations: Iterable[HasScenes | Ends], bits: float = 24.0) -> list[Intent]:
    """The intents of one or two conjuncts that all demonstrations have reached at their end and none at its start.

    Every conjunct of a rival is about something in each demonstration, and none follows from the other.

    Args:
        demonstrations: demonstrations, or pairs of an initial and a final scene.
        bits: the longest description.

    Returns:
        The intents, the simplest first; those with the same number of bits in the order of their texts.

    Raises:
        SettingsError: if there are no demonstrations, or other objects.
    """
    ends = [] if isinstance(demonstrations, str) else [ends_of(demonstration) for demonstration in demonstrations]
    if not ends:
        raise SettingsError(
            'rivals are of demonstrations, such as magical_mj.demos.load("FindDupe"), or of pairs of scenes: give at '
            f"least one, not {short_repr(demonstrations)}"
        )
    table = _table(bits)
    truths = [(_truths(table, start, start), _truths(table, start, end)) for start, end in ends]
    found = [Intent((table.conjuncts[index],)) for index in np.flatnonzero(_consistent(truths))]
    found += _pairs(table, truths, bits)
    return sorted(found, key=lambda intent: (intent.bits, str(intent)))


def explain(initial: Scene, final: Scene, bits: float = 24.0) -> list[Intent]:
    """The intents that an episode has reached at its end and not at its start, the simplest first."""
    return rivals([(initial, final)], bits)


def ends_of(demonstration: HasScenes | Ends) -> Ends:
    """The initial and the final scene of a demonstration."""
    if isinstance(demonstration, tuple):
        for scene in demonstration:
            check_scene_type(scene)
        return demonstration
    scenes = demonstration.scenes()
    return scenes[0], scenes[-1]


class Judge:
    """Says which of some intents episodes have reached. Intents that could be rivals are judged all at once."""

    def __init__(self, intents: Sequence[Intent]) -> None:
        self.intents = tuple(intents)
        together = np.array([_is_like_rivals(intent) for intent in self.intents], np.bool_)
        self._together, self._alone = np.flatnonzero(together), np.flatnonzero(~together)
        likes = [self.intents[number] for number in self._together]
        conjuncts = sorted({one for intent in likes for one in intent.conjuncts}, key=lambda one: one.selector == REST)
        used = {one.selector for one in conjuncts if RELATIONS[one.relation].of_blocks and one.selector != REST}
        self._table = _table_of(conjuncts, sorted(used) or [ALL])
        place = {conjunct: number for number, conjunct in enumerate(conjuncts)}
        places = [sorted((place[intent.conjuncts[0]], place[intent.conjuncts[-1]])) for intent in likes]
        self._places = np.array(places, np.int64).reshape(-1, 2)  # `others` come last

    def reached(self, initial: Scene, final: Scene) -> NDArray[np.bool_]:
        """Which intents the episode has reached at its end, and not at its start. Shape (intents,)."""
        return self.holds(initial, final) & ~self.holds(initial, initial)

    def holds(self, initial: Scene, final: Scene) -> NDArray[np.bool_]:
        """Which intents hold in the final scene and are about something in the initial one. Shape (intents,)."""
        reached = np.zeros(len(self.intents), np.bool_)
        alone = [self.intents[number] for number in self._alone]
        reached[self._alone] = [intent.grounded(initial) and intent.holds(initial, final) for intent in alone]
        truths = _truths(self._table, initial, final)
        one, two = self._places.T
        holds = truths.holds[two]
        for number, conjunct in enumerate(self._table.conjuncts):
            if conjunct in truths.rest:
                with_others = two == number
                holds[with_others] = truths.rest[conjunct][self._table.selector[one[with_others]]]
        reached[self._together] = truths.holds[one] & holds
        return reached


def _is_like_rivals(intent: Intent) -> bool:
    """Whether an intent has at most two conjuncts, of the kinds that rivals have."""
    return len(intent.conjuncts) <= 2 and all(
        one.selector == ALL
        if one.relation == "clustered"
        else one.selector != REST or RELATIONS[one.relation].each is not None
        for one in intent.conjuncts
    )


class _Table(NamedTuple):
    """Conjuncts up to a number of bits, and where their truth values are found.

    Conjuncts with the selector `others` come last: their truth depends on the selector of the other conjunct.
    """

    conjuncts: tuple[Conjunct, ...]
    bits: NDArray[np.float64]
    selectors: tuple[Selector, ...]
    selector: NDArray[np.int64]  # the index of each conjunct's selector; -1 for `others` and of the robot


@lru_cache(maxsize=8)
def _table(bits: float) -> _Table:
    conjuncts = sorted(
        (conjunct for conjunct in all_conjuncts() if intent_bits([conjunct]) <= bits),
        key=lambda conjunct: conjunct.selector == REST,
    )
    return _table_of(conjuncts, _selectors())


def _table_of(conjuncts: Sequence[Conjunct], selectors: Sequence[Selector]) -> _Table:
    index = {selector: number for number, selector in enumerate(selectors)}
    of = [index.get(c.selector, -1) if RELATIONS[c.relation].of_blocks else -1 for c in conjuncts]
    return _Table(tuple(conjuncts), np.array([conjunct_bits(c) for c in conjuncts]), tuple(selectors), np.array(of))


@lru_cache(maxsize=1)
def _selectors() -> tuple[Selector, ...]:
    """All selectors but `others`."""
    tests = {
        name: [
            Test(name, value, equal) for value in values for equal in ((True, False) if name in NEGATABLE else (True,))
        ]
        for name, values in VALUES.items()
    }
    singles = [(test,) for group in tests.values() for test in group]
    return (ALL, *singles, *(pair for one, two in PAIRS for pair in itertools.product(tests[one], tests[two])))


def all_conjuncts() -> Iterable[Conjunct]:
    """All conjuncts in canonical form; with `others` only those that want nothing done."""
    for name, relation in RELATIONS.items():
        for argument in relation.arguments:
            if not relation.of_blocks:
                yield Conjunct(name, argument=argument)
            elif name == "clustered":
                yield Conjunct(name, ALL, argument)
            else:
                numbers = range(1, MOST_IN_REGION + 1) if name == "exactly" else (0,)
                quantifiers = (False, True) if relation.quantified else (False,)
                for selector, number, any_of in itertools.product(_selectors(), numbers, quantifiers):
                    if not names_one(selector) or (relation.each is not None and not any_of):
                        yield Conjunct(name, selector, argument, number, any_of)
                if relation.least == 0:
                    yield Conjunct(name, REST, argument)


class _Truths(NamedTuple):
    """Truth values in one pair of scenes; False also where a conjunct is about nothing."""

    holds: NDArray[np.bool_]  # of each conjunct; False for those with `others`
    rest: dict[Conjunct, NDArray[np.bool_]]  # of those with `others`, by the selector of the other conjunct


def _truths(table: _Table, initial: Scene, final: Scene) -> _Truths:
    masks, valid = _masks(table.selectors, initial)
    cache: dict[object, NDArray[np.bool_]] = {}
    holds = np.zeros(len(table.conjuncts), np.bool_)
    rest: dict[Conjunct, NDArray[np.bool_]] = {}
    for number, conjunct in enumerate(table.conjuncts):
        each = RELATIONS[conjunct.relation].each
        if conjunct.selector == REST and each is not None:
            rest[conjunct] = _of_each(conjunct, each, ~masks, valid, initial, final)
            continue
        key = (conjunct.relation, conjunct.argument, conjunct.number, conjunct.any_of)
        if key not in cache:
            cache[key] = _of_selectors(conjunct, masks, valid, initial, final)
        holds[number] = cache[key][max(table.selector[number], 0)]
    return _Truths(holds, rest)


def _masks(selectors: Sequence[Selector], scene: Scene) -> tuple[Masks, NDArray[np.bool_]]:
    """Shape (selectors, blocks): which blocks each selects; and whether it means something in the scene."""
    masks = np.zeros((len(selectors), len(scene.blocks)), np.bool_)
    valid = np.ones(len(selectors), np.bool_)
    for number, selector in enumerate(selectors):
        try:
            masks[number, list(selected(selector, scene))] = True
        except UngroundedError:
            valid[number] = False
    return masks, valid


def _of_selectors(
    conjunct: Conjunct, masks: Masks, valid: NDArray[np.bool_], initial: Scene, final: Scene
) -> NDArray[np.bool_]:
    """Whether the conjunct holds with each selector instead of its own, shape (selectors,)."""
    relation = RELATIONS[conjunct.relation]
    if relation.each is not None:
        return _of_each(conjunct, relation.each, masks, valid, initial, final)
    if relation.robot is not None or conjunct.relation == "clustered":
        return np.full(len(valid), _all(conjunct.parts, initial, final))
    unique, place = np.unique(masks, axis=0, return_inverse=True)
    together = np.zeros(len(unique), np.bool_)
    for number, mask in enumerate(unique):
        blocks = tuple(np.flatnonzero(mask).tolist())
        if len(blocks) >= max(relation.least, conjunct.number):
            together[number] = _all(relation.together, conjunct, blocks, initial, final)
    return together[place.reshape(-1)] & valid


def _of_each(
    conjunct: Conjunct, each: Each, masks: Masks, valid: NDArray[np.bool_], initial: Scene, final: Scene
) -> NDArray[np.bool_]:
    try:
        flags = each(conjunct.argument, initial, final)
    except UngroundedError:
        return np.zeros(len(valid), np.bool_)
    about = np.array([flag is not None for flag in flags], np.bool_)
    true = np.array([bool(flag) for flag in flags], np.bool_)
    concerned = masks & about
    holds = (concerned & true).any(axis=1) if conjunct.any_of else (true | ~concerned).all(axis=1)
    return holds & valid & concerned.any(axis=1)


def _all(parts: Callable[..., Iterable[bool]], *about: object) -> bool:
    """Whether a conjunct holds for all objects. False if it means nothing."""
    try:
        return all(parts(*about))
    except UngroundedError:
        return False


def _consistent(truths: Sequence[tuple[_Truths, _Truths]]) -> NDArray[np.bool_]:
    """Which conjuncts hold at the end of all episodes and at the start of none, shape (conjuncts,)."""
    return np.logical_and.reduce([end.holds & ~start.holds for start, end in truths])


def _pairs(table: _Table, truths: Sequence[tuple[_Truths, _Truths]], bits: float) -> list[Intent]:
    """The consistent intents of two conjuncts."""
    at_ends = np.logical_and.reduce([end.holds for _, end in truths])
    starts = np.stack([start.holds for start, _ in truths], axis=1)  # (conjuncts, episodes)
    kept = np.flatnonzero(at_ends)
    found = []
    for place, first in enumerate(kept):
        seconds = kept[place + 1 :]
        short = intent_bits(()) + table.bits[first] + table.bits[seconds] <= bits
        new = ~(starts[first] & starts[seconds]).any(axis=1)
        found += [(int(first), int(second)) for second in seconds[short & new]]
        found += [(int(first), rest) for rest in _with_others(table, truths, int(first), bits)]
    pairs = [(table.conjuncts[one], table.conjuncts[two]) for one, two in found]
    return [intent_of([*pair]) for pair in pairs if not implies(*pair) and not implies(*pair[::-1])]


def _with_others(table: _Table, truths: Sequence[tuple[_Truths, _Truths]], first: int, bits: float) -> Iterable[int]:
    """The conjuncts with `others` that are consistent together with the first."""
    selector = table.selector[first]
    if selector < 0:
        return
    for number in range(len(table.conjuncts) - 1, -1, -1):
        conjunct = table.conjuncts[number]
        if conjunct.selector != REST:
            return
        short = intent_bits(()) + table.bits[first] + table.bits[number] <= bits
        if short and all(
            end.rest[conjunct][selector] and not (start.holds[first] and start.rest[conjunct][selector])
            for start, end in truths
        ):
            yield number
