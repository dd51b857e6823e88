"""Intents: goals over scenes as immutable data, with text, truth value, score and description length."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NoReturn

from magical_mj.intents.canonical import without_repetition
from magical_mj.intents.english import paraphrases_of, wordings_of
from magical_mj.intents.relations import ANY, RELATIONS, Conjunct
from magical_mj.intents.selectors import (
    ALL,
    NEGATABLE,
    OTHERS,
    PAIRS,
    REST,
    VALUES,
    Selector,
    Test,
    UngroundedError,
    names_one,
)
from magical_mj.scene import Scene, check_same_objects
from magical_mj.tasks.languages import canonical_name, language_spec
from magical_mj.tasks.spec import TaskSpec
from magical_mj.utils.errors import IntentError, short_repr

MOST_CONJUNCTS: Final = 3
LONGEST: Final = 1_000
"""The largest number of characters of an intent's text. Canonical texts have 200 at most."""
_CONJUNCT: Final = re.compile(r"\s*([a-z]+(?: [a-z]+)?)\s*\(([^()]*)\)\s*")
_TEST: Final = re.compile(r"([a-z]+)\s*(!?=)\s*([a-z]+(?: [a-z]+)?)")


@dataclass(frozen=True)
class Intent:
    """One to three conjuncts, which must all hold when the episode ends.

    Make one with `parse`. `str` gives the canonical text: conjuncts in the order of `RELATIONS`, without those that
    follow from others in every scene, such as `in(any, all, region)` from `in(all, region)`.
    """

    conjuncts: tuple[Conjunct, ...]

    def __str__(self) -> str:
        return " & ".join(map(str, self.conjuncts))

    def holds(self, initial: Scene, final: Scene) -> bool:
        """Whether every conjunct holds for every object. False if one is undefined in the initial scene."""
        return self.share(initial, final) == 1.0

    def score(self, initial: Scene, final: Scene) -> float:
        """How much of the intent was reached, in [0, 1]: 1 if and only if it holds.

        It is the increase of `share` from the initial to the final scene, divided by the largest possible increase. A
        decrease scores 0.
        """
        now, before = self.share(initial, final), self.share(initial, initial)
        if now == 1.0:
            return 1.0
        if before == 1.0:
            return 0.0
        return max(0.0, (now - before) / (1.0 - before))

    def share(self, initial: Scene, final: Scene) -> float:
        """The mean of the conjuncts' shares (`share_of`). 0 if a conjunct is undefined in the initial scene.

        Raises:
            InvalidSceneError: if the final scene has other blocks or regions.
        """
        if final is not initial:
            check_same_objects(initial, final)
        try:
            shares = [share_of(parts) for parts in self.parts(initial, final)]
        except UngroundedError:
            return 0.0
        return sum(shares) / len(shares) if min(shares) < 1.0 else 1.0

    def parts(self, initial: Scene, final: Scene) -> list[list[bool]]:
        """For each conjunct, whether it holds for each object that it applies to.

        Raises:
            UngroundedError: if a conjunct is undefined in the initial scene.
        """
        chosen = self.blocks(initial)
        return [conjunct.parts(blocks, initial, final) for conjunct, blocks in zip(self.conjuncts, chosen, strict=True)]

    def blocks(self, initial: Scene) -> list[tuple[int, ...]]:
        """For each conjunct, the blocks that it selects.

        Raises:
            UngroundedError: if a selector is undefined in the initial scene.
        """
        chosen = [conjunct.blocks(initial) for conjunct in self.conjuncts]
        named = set(itertools.chain(*chosen))
        others = tuple(index for index in range(len(initial.blocks)) if index not in named)
        pairs = zip(self.conjuncts, chosen, strict=True)
        return [others if conjunct.selector == REST else blocks for conjunct, blocks in pairs]

    def grounded(self, initial: Scene) -> bool:
        """Whether every conjunct applies to at least one block, or the robot, in the initial scene."""
        try:
            return all(self.parts(initial, initial))
        except UngroundedError:
            return False

    @cached_property
    def bits(self) -> float:
        """The description length in bits, of the number of conjuncts and of the relation and arguments of each."""
        return intent_bits(self.conjuncts)

    def spec(self, seed: int = 0, demos: int = 1, contrasting: bool = False) -> TaskSpec:
        """The intent as a task. The name of this task is `"intent:"` and the intent's text, with these settings.

        Args:
            seed: the seed of the demo scenes.
            demos: the number of demo scenes, 1 to 8.
            contrasting: choose each further demo scene so that it refutes as many of the simplest rivals as possible,
                instead of drawing it as Layout and Colour do. Needs at least two.

        Raises:
            IntentError: if a setting is invalid, no scene was found for the intent, or it is of a subclass.
        """
        if type(self) is not Intent:
            raise IntentError(
                f"the task of an intent is what its text says, and {type(self).__name__} may mean something else: make "
                "a TaskSpec with its score, as docs/adding-a-task.md shows"
            )
        settings = f"seed={seed}, demos={demos}{', contrasting' if contrasting else ''}"
        return language_spec(canonical_name(f"intent:{self} [{settings}]"))

    @property
    def sentence(self) -> str:
        """The intent in English: "Bring all red blocks into the region, and leave all other blocks where they are."."""
        return self.paraphrases[0]

    @property
    def paraphrases(self) -> tuple[str, ...]:
        """Sentences with the same meaning, up to twelve; `sentence` is the first."""
        return paraphrases_of(self.conjuncts)

    @property
    def wordings(self) -> tuple[tuple[str, ...], ...]:
        """Other sentences with the same meaning, five for each strength of the shift `words`."""
        return wordings_of(self.conjuncts)


