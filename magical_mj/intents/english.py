"""Intents in English: a sentence for each, and others that say the same."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from typing import Final

from magical_mj.intents.relations import ANY, HOME, Conjunct
from magical_mj.intents.selectors import ALL, REGION, REST, ROBOT, Selector, names_one
from magical_mj.scene.constants import SHAPES

NUMBERS: Final = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
MOST_PARAPHRASES: Final = 12
KEPT: Final = "kept"
LONG: Final = (" that ", " whose ", " nearest ", " farthest ")
"""Words of descriptions that come last in a clause, since "all blocks that are not stars next to ..." is ambiguous."""
CLAUSES: Final[dict[str, tuple[str, ...]]] = {
    "in": ("bring {blocks} into the region", "put {blocks} in the region", "move {blocks} into the region"),
    HOME: ("keep {blocks} in the region where {they} started", "leave {blocks} in the region where {they} started"),
    KEPT: ("keep {blocks} in the region", "let the region still contain {blocks}"),
    "out": ("make sure that {blocks} {are} outside all regions", "let no region contain {any}"),
    "exactly": (
        "have {blocks} in the region",
        "let the region contain {blocks}",
        "see to it that {blocks} {are} in the region",
    ),
    "wall": ("push {blocks} to {wall}", "move {blocks} to {wall}"),
    "corner": ("push {blocks} into {corner}", "move {blocks} into {corner}"),
    "near": ("bring {blocks} next to the {reference}", "put {blocks} close to the {reference}"),
    "apart": ("move {blocks} apart", "spread out {blocks}"),
    "line": ("arrange {blocks} in a line", "line up {blocks}"),
    "clustered": ("sort {blocks} into clusters by {argument}", "gather {blocks} into groups of the same {argument}"),
    "untouched": ("leave {blocks} where {they} {are}", "do not move {any}"),
    "robot in": ("drive into the region", "park in the region"),
    "robot near": ("drive next to the {reference}", "park next to the {reference}"),
    "robot wall": ("drive to {wall}", "park at {wall}"),
}
"""Relation -> clauses that say the same, the usual one first."""


def paraphrases_of(conjuncts: Sequence[Conjunct]) -> tuple[str, ...]:
    """Different sentences that ask for all of the conjuncts, the usual one first.

    The blocks to leave where they are come last.
    """
    ordered = sorted(conjuncts, key=lambda conjunct: conjunct.relation == "untouched")
    sentences = map(_joined, itertools.product(*map(_clauses, ordered)))
    return tuple(itertools.islice(dict.fromkeys(sentences), MOST_PARAPHRASES))


def _joined(parts: Sequence[str]) -> str:
    text = parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])}, and {parts[-1]}"
    return f"{text[:1].upper()}{text[1:]}."


def _clauses(conjunct: Conjunct) -> list[str]:
    """Clauses that ask for one conjunct, in different words."""
    argument = conjunct.argument
    one = conjunct.any_of or names_one(conjunct.selector) or conjunct.number == 1
    blocks = _blocks(conjunct) if conjunct.definition.of_blocks else ""
    words = {
        "argument": argument,
        "blocks": blocks,
        "any": re.sub("^all ", "any ", blocks),
        "they": "it" if one else "they",
        "are": "is" if one else "are",
        "wall": _side(argument, "wall"),
        "corner": _side(argument, "corner"),
        "reference": reference(argument),
    }
    starts_inside = any(test.name == "starts" and test.value != "out" for test in conjunct.selector)
    if argument == HOME:
        clauses = CLAUSES[HOME]
    elif conjunct.relation == "in" and starts_inside:
        clauses = CLAUSES[KEPT]
    else:
        clauses = CLAUSES[conjunct.relation]
    if any(word in words["blocks"] for word in LONG):
        clauses = map(_blocks_last, clauses)
    return [clause.format(**words) for clause in clauses]


def _blocks_last(clause: str) -> str:
    """The clause with the blocks at its end, unless it refers to them after naming them."""
    verb, blocks, rest = clause.partition("{blocks}")
    return clause if not rest or "{they}" in rest or "{are}" in rest else f"{verb}{rest.strip()} {blocks}"


def _blocks(conjunct: Conjunct) -> str:
    """The blocks that a conjunct selects, as the object of a sentence."""
    selector = conjunct.selector
    if conjunct.number:
        return f"exactly {NUMBERS[conjunct.number]} {noun(selector, plural=conjunct.number > 1)}"
    if names_one(selector):
        return f"the {noun(selector)}"
    kind = noun(selector, plural=not conjunct.any_of)
    words = conjunct.argument.split()
    plain = all(test.name in ("colour", "shape") and test.equal == (test.value in words) for test in selector)
    if conjunct.relation == "near" and plain:
        kind = f"other {kind}"
    return f"at least one {kind}" if conjunct.any_of else f"all {kind}"


def _side(name: str, kind: str) -> str:
    return f"a {kind}" if name == ANY else f"the {name} {kind}"


def reference(name: str) -> str:
    """A reference as a noun, such as "red star", "star" or "red block"."""
    return name if name.rpartition(" ")[2] in (REGION, ROBOT, *SHAPES) else f"{name} block"


def noun(selector: Selector, *, plural: bool = False) -> str:
    """The blocks of a selector, as a noun: "red star", "blocks that are not of the region's colour"."""
    s = "s" if plural else ""
    if selector in (ALL, REST):
        return f"{'other ' if selector == REST else ''}block{s}"
    before, name, about, clauses = [], f"block{s}", [], []
    are, start = ("are", "start") if plural else ("is", "starts")
    for test in selector:
        value = test.value
        match test.name, test.equal:
            case "colour", equal if value == REGION:
                about += ["of the region's colour"] if equal else []
                clauses += [] if equal else [f"{are} not of the region's colour"]
            case "colour", equal:
                before.append(value if equal else f"non-{value}")
            case "shape", True:
                name = f"{value}{s}"
            case "shape", False:
                clauses.append(f"{are} not {value}s" if plural else f"is not a {value}")
            case "like", equal:
                before += ["other"] if equal else []
                about.append(_like(value, equal=equal))
            case "starts", _:
                clauses.append(f"{start} {_began(value, 'their' if plural else 'its')}")
            case "odd", _:
                about.append(f"whose {value} differs from that of all others")
            case _:
                about.append(f"{test.name} {'to' if test.name == 'nearest' else 'from'} the {reference(value)}")
    return " ".join([*before, name, *about, *(["that", " and ".join(clauses)] if clauses else [])])


def _like(value: str, *, equal: bool) -> str:
    what = value
    if value == "both":
        what = "colour and shape" if equal else "colour or shape"
    model = "the block that starts in the region"
    return f"of the same {what} as {model}" if equal else f"of another {what} than {model}"


def _began(value: str, own: str) -> str:
    return {
        "in": "in a region",
        "out": "outside the regions",
        "matched": f"in a region of {own} own colour",
        "mismatched": "in a region of another colour",
    }[value]
