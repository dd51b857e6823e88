"""What an episode of one of the eight tasks pursued, as one sentence for the pages. pursued.js contains the same rules.

The rules are those of `magical_mj.intents.readings`: which blocks moved, which ones had to, and what the moved ones
have in common with those that the demonstrations move.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from magical_mj.intents import Intent
from magical_mj.intents.attribution import demonstrated_blocks
from magical_mj.intents.english import NUMBERS
from magical_mj.intents.names import EIGHT
from magical_mj.intents.readings import (
    AND_OTHERS,
    DemonstratedBlocks,
    ending,
    intended_blocks,
    moved_blocks,
    others_moved,
    readings,
)
from magical_mj.scene import Scene


@dataclass(frozen=True)
class Pursued:
    """What an episode pursued.

    Attributes:
        sentence: in English.
        moved: the blocks that moved and that the sentence names.
        intended: the blocks to move (one or all of them).
    """

    sentence: str
    moved: tuple[int, ...]
    intended: tuple[int, ...]


def demonstrated_data(task: str) -> dict[str, Any]:
    """The blocks that a task's demonstrations move, and the regions of their scene, as JSON data."""
    shown = demonstrated_blocks(task)
    models = [shown.scene.blocks[index] for index in shown.moved]
    return {
        "blocks": [{name: getattr(model, name) for name in ("shape", "colour", "x", "y")} for model in models],
        "regions": [{name: getattr(region, name) for name in region.__slots__} for region in shown.scene.regions],
    }


def pursued(task: str, initial: Scene, final: Scene, score: float) -> Pursued:
    """What an episode of one of the eight tasks pursued, by its first and last scene, and its score."""
    intent, shown = EIGHT[task], demonstrated_blocks(task)
    moved, wanted = moved_blocks(initial, final), tuple(sorted(intended_blocks(intent, initial)))
    kinds = ending(intent, shown, initial, final, solved=score == 1.0)
    if AND_OTHERS in kinds:
        also = _named(others_moved(intent, initial, final), initial)
        return Pursued(f"It did what was intended, and also moved {also}.", moved, wanted)
    if "intended" in kinds:
        return Pursued("It did what was intended.", moved, wanted)
    if not initial.blocks:
        return Pursued(f"{_driven(next(iter(kinds)))} Intended: the goal region.", (), ())
    right, wrong = [index for index in moved if index in wanted], [index for index in moved if index not in wanted]
    if right:
        also = f" It also moved {_named(wrong, initial, after=right)}." if wrong else ""
        words = f"It moved {_named(right, initial)}, as intended, but did not solve the task.{also}"
        return Pursued(words, moved, wanted)
    did = _reasons(wrong, shown, initial) if wrong else "It moved no block."
    return Pursued(f"{did} Intended: {_intended(intent, initial, wrong)}.", moved, wanted)


def _driven(kind: str) -> str:
    return {
        "nothing": "The robot stayed where it began.",
        "same place": "It drove to where the demonstrations' region was.",
    }.get(kind, "It drove elsewhere.")


def _reasons(wrong: Sequence[int], shown: DemonstratedBlocks, initial: Scene) -> str:
    """Which wrong blocks were moved, and what each of them has in common with the demonstrations' blocks."""
    by_reading = readings(shown, initial)
    model = "the demonstrations' block" if len(shown.moved) == 1 else "a block of the demonstrations"
    unlike = f"is unlike the demonstrations' block{'s' * (len(shown.moved) != 1)} in place, colour and shape"

    def reason(index: int) -> str:
        alike = {name for name, blocks in by_reading.items() if index in blocks}
        looks = [name for name in ("colour", "shape") if f"same {name}" in alike]
        parts = [f"began where {model} began"] if "same place" in alike else []
        parts += [f"has the {' and the '.join(looks)} of {model}"] if looks else []
        parts += ["was nearest to the robot"] if "nearest" in alike else []
        return ", and ".join(parts) or unlike

    if len(wrong) == 1:
        return f"It moved {_named(wrong, initial)}, which {reason(wrong[0])}."
    each = (f"{_named([index], initial).capitalize()} {reason(index)}." for index in wrong)
    return " ".join([f"It moved {_named(wrong, initial)}.", *dict.fromkeys(each)])


def _intended(intent: Intent, initial: Scene, moved: Sequence[int]) -> str:
    """The blocks to move in words, after those that moved: one of them if that is enough."""
    wanted = intended_blocks(intent, initial)
    names: list[str] = []
    for conjunct, blocks in zip(intent.conjuncts, intent.blocks(initial), strict=True):
        left = [index for index in conjunct.judged(blocks, initial) if index in wanted]
        names += [_named(left, initial, one=conjunct.any_of, after=moved)] if left else []
    return _joined(names) if names else "no block"


def _named(indices: Iterable[int], scene: Scene, *, one: bool = False, after: Iterable[int] = ()) -> str:
    """Some blocks in words: "the red star and two green squares". With `one`: one of each kind.

    Blocks that look like one of `after`, which are named before, are "another red star".
    """
    looks = [f"{block.colour} {block.shape}" for block in scene.blocks]
    chosen, named = [looks[index] for index in indices], {looks[index] for index in after}
    if len(chosen) == len(looks) > 2 and not one:
        return "all blocks"
    names = []
    for look in dict.fromkeys(chosen):
        count, total = 1 if one else chosen.count(look), looks.count(look)
        every = "the " if count == total else ""
        single = "another " if look in named else every or "a "
        names.append(f"{single}{look}" if count == 1 else f"{every}{NUMBERS[count]} {look}s")
    return _joined(names)


def _joined(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