def share_of(parts: list[bool]) -> float:
    """The share of true values: of the objects that a conjunct holds for. 1 if the list is empty."""
    return sum(parts) / len(parts) if parts else 1.0


def intent_bits(conjuncts: Sequence[Conjunct]) -> float:
    """The description length of these conjuncts together."""
    return math.log2(MOST_CONJUNCTS) + sum(map(conjunct_bits, conjuncts))


def conjunct_bits(conjunct: Conjunct) -> float:
    """The description length of one conjunct."""
    relation = conjunct.definition
    bits = math.log2(len(RELATIONS)) + math.log2(len(relation.arguments)) + (1.0 if relation.quantified else 0.0)
    if conjunct.relation == "exactly":
        bits += 2.0
    return bits + (selector_bits(conjunct.selector) if relation.of_blocks else 0.0)


def selector_bits(selector: Selector) -> float:
    """The description length of a selector: one of four forms (all, others, one test, two), then its tests."""
    bits = 2.0
    if selector in (ALL, REST):
        return bits
    bits += math.log2(len(VALUES)) if len(selector) == 1 else math.log2(len(PAIRS))
    return bits + sum(math.log2(len(VALUES[test.name])) + (test.name in NEGATABLE) for test in selector)


def parse(text: str) -> Intent:
    """The intent that a text describes; see the module `magical_mj.intents` for the language.

    Raises:
        IntentError: if the text is not an intent. The message shows the position of the error.
    """
    if not isinstance(text, str):
        raise IntentError(f"an intent is a text such as 'in(colour=red, region)', not {short_repr(text)}")
    if len(text) > LONGEST:
        raise IntentError(f"an intent has at most {LONGEST:,} characters, and this text has {len(text):,}")
    conjuncts: list[Conjunct] = []
    at = 0
    while True:
        found = _CONJUNCT.match(text, at)
        if found is None:
            known = f"in(colour=red, region); the relations are {', '.join(RELATIONS)}"
            _fail(text, at, f"a relation with its arguments in brackets, such as {known}")
        conjuncts.append(_conjunct(text, found))
        at = found.end()
        if at == len(text):
            return intent_of(conjuncts)
        if text[at] != "&":
            _fail(text, at, "& and another relation, or the end")
        at += 1


