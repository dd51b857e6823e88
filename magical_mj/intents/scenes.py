"""Scenes of intents: demo scenes, the rules that variants use, and the conditions on initial scenes.

Demo scenes with the blocks that the intent names, and others, are proposed until an episode can start in one. Then each
relation applies to an object, at most half of the intent holds already, and a plan satisfies it. Variants draw
attributes uniformly under the same conditions.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Final, TypeVar

import numpy as np

from magical_mj.intents.intent import Intent, share_of
from magical_mj.intents.plans import solved
from magical_mj.intents.relations import HOME, Conjunct
from magical_mj.intents.selectors import REGION, Test, UngroundedError
from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.scene.constants import COLOURS, FIX_COLOUR_REGION_SIZE, REGION_SIZE, SHAPES, Colour, Shape
from magical_mj.tasks.rules import pick, shuffled, uniform_integer
from magical_mj.utils.errors import IntentError, PlacementError
from magical_mj.variants.placement import layout

_T = TypeVar("_T")
_Kind = tuple[Colour, Shape]
Rule = Callable[[Intent, np.random.Generator, Scene], Scene]
"""Draws an attribute of a scene."""

PROPOSALS: Final = 2_000
"""The largest number of demo scenes that are proposed for an intent."""
PLANS: Final = 100
"""After this number of proposals without a plan that satisfies the intent, the search ends."""
NEARLY: Final = 0.5
"""An episode does not start in a scene with this share of the intent or more."""
REDRAWS: Final = 2_000
"""The largest number of draws of colours, shapes or counts until the intent is defined in the scene."""
LAYOUTS: Final = 300
"""The number of draws until poses are accepted."""
BLOCKS: Final = (3, 6)
"""The least and greatest number of blocks in demo scenes; one more of each for clusters."""
MORE: Final = 2
"""The most blocks that `count_rule` adds."""
REGIONS: Final = (2, 3)
"""The numbers of regions for intents about several regions."""
INNER_MARGIN: Final = 0.06
"""See `VariationRules.inner_margin`."""
OUTSIDE: Final = tuple(itertools.product((-0.85, -0.3, 0.3, 0.85), (-0.85, 0.85)))
"""Proposed positions of blocks outside the regions. Placement moves the blocks."""


def size_of(number: int) -> tuple[float, float]:
    """The least and greatest side of regions, if a scene has this number of them."""
    return REGION_SIZE if number < 2 else FIX_COLOUR_REGION_SIZE


def missing(intent: Intent, scene: Scene) -> str:
    """Why no episode of the intent starts in a scene; empty if one does.

    Every relation must apply to an object in the scene. The share that holds must be below `NEARLY`. Relations that
    hold and only ask to change nothing do not count.
    """
    try:
        parts = intent.parts(scene, scene)
    except UngroundedError as error:
        return f"a relation is undefined there: {error}"
    shares = [
        share_of(part)
        for conjunct, part in zip(intent.conjuncts, parts, strict=True)
        if not (all(part) and keeps(conjunct))
    ]
    if not shares or sum(shares) / len(shares) >= NEARLY:
        return "at least half of the intent is satisfied there"
    return ""


def accepts(intent: Intent, scene: Scene) -> bool:
    """Whether an episode can start in a scene, and a plan satisfies the intent."""
    return not missing(intent, scene) and solved(intent, scene) is not None


def keeps(conjunct: Conjunct) -> bool:
    """Whether a relation asks to change nothing where it holds, such as `untouched`."""
    starts_in = any(test.name == "starts" and test.value != "out" for test in conjunct.selector)
    return conjunct.definition.least == 0 or conjunct.argument == HOME or starts_in


def demo_scene(intent: Intent, rng_of: Callable[[int], np.random.Generator]) -> tuple[int, Scene]:
    """A demo scene, and the number of its draw: the first where an episode can start.

    Args:
        intent: the intent.
        rng_of: the random generator of each draw, by its number.

    Raises:
        IntentError: if no draw is good.
    """
    if (most := max(conjunct.number for conjunct in intent.conjuncts)) > BLOCKS[1]:
        raise IntentError(f"{intent}: demo scenes have at most {BLOCKS[1]} blocks, so {most} cannot be in the region")
    why, failed = "the blocks and regions of the intent are missing", 0
    for number in range(PROPOSALS):
        scene = drawn_scene(intent, rng_of(number))
        if scene is None:
            continue
        if why := missing(intent, scene):
            continue
        if solved(intent, scene):
            return number, scene
        why, failed = "no plan satisfies it", failed + 1
        if failed == PLANS:
            break
    raise IntentError(f"found no scene for the intent {intent}: in the last proposal, {why}")


def drawn_scene(intent: Intent, rng: np.random.Generator) -> Scene | None:
    """A scene with the blocks and regions of an intent; None if the draw lacks some, or has no space."""
    scene = _proposal(intent, rng)
    if not intent.grounded(scene):
        return None
    try:
        return layout(scene, rng, size_of(len(scene.regions)), INNER_MARGIN)
    except PlacementError:
        return None


def _proposal(intent: Intent, rng: np.random.Generator) -> Scene:
    """A scene with blocks and regions that the intent may need. Their poses are drawn later, by `layout`."""
    named = _named(intent)
    tests = [test for conjunct in intent.conjuncts for test in conjunct.selector]
    homes = any(test.value in ("matched", "mismatched") for test in tests) or any(
        conjunct.argument == HOME for conjunct in intent.conjuncts
    )
    regions = uniform_integer(rng, *REGIONS) if homes else int(_needs_region(intent) or rng.random() < 0.5)
    clusters = any(conjunct.relation == "clustered" for conjunct in intent.conjuncts)
    number = max(len(named), uniform_integer(rng, BLOCKS[0] + clusters, BLOCKS[1] + clusters))
    colours = _pool(rng, COLOURS, [colour for colour, _ in named if colour])
    shapes = _pool(rng, SHAPES, [shape for _, shape in named if shape])
    kinds: list[_Kind] = [(colour or pick(rng, colours), shape or pick(rng, shapes)) for colour, shape in named]
    while len(kinds) < number:
        kinds.append(pick(rng, kinds) if kinds and rng.random() < 0.3 else (pick(rng, colours), pick(rng, shapes)))
    kinds = shuffled(rng, kinds)
    if Test("odd", "colour") in tests:
        kinds = [(kinds[0][0] if index else pick(rng, COLOURS), shape) for index, (_, shape) in enumerate(kinds)]
    if Test("odd", "shape") in tests:
        kinds = [(colour, kinds[0][1] if index else pick(rng, SHAPES)) for index, (colour, _) in enumerate(kinds)]
    inner = regions if homes else pick(rng, (0, 1, 1, 2)) * regions
    boxes = tuple(_box(pick(rng, colours if rng.random() < 0.7 else COLOURS), index) for index in range(regions))
    outside = shuffled(rng, OUTSIDE)
    blocks = []
    for index, (colour, shape) in enumerate(kinds):
        x, y = boxes[index % regions].centre if index < inner else outside[index % len(outside)]
        blocks.append(Block(shape, colour, x, y, 0.0))
    return Scene(Robot(0.0, -0.6, 0.0), tuple(shuffled(rng, blocks)), boxes)


def _box(colour: Colour, number: int) -> GoalRegion:
    """A region, which placement moves."""
    x = (0.0, -0.6, 0.6)[number]
    return GoalRegion(colour, x - 0.25, -0.25, x + 0.25, 0.25)


def _needs_region(intent: Intent) -> bool:
    """Whether the intent is undefined without a region."""
    return any(
        conjunct.relation in ("in", "out", "exactly", "robot in")
        or any(test.name in ("like", "starts") or test.value == REGION for test in conjunct.selector)
        for conjunct in intent.conjuncts
    )


def _pool(rng: np.random.Generator, every: Sequence[_T], named: Sequence[_T]) -> list[_T]:
    """The named values, and others: two to four in all."""
    own = list(dict.fromkeys(named))
    others = shuffled(rng, [value for value in every if value not in own])
    return own + others[: max(1, uniform_integer(rng, 2, len(every)) - len(own))]


def _named(intent: Intent) -> list[tuple[Colour | None, Shape | None]]:
    """The colour and shape of each block that the intent names; None: any."""
    named = []
    for conjunct in intent.conjuncts:
        words = [test.value for test in conjunct.selector if test.name in ("colour", "shape") and test.equal]
        words_of = [words, *([conjunct.argument.split()] if conjunct.relation.endswith("near") else [])]
        words_of += [test.value.split() for test in conjunct.selector if test.name in ("nearest", "farthest")]
        for group in words_of:
            colour = next((word for word in group if word in COLOURS), None)
            shape = next((word for word in group if word in SHAPES), None)
            if colour or shape:
                named.append((colour, shape))
    return list(dict.fromkeys(named))


# Rules of variants. The first draws are uniform. Later ones keep more and more of the scene, so that one succeeds.


def colours_rule(intent: Intent, rng: np.random.Generator, scene: Scene) -> Scene:
    """Other colours of blocks and regions."""

    @cache  # most scenes need many draws
    def region(number: int, colour: Colour) -> GoalRegion:
        return replace(scene.regions[number], colour=colour)

    @cache
    def block(number: int, colour: Colour) -> Block:
        return replace(scene.blocks[number], colour=colour)

    def draw(keep: float) -> Scene:
        def colour(item: Block | GoalRegion) -> Colour:
            return item.colour if rng.random() < keep else pick(rng, COLOURS)

        regions = tuple(region(number, colour(item)) for number, item in enumerate(scene.regions))
        blocks = tuple(block(number, colour(item)) for number, item in enumerate(scene.blocks))
        return replace(scene, regions=regions, blocks=blocks)

    return _first_grounded(intent, scene, draw)


def shapes_rule(intent: Intent, rng: np.random.Generator, scene: Scene) -> Scene:
    """Other shapes of blocks."""

    @cache
    def block(number: int, shape: Shape) -> Block:
        return replace(scene.blocks[number], shape=shape)

    def draw(keep: float) -> Scene:
        shapes = (one.shape if rng.random() < keep else pick(rng, SHAPES) for one in scene.blocks)
        return replace(scene, blocks=tuple(block(number, shape) for number, shape in enumerate(shapes)))

    return _first_grounded(intent, scene, draw)


def count_rule(intent: Intent, rng: np.random.Generator, scene: Scene) -> Scene:
    """One block less, up to `MORE` more, or as many with others replaced. New blocks start outside the regions."""
    free = [Robot(x, y, 0.0) for x, y in OUTSIDE]
    free = [place for place in free if not any(region.contains(place) for region in scene.regions)]

    def draw(keep: float) -> Scene:
        kept = [block for block in scene.blocks if rng.random() < 0.7 + 0.3 * keep]
        number = uniform_integer(rng, max(2, len(scene.blocks) - 1), len(scene.blocks) + MORE)
        while len(kept) < number:
            place = pick(rng, free)
            kept.append(Block(pick(rng, SHAPES), pick(rng, COLOURS), place.x, place.y, 0.0))
        return replace(scene, blocks=tuple(kept))

    return _first_grounded(intent, scene, draw)


ALL_RULES: Final = (count_rule, colours_rule, shapes_rule)
"""The rules that the variant All uses."""


def redrawn(intent: Intent, rng: np.random.Generator, scene: Scene, *rules: Rule) -> Scene:
    """A scene with other attributes by some rules, and other poses; the scene itself if none is accepted."""
    for _ in range(LAYOUTS):
        drawn = scene
        for rule in rules:
            drawn = rule(intent, rng, drawn)
        try:
            drawn = layout(drawn, rng, size_of(len(drawn.regions)), INNER_MARGIN)
        except PlacementError:
            continue
        if accepts(intent, drawn):
            return drawn
    return scene


def _first_grounded(intent: Intent, scene: Scene, draw: Callable[[float], Scene]) -> Scene:
    """The first draw where every relation applies to an object. Without one, the scene itself."""
    draws = (draw(number / REDRAWS) for number in range(REDRAWS))
    return next((drawn for drawn in draws if intent.grounded(drawn)), scene)
