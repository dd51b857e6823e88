"""Conjuncts that follow from others, as far as their form decides it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from magical_mj.intents.relations import ANY, Conjunct
from magical_mj.intents.selectors import REGION, REST, Selector, Test


def without_repetition(conjuncts: Sequence[Conjunct]) -> list[Conjunct]:
    """The conjuncts without those that follow from others in every scene. The rest holds in the same scenes."""
    kept = list(dict.fromkeys(conjuncts))
    with_others = any(conjunct.selector == REST for conjunct in kept)

    def makes_redundant(other: Conjunct, conjunct: Conjunct) -> bool:
        if with_others and not narrower(conjunct.selector, other.selector):
            return False  # without the conjunct, `others` would select more blocks
        return implies(other, conjunct) and _applies_where(conjunct, other)

    for conjunct in sorted(kept, key=str):
        rest = [other for other in kept if other != conjunct]
        if any(makes_redundant(other, conjunct) for other in rest):
            kept = rest
    return kept


def implies(one: Conjunct, other: Conjunct) -> bool:
    """Whether the form of two conjuncts shows that the other holds if one does, in scenes where both apply."""
    relation = one.definition
    if (one.relation, other.relation) == ("exactly", "in"):
        return other.any_of and other.argument == REGION and narrower(one.selector, other.selector)
    if (one.relation, other.relation) == ("corner", "near corner"):
        one = replace(one, relation="near corner")
    if one.relation != other.relation or one.number != other.number or REST in (one.selector, other.selector):
        return False
    if one.argument != other.argument and (
        other.argument != ANY or one.relation not in ("wall", "corner", "robot wall")
    ):
        return False
    if relation.each is None:
        return not relation.of_blocks
    if other.any_of:
        return narrower(one.selector, other.selector)
    return not one.any_of and narrower(other.selector, one.selector)


def narrower(one: Selector, other: Selector) -> bool:
    """Whether all blocks of one selector are also blocks of the other, in every scene. True if both are equal."""
    if one == other:
        return True
    if REST in (one, other):
        return False
    return all(any(_passes(test, wider) for test in one) for wider in other)


def _passes(test: Test, wider: Test) -> bool:
    """Whether every block that passes a test also passes a wider one."""
    if test == wider:
        return True
    if test.name != wider.name:
        return False
    match test.name:
        case "colour" | "shape":
            return (
                test.equal and not wider.equal and test.value != wider.value and REGION not in (test.value, wider.value)
            )
        case "like":
            strict, loose = (test, wider) if test.equal else (wider, test)
            return test.equal == wider.equal and strict.value == "both" and loose.value != "both"
        case "starts":
            return wider.value == "in" and test.value in ("matched", "mismatched")
        case _:
            return False


def _applies_where(conjunct: Conjunct, other: Conjunct) -> bool:
    """Whether a conjunct that follows from another one applies to an object in every scene where the other does."""
    if conjunct.selector == other.selector or conjunct.any_of:
        return True
    plain = all(test.name in ("colour", "shape") and test.value != REGION for test in conjunct.selector)
    return plain and conjunct.definition.least == 0