def intent_of(conjuncts: list[Conjunct]) -> Intent:
    """The intent of these conjuncts, in canonical form.

    Raises:
        IntentError: if there are too many, or if `others` is used alone, or together with a selector of all blocks.
    """
    order = list(RELATIONS)
    single = [replace(one, any_of=one.any_of and not names_one(one.selector)) for one in conjuncts]
    kept = sorted(without_repetition(single), key=lambda one: (order.index(one.relation), str(one)))
    if len(kept) > MOST_CONJUNCTS:
        raise IntentError(f"an intent has at most {MOST_CONJUNCTS} relations, and this has {len(kept)}")
    naming = [one.selector for one in kept if one.definition.of_blocks and one.selector != REST]
    with_others = any(one.selector == REST for one in kept)
    if with_others and not naming and len(kept) > 1:  # no other conjunct selects blocks, so `others` are all blocks
        return intent_of([replace(one, selector=ALL) for one in kept])
    if with_others and (len(kept) == 1 or ALL in naming):
        why = "another relation selects all blocks" if ALL in naming else "add a relation that selects some"
        raise IntentError(f"others are the blocks that no other relation of the intent selects: {why}")
    return Intent(tuple(kept))


def _fail(text: str, at: int, wanted: str) -> NoReturn:
    raise IntentError(f"{text}\n{' ' * at}^ here should be {wanted}")


def _conjunct(text: str, found: re.Match[str]) -> Conjunct:
    """The conjunct of a match of `_CONJUNCT`."""
    name, at = found[1], found.start(2)
    if name not in RELATIONS:
        _fail(text, found.start(1), f"a relation: {', '.join(RELATIONS)}")
    relation, parts = RELATIONS[name], _parts(found[2], at)
    conjunct = Conjunct(name)
    if name == "exactly":
        if not parts or not re.fullmatch("[1-9]", parts[0][0]):
            _fail(text, at, "a number from 1 to 9")
        conjunct = replace(conjunct, number=int(parts.pop(0)[0]))
    if relation.quantified and parts and parts[0][0] == ANY and len(parts) > 1:
        conjunct, parts = replace(conjunct, any_of=True), parts[1:]
    if relation.arguments != ("",):
        word, position = parts.pop() if parts else ("", found.end(2))
        value = word.removeprefix(relation.prefix).strip()
        if value not in relation.arguments or not word.startswith(relation.prefix):
            _fail(text, position, f"one of {', '.join(relation.prefix + value for value in relation.arguments)}")
        conjunct = replace(conjunct, argument=value)
    if not relation.of_blocks:
        if parts:
            _fail(text, parts[0][1], "the end of the brackets")
        return conjunct
    return replace(conjunct, selector=_selector(text, parts, found.end(2)))


def _parts(inner: str, start: int) -> list[tuple[str, int]]:
    """The arguments in brackets, each with its position in the text."""
    parts, at = [], start
    for part in inner.split(","):
        if part.strip():
            parts.append((" ".join(part.split()), at + len(part) - len(part.lstrip())))
        at += len(part) + 1
    return parts


def _selector(text: str, parts: list[tuple[str, int]], end: int) -> Selector:
    """The selector that these arguments describe."""
    if not parts:
        _fail(text, end, f"which blocks: all, {OTHERS}, or tests such as colour=red")
    if len(parts) == 1 and parts[0][0] in ("all", OTHERS):
        return ALL if parts[0][0] == "all" else REST
    tests = []
    for word, at in parts:
        found = _TEST.fullmatch(word)
        if found is None or found[1] not in VALUES:
            _fail(text, at, f"all, {OTHERS}, or a test such as colour=red, by {', '.join(VALUES)}")
        name, value, equal = found[1], found[3], found[2] == "="
        if value not in VALUES[name]:
            _fail(text, at + found.start(3), f"one of {', '.join(VALUES[name])}")
        if not equal and name not in NEGATABLE:
            _fail(text, at, f"{name}={value}: only {', '.join(NEGATABLE)} can be negated")
        tests.append(Test(name, value, equal))
    tests.sort(key=lambda test: list(VALUES).index(test.name))
    names = tuple(test.name for test in tests)
    if len(tests) > 1 and names not in PAIRS:
        _fail(text, parts[-1][1], f"one test, or two of {', or of '.join(' and '.join(pair) for pair in PAIRS)}")
    return tuple(tests)
