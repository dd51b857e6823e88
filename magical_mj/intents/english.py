"""Intents in English."""

from __future__ import annotations

from collections.abc import Sequence

from magical_mj.intents.relations import ANY, HOME, Conjunct
from magical_mj.intents.selectors import ALL, REGION, REST, Selector


def sentence_of(conjuncts: Sequence[Conjunct]) -> str:
    """One sentence that asks for all of the conjuncts."""
    parts = [_clause(conjunct) for conjunct in conjuncts]
    text = parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])}, and {parts[-1]}"
    return f"{text[:1].upper()}{text[1:]}."


def _clause(conjunct: Conjunct) -> str:  # noqa: C901  (a case for each relation)
    argument = conjunct.argument
    blocks = f"at least one {noun(conjunct.selector)}" if conjunct.some else some_blocks(conjunct.selector)
    match conjunct.relation:
        case "in":
            return (
                f"bring {blocks} {'back into the region where each began' if argument == HOME else 'into the region'}"
            )
        case "out":
            return f"keep {blocks} out of all regions"
        case "exactly":
            return f"bring exactly {conjunct.number} of {blocks} into the region"
        case "wall":
            return f"push {blocks} to {_side(argument, 'wall')}"
        case "corner":
            return f"push {blocks} into {_side(argument, 'corner')}"
        case "near":
            return f"bring {blocks} next to the {reference(argument)}"
        case "apart":
            return f"spread {blocks} apart from each other"
        case "line":
            return f"arrange {blocks} in a line"
        case "clustered":
            return f"sort {blocks} into clusters by {argument}"
        case "untouched":
            return f"leave {blocks} where they are"
        case "robot in":
            return "drive into the region"
        case "robot near":
            return f"drive next to the {reference(argument)}"
        case _:
            return f"drive to {_side(argument, 'wall')}"


def _side(name: str, kind: str) -> str:
    return f"a {kind}" if name == ANY else f"the {name} {kind}"


def reference(name: str) -> str:
    """What a reference names, such as "red star", "star" or "red block"."""
    words = name.split()
    return (
        name
        if name in ("region", "robot") or words[-1] in ("square", "pentagon", "star", "circle")
        else f"{name} block"
    )


def some_blocks(selector: Selector) -> str:
    """The blocks that a selector means, as an object of a sentence."""
    if selector == ALL:
        return "all blocks"
    if selector == REST:
        return "all other blocks"
    if selector[0].name in ("odd", "nearest", "farthest"):
        return f"the {noun(selector)}"
    return f"all {noun(selector, plural=True)}"


def noun(selector: Selector, *, plural: bool = False) -> str:
    """The blocks that a selector means, as a noun: "red star", "blocks of another colour than the region"."""
    s = "s" if plural else ""
    if selector in (ALL, REST):
        return f"{'other ' if selector == REST else ''}block{s}"
    before, name, after = [], f"block{s}", []
    for test in selector:
        value = test.value
        match test.name, test.equal:
            case "colour", True if value != REGION:
                before.append(value)
            case "colour", False if value != REGION:
                before.append(f"non-{value}")
            case "colour", _:
                after.append(
                    f"of {'the' if test.equal else 'another'} colour {'of' if test.equal else 'than'} the region"
                )
            case "shape", True:
                name = f"{value}{s}"
            case "shape", False:
                after.append(f"that {'are' if plural else 'is'} not {value}s" if plural else f"that is not a {value}")
            case "like", equal:
                what = "colour and shape" if value == "both" else value
                kind = f"with the {what}" if equal else f"without the {what}"
                before.append("other")
                after.append(f"{kind} of the block that starts in the region")
            case "starts", _:
                after.append(_began(value, plural=plural))
            case "odd", _:
                after.append(f"whose {value} differs from all others")
            case _:
                after.append(f"{test.name} {'to' if test.name == 'nearest' else 'from'} the {reference(value)}")
    return " ".join([*before, name, *after])


def _began(value: str, *, plural: bool) -> str:
    start = "start" if plural else "starts"
    return {
        "in": f"that {start} in a region",
        "out": f"that {start} outside of the regions",
        "matched": f"that {start} in a region of {'their' if plural else 'its'} own colour",
        "mismatched": f"that {start} in a region of another colour",
    }[value]
