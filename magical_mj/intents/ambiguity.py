"""Rivals: all intents that demonstrations, or the end of one episode, are consistent with.

All relations are judged for all selectors at once: each selector is a mask over blocks, each relation a truth value for
each block, and both are combined by numpy.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Final, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from magical_mj.intents.canonical import implies
from magical_mj.intents.intent import Intent, conjunct_bits, intent_bits, intent_of
from magical_mj.intents.readings import moved_blocks
from magical_mj.intents.relations import RELATIONS, STAYED, Conjunct, Each
from magical_mj.intents.scenes import keeps
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
from magical_mj.scene import Scene, check_same_objects
from magical_mj.utils.errors import SettingsError, short_repr

MOST_IN_REGION: Final = 3
"""The largest number of blocks in rivals with "exactly"."""
Flags = NDArray[np.bool_]


@runtime_checkable
class HasScenes(Protocol):
    """A demonstration, or another object with the scenes of its steps."""

    def scenes(self) -> Sequence[Scene]:
        """The scenes of all steps."""
        ...


Ends = tuple[Scene, Scene]
"""The initial and the final scene of an episode."""


def rivals(demonstrations: Iterable[HasScenes | Ends], bits: float = 24.0) -> list[Intent]:
    """The intents of one or two conjuncts that hold at the end of every demonstration, and at no start.

    Every conjunct of a rival applies to at least one object in each demonstration, and none follows from the other.

    Args:
        demonstrations: demonstrations, or pairs of an initial and a final scene.
        bits: the longest description of a rival, in bits.

    Returns:
        The intents, the simplest first. Those with the same number of bits are in the order of their texts.

    Raises:
        SettingsError: if `demonstrations` is empty or contains other objects.
        InvalidSceneError: if a pair is not of scenes with the same blocks and regions.
    """
    ends = [] if isinstance(demonstrations, str) else [ends_of(demonstration) for demonstration in demonstrations]
    if not ends:
        raise SettingsError(
            'rivals are computed from demonstrations, such as magical_mj.demos.load("FindDupe"), or pairs of scenes: '
            f"give at least one, not {short_repr(demonstrations)}"
        )
    table = _table(bits)
    at_starts = np.array([_truths(table, start, start) for start, _ in ends])  # (episodes, kinds, selectors)
    at_ends = np.logical_and.reduce([_truths(table, start, end) for start, end in ends])  # (kinds, selectors)
    own = table.kind, table.selector
    single = ~table.with_others & at_ends[own] & ~at_starts[:, *own].any(axis=0)
    found = [Intent((table.conjuncts[number],)) for number in np.flatnonzero(single)]
    found += _pairs(table, at_starts, at_ends, bits)
    return sorted(found, key=lambda intent: (intent.bits, str(intent)))


def explain(initial: Scene, final: Scene, bits: float = 24.0) -> list[Intent]:
    """The intents that hold at the end of an episode and not at its start.

    Goals about what moved come first, and those about blocks that did not move last; the simplest first among each.
    """
    check_same_objects(initial, final)
    moved = set(moved_blocks(initial, final))
    drove = math.hypot(initial.robot.x - final.robot.x, initial.robot.y - final.robot.y) > STAYED

    def unmoved(intent: Intent) -> int:
        """0 if all blocks of the intent's relations moved, 1 if some did, 2 if none of one relation's did."""
        worst = 0
        parts = intent.blocks(initial), intent.parts(initial, initial)
        for conjunct, blocks, before in zip(intent.conjuncts, *parts, strict=True):
            if keeps(conjunct) and all(before):
                continue
            if conjunct.definition.of_blocks:
                judged = set(conjunct.judged(blocks, initial))
                about = judged & moved
                worst = max(worst, 2 if not about else int(about != judged))
            elif not drove:
                worst = 2
        return worst

    return sorted(rivals([(initial, final)], bits), key=unmoved)


def ends_of(demonstration: HasScenes | Ends) -> Ends:
    """The initial and the final scene of a demonstration."""
    if isinstance(demonstration, tuple) and len(demonstration) == 2:
        check_same_objects(*demonstration)
        return demonstration
    if not isinstance(demonstration, HasScenes):
        raise SettingsError(f"{short_repr(demonstration)} is neither a demonstration nor a pair of scenes")
    scenes = demonstration.scenes()
    return scenes[0], scenes[-1]


class Judge:
    """Decides which of some intents an episode has reached. Intents of the form of rivals are judged all at once."""

    def __init__(self, intents: Sequence[Intent]) -> None:
        self.intents = tuple(intents)
        together = np.array([_is_like_rivals(intent) for intent in self.intents], np.bool_)
        self._together, self._alone = np.flatnonzero(together), np.flatnonzero(~together)
        likes = [self.intents[number] for number in self._together]
        distinct = {one for intent in likes for one in intent.conjuncts}
        conjuncts = sorted(distinct, key=lambda one: one.selector == REST)
        used = {one.selector for one in conjuncts if one.definition.of_blocks and one.selector != REST}
        self._table = _table_of(conjuncts, sorted(used) or [ALL])
        number_of = {conjunct: number for number, conjunct in enumerate(conjuncts)}
        pairs = [sorted((number_of[intent.conjuncts[0]], number_of[intent.conjuncts[-1]])) for intent in likes]
        one, two = np.array(pairs, np.int64).reshape(-1, 2).T  # conjuncts with the selector `others` are second
        self._one, self._two = self._table.positions(one, one), self._table.positions(one, two)

    def reached(self, initial: Scene, final: Scene) -> Flags:
        """Which intents the episode has reached at its end, and not at its start. Shape (intents,)."""
        return self.holds(initial, final) & ~self.holds(initial, initial)

    def holds(self, initial: Scene, final: Scene) -> Flags:
        """Which intents hold in the final scene, and apply to an object in the initial one. Shape (intents,)."""
        reached = np.zeros(len(self.intents), np.bool_)
        alone = [self.intents[number] for number in self._alone]
        reached[self._alone] = [intent.grounded(initial) and intent.holds(initial, final) for intent in alone]
        truths = _truths(self._table, initial, final)
        reached[self._together] = truths[self._one] & truths[self._two]
        return reached


def _is_like_rivals(intent: Intent) -> bool:
    """Whether an intent has at most two conjuncts, of the kinds that rivals have."""

    def fits(conjunct: Conjunct) -> bool:
        if conjunct.relation == "clustered":
            return conjunct.selector == ALL
        return conjunct.selector != REST or conjunct.definition.each is not None

    return len(intent.conjuncts) <= 2 and all(map(fits, intent.conjuncts))


class _Table(NamedTuple):
    """Conjuncts, and the positions of their truth values in the arrays of `_truths`.

    A kind is a conjunct without its selector, or with the selector `others`. The truth of the latter depends on the
    selector of the other conjunct.
    """

    conjuncts: tuple[Conjunct, ...]
    bits: NDArray[np.float64]
    with_others: Flags  # whether a conjunct has the selector `others`
    kinds: tuple[Conjunct, ...]
    selectors: tuple[Selector, ...]
    kind: NDArray[np.int64]  # the index of each conjunct's kind
    selector: NDArray[np.int64]  # the index of its selector; -1 for `others` and the robot (any index is right)

    def positions(self, first: int | NDArray[np.int64], second: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
        """The positions of the second conjuncts of some pairs."""
        selector = np.where(self.with_others[second], self.selector[first], self.selector[second])
        return self.kind[second], selector


@lru_cache(maxsize=8)
def _table(bits: float) -> _Table:
    return _table_of([one for one in all_conjuncts() if intent_bits([one]) <= bits], _selectors())


def _table_of(conjuncts: Sequence[Conjunct], selectors: Sequence[Selector]) -> _Table:
    kinds = [one if one.selector == REST else replace(one, selector=ALL) for one in conjuncts]
    kind_of = {kind: number for number, kind in enumerate(dict.fromkeys(kinds))}
    selector_of = {selector: number for number, selector in enumerate(selectors)}
    of = [selector_of.get(one.selector, -1) if one.definition.of_blocks else -1 for one in conjuncts]
    return _Table(
        tuple(conjuncts),
        np.array([conjunct_bits(one) for one in conjuncts]),
        np.array([one.selector == REST for one in conjuncts], np.bool_),
        tuple(kind_of),
        tuple(selectors),
        np.array([kind_of[kind] for kind in kinds], np.int64),
        np.array(of, np.int64),
    )


@lru_cache(maxsize=1)
def _selectors() -> tuple[Selector, ...]:
    """All selectors except `others`."""
    tests: dict[str, list[Test]] = {}
    for name, values in VALUES.items():
        signs = (True, False) if name in NEGATABLE else (True,)
        tests[name] = [Test(name, value, equal) for value in values for equal in signs]
    singles = [(test,) for group in tests.values() for test in group]
    return (ALL, *singles, *(pair for one, two in PAIRS for pair in itertools.product(tests[one], tests[two])))


def all_conjuncts() -> Iterable[Conjunct]:
    """All conjuncts in canonical form. With `others`, only those that also hold if no block is selected."""
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


def _truths(table: _Table, initial: Scene, final: Scene) -> Flags:
    """Whether conjuncts hold, by kind and selector, shape (kinds, selectors). False if one applies to no object."""
    masks = np.zeros((len(table.selectors), len(initial.blocks)), np.bool_)
    valid = np.ones(len(table.selectors), np.bool_)
    for number, selector in enumerate(table.selectors):
        try:
            masks[number, list(selected(selector, initial))] = True
        except UngroundedError:
            valid[number] = False
    truths = [_of_selectors(kind, masks, valid, initial, final) for kind in table.kinds]
    return np.array(truths, np.bool_).reshape(-1, len(valid))


def _of_selectors(kind: Conjunct, masks: Flags, valid: Flags, initial: Scene, final: Scene) -> Flags:
    """Whether a conjunct holds with each selector, shape (selectors,).

    Args:
        kind: the conjunct; with `others`, each selector is the other conjunct's.
        masks: the selected blocks, shape (selectors, blocks).
        valid: whether each selector is defined in the initial scene.
        initial: the initial scene.
        final: the final scene.
    """
    relation = kind.definition
    if relation.each is not None:
        return _of_each(kind, relation.each, ~masks if kind.selector == REST else masks, initial, final) & valid
    if not relation.of_blocks or kind.relation == "clustered":
        return np.full(len(valid), _all(kind.parts, kind.blocks(initial), initial, final))
    unique, position = np.unique(masks, axis=0, return_inverse=True)
    together = np.zeros(len(unique), np.bool_)
    for number, mask in enumerate(unique):
        blocks = tuple(np.flatnonzero(mask).tolist())
        if len(blocks) >= max(relation.least, kind.number):
            together[number] = _all(relation.together, kind, blocks, initial, final)
    return together[position.reshape(-1)] & valid


def _of_each(kind: Conjunct, each: Each, masks: Flags, initial: Scene, final: Scene) -> Flags:
    try:
        flags = each(kind.argument, initial, final)
    except UngroundedError:
        return np.zeros(len(masks), np.bool_)
    is_judged = np.array([flag is not None for flag in flags], np.bool_)
    true = np.array([bool(flag) for flag in flags], np.bool_)
    judged = masks & is_judged
    holds = (judged & true).any(axis=1) if kind.any_of else (true | ~judged).all(axis=1)
    return np.logical_and(holds, judged.any(axis=1))


def _all(parts: Callable[..., Iterable[bool]], *about: object) -> bool:
    """Whether a conjunct holds for all objects. False if it is undefined in the scene."""
    try:
        return all(parts(*about))
    except UngroundedError:
        return False


def _pairs(table: _Table, at_starts: Flags, at_ends: Flags, bits: float) -> list[Intent]:
    """The consistent intents of two conjuncts, from the truth values at the starts of episodes and at all ends."""
    kept = np.flatnonzero(~table.with_others & at_ends[table.kind, table.selector])
    others = np.flatnonzero(table.with_others)
    found = []
    for number, first in enumerate(kept.tolist()):
        seconds = np.concatenate([kept[number + 1 :], others if table.selector[first] >= 0 else others[:0]])
        kind, selector = table.positions(first, seconds)
        start = at_starts[:, table.kind[first], table.selector[first], None]
        new = ~(start & at_starts[:, kind, selector]).any(axis=0)
        short = intent_bits(()) + table.bits[first] + table.bits[seconds] <= bits
        found += [
            (table.conjuncts[first], table.conjuncts[second])
            for second in seconds[at_ends[kind, selector] & new & short]
        ]
    return [intent_of([*pair]) for pair in found if not implies(*pair) and not implies(*pair[::-1])]
