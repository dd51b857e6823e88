"""Intents in English: a sentence for each, and others that say the same."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from magical_mj.intents.relations import ANY, HOME, Conjunct
from magical_mj.intents.selectors import ALL, REGION, REST, ROBOT, Selector, names_one
from magical_mj.scene.constants import SHAPES
from magical_mj.tasks.spec import as_sentence

NUMBERS: Final = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
MOST_PARAPHRASES: Final = 12
AT_START: Final = "at the start"
KEPT: Final = "kept"
PLACE: Final = "REGION"
"""Stands for the region until the whole intent is known."""
WITHOUT_MODEL: Final = "not counting that block"
LONG: Final = (" that ", " whose ", " nearest ", " farthest ")
"""Words of descriptions that come last in a clause, since "all blocks that are not stars next to ..." is ambiguous."""
CLAUSES: Final[dict[str, tuple[str, ...]]] = {
    "in": ("bring {blocks} into {region}", "put {blocks} in {region}", "move {blocks} into {region}"),
    HOME: ("keep {blocks} in the region where {they} started", "leave {blocks} in the region where {they} started"),
    KEPT: ("keep {blocks} in {region}", "let {region} still contain {blocks}"),
    "out": ("make sure that {blocks} {are} outside all regions", "let no region contain {any}"),
    "exactly": (
        "have {blocks} in the region",
        "let the region contain {blocks}",
        "see to it that {blocks} {are} in the region",
    ),
    "wall": ("push {blocks} to {wall}", "move {blocks} to {wall}"),
    "corner": ("push {blocks} into {corner}", "move {blocks} into {corner}"),
    "near corner": ("push {blocks} close to {corner}", "move {blocks} near {corner}"),
    "near": ("bring {blocks} next to the {reference}", "put {blocks} close to the {reference}"),
    "apart": ("move {blocks} apart", "spread out {blocks}"),
    "line": ("arrange {blocks} in a line", "line up {blocks}"),
    "clustered": ("sort {blocks} into clusters by {argument}", "gather {blocks} into groups of the same {argument}"),
    "untouched": ("leave {blocks} where {they} {are}", "do not move {any}"),
    "robot in": ("drive into the region", "park in the region"),
    "robot near": ("drive next to the {reference}", "park next to the {reference}"),
    "robot wall": ("drive to {wall}", "park at {wall}"),
}
"""Relation -> clauses that ask for it, the usual one first."""
_TRANSPORT: Final = ("carry", "get", "take", "shove", "drag")
_STAY: Final = ("retain", "hold", "maintain", "preserve", "secure")
_TRAVEL: Final = ("go", "move", "steer", "roll", "travel")
VERBS: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "in": ("{blocks} into {region}", _TRANSPORT),
    HOME: ("{blocks} in the region where {they} started", _STAY),
    KEPT: ("{blocks} in {region}", _STAY),
    "out": ("{blocks} out of all regions", ("get", "keep", "take", "carry", "clear")),
    "exactly": ("{blocks} in the region", ("assemble", "collect", "gather", "place", "put")),
    "wall": ("{blocks} to {wall}", _TRANSPORT),
    "corner": ("{blocks} into {corner}", _TRANSPORT),
    "near corner": ("{blocks} close to {corner}", _TRANSPORT),
    "near": ("{blocks} next to the {reference}", _TRANSPORT),
    "apart": ("{blocks} apart from each other", ("push", "pull", "shove", "drag", "carry")),
    "line": ("{blocks} in a line", ("put", "place", "lay", "set", "position")),
    "clustered": ("{blocks} into clusters by {argument}", ("gather", "push", "move", "collect", "group")),
    "untouched": ("{blocks} where {they} {are}", ("keep", "retain", "hold", "maintain", "preserve")),
    "robot in": ("into the region", _TRAVEL),
    "robot near": ("next to the {reference}", _TRAVEL),
    "robot wall": ("to {wall}", _TRAVEL),
}
"""Relation -> a clause without its verb, and five other verbs."""
STATES: Final[dict[str, str]] = {
    "in": "{blocks} {are} in {region}",
    HOME: "{blocks} {are} in the region where {they} started",
    KEPT: "{blocks} {are} still in {region}",
    "out": "{blocks} {are} outside all regions",
    "exactly": "{blocks} {are} in the region",
    "wall": "{blocks} {are} at {wall}",
    "corner": "{blocks} {are} in {corner}",
    "near corner": "{blocks} {are} close to {corner}",
    "near": "{blocks} {are} next to the {reference}",
    "apart": "{blocks} {are} apart from each other",
    "line": "{blocks} {are} in a line",
    "clustered": "{blocks} {are} in clusters by {argument}",
    "untouched": "{blocks} {are} where {they} started",
    "robot in": "the robot is in the region",
    "robot near": "the robot is next to the {reference}",
    "robot wall": "the robot is at {wall}",
}
"""Relation -> the state that fulfils it."""
FRAMES: Final = (
    ("see to it that {}", "make it so that {}", "make certain that {}", "arrange things so that {}", "act so that {}"),
    ("in the end, {}", "when you stop, {}", "you are done when {}", "the goal is that {}", "continue until {}"),
    (
        "what counts is that {}",
        "one thing is wanted: {}",
        "success means that {}",
        "only this matters: {}",
        "imagine the last picture: {}",
    ),
)
NOUNS: Final = {
    "blocks": "objects", "block": "object", "region": "zone", "regions": "zones", "region's": "zone's",
    "wall": "border", "walls": "borders", "corner": "nook", "corners": "nooks", "robot": "vehicle",
    "clusters": "groups", "square": "box", "squares": "boxes", "circle": "disc", "circles": "discs",
}  # fmt: skip
TINTS: Final = {"red": "crimson", "green": "emerald", "blue": "azure", "yellow": "golden"}


def paraphrases_of(conjuncts: Sequence[Conjunct]) -> tuple[str, ...]:
    """Different sentences that ask for all of the conjuncts, the usual one first.

    The blocks to leave where they are come last, and so do the other blocks.
    """
    clauses = [[_clause(one, text) for text in CLAUSES[_kind(one)]] for one in _ordered(conjuncts)]
    sentences = map(as_sentence, map(_joined, itertools.product(*_in_place(conjuncts, clauses))))
    return tuple(itertools.islice(dict.fromkeys(sentences), MOST_PARAPHRASES))


def wordings_of(conjuncts: Sequence[Conjunct]) -> tuple[tuple[str, ...], ...]:
    """Sentences with the same meaning for the five strengths of the shift `words`, five each.

    They have another verb (1), or say what should be the case (2, 3), also with other nouns (4) and colour words (5).
    """
    ordered = _ordered(conjuncts)
    verbs = [[_clause(one, f"{verb} {rest}") for verb in each] for one in ordered for rest, each in [VERBS[_kind(one)]]]
    asked = [_joined(parts) for parts in zip(*_in_place(conjuncts, verbs), strict=True)]
    states = [[_clause(one, STATES[_kind(one)])] for one in ordered]
    state = _joined([clause for (clause,) in _in_place(conjuncts, states)])
    said = [[frame.format(state) for frame in frames] for frames in FRAMES]
    groups = (asked, *said[:2], _renamed(said[1], NOUNS), _renamed(said[2], NOUNS | TINTS))
    return tuple(tuple(map(as_sentence, group)) for group in groups)


def _ordered(conjuncts: Sequence[Conjunct]) -> list[Conjunct]:
    return sorted(conjuncts, key=lambda one: (one.selector == REST, one.relation == "untouched"))


def _in_place(conjuncts: Sequence[Conjunct], clauses: Iterable[Sequence[str]]) -> list[list[str]]:
    """The clauses, in which a region is "a region" if the intent is about several, otherwise "the region"."""
    several = any(
        one.argument == HOME or any(test.value in ("matched", "mismatched") for test in one.selector)
        for one in conjuncts
    )
    return [[clause.replace(PLACE, "a region" if several else "the region") for clause in some] for some in clauses]


def _renamed(texts: Iterable[str], names: Mapping[str, str]) -> list[str]:
    return [re.sub(r"[a-z']+", lambda word: names.get(word[0], word[0]), text) for text in texts]


def _joined(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])}, and {parts[-1]}"


def _kind(conjunct: Conjunct) -> str:
    """The key of a conjunct in the tables of clauses."""
    starts_inside = any(test.name == "starts" and test.value != "out" for test in conjunct.selector)
    if conjunct.argument == HOME:
        return HOME
    return KEPT if conjunct.relation == "in" and starts_inside else conjunct.relation


def _clause(conjunct: Conjunct, clause: str) -> str:
    """A clause about one conjunct."""
    argument = conjunct.argument
    one = conjunct.any_of or names_one(conjunct.selector) or conjunct.number == 1
    one = one or not conjunct.definition.of_blocks
    blocks = _blocks(conjunct) if conjunct.definition.of_blocks else ""
    if any(word in blocks for word in LONG):
        clause = _blocks_last(clause)
    text = clause.format(
        argument=argument,
        blocks=blocks,
        any=re.sub("^all ", "any ", blocks),
        they="it" if one else "they",
        are="is" if one else "are",
        wall=_side(argument, "wall", one=one),
        corner=_side(argument, "corner", one=one),
        reference=reference(argument),
        region=PLACE,
    )
    return re.sub(rf"({WITHOUT_MODEL}) (?=\w)", r"\1, ", text)


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
    return f"at least one {kind}" if conjunct.any_of else f"all {kind}"


def _side(name: str, kind: str, *, one: bool) -> str:
    if name == ANY:
        return f"a {kind}" if one else f"{kind}s"
    return f"the {name} {kind}"


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
                about.append(_like(value, equal=equal))
            case "starts", _:
                clauses.append(f"{start} {_began(value, 'their' if plural else 'its')}")
            case "odd", _:
                about.append(f"whose {value} differs from that of all others")
            case _:
                about.append(
                    f"{test.name} {'to' if test.name == 'nearest' else 'from'} the {reference(value)} {AT_START}"
                )
    return " ".join([*before, name, *about, *(["that", " and ".join(clauses)] if clauses else [])])


def _like(value: str, *, equal: bool) -> str:
    what = value
    if value == "both":
        what = "colour and shape" if equal else "colour or shape"
    model = "the block that starts in the region"
    return f"of the same {what} as {model}, {WITHOUT_MODEL}" if equal else f"of another {what} than {model}"


def _began(value: str, own: str) -> str:
    return {
        "in": "in a region",
        "out": "outside the regions",
        "matched": f"in a region of {own} own colour",
        "mismatched": "in a region of another colour",
    }[value]
