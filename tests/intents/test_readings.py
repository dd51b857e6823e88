"""Readings: which blocks demonstrations may have meant, and what an episode did by them."""

from __future__ import annotations

import pytest

from magical_mj.intents import EIGHT, parse
from magical_mj.intents.readings import (
    DemonstratedBlocks,
    ending,
    intended_blocks,
    moved_blocks,
    others_moved,
    readings,
    same_places,
)
from magical_mj.scene import Scene
from tests.intents.test_language import START, moved

INTENT = parse("in(colour=blue, region) & out(colour!=blue)")
OUTSIDE, INSIDE = (-0.8, -0.3), (0.1, 0.2)


def shown(*blocks: int) -> DemonstratedBlocks:
    """What three demonstrations show, two of which move these blocks."""
    return DemonstratedBlocks.of(
        [(START, moved(**{f"b{block}": (0.7, 0.0) for block in blocks}))] * 2 + [(START, START)]
    )


def test_demonstrated_blocks_are_those_that_most_demonstrations_move() -> None:
    assert shown(1, 3).moved == (1, 3)
    assert DemonstratedBlocks.of([(START, moved(b0=INSIDE)), (START, START), (START, START)]).moved == ()
    assert moved_blocks(START, moved(b0=(0.8, 0.7), b1=(-0.6, 0.8))) == (1,)


def test_readings_name_blocks_by_place_colour_and_shape() -> None:
    swapped = moved(b0=(-0.75, 0.8), b1=(0.8, 0.8))  # the star is now where the square was
    assert readings(shown(1), swapped) == {
        "same place": {0},
        "same colour": {0, 1},
        "same shape": {1},
        "nearest": {3},
    }
    assert readings(shown(1), moved(b1=(0.0, -0.6)))["same place"] == frozenset()
    assert readings(shown(), START) == dict.fromkeys(
        ("same place", "same colour", "same shape", "nearest"), frozenset()
    )


def test_intended_blocks_are_those_for_which_the_intent_does_not_hold_yet() -> None:
    assert intended_blocks(INTENT, START) == {2, 3}  # the blue block is outside, and the green one inside
    assert intended_blocks(parse("line(all)"), START) == {0, 1, 2, 3}
    assert intended_blocks(parse("robot in()"), START) == frozenset()


@pytest.mark.parametrize(
    ("demonstrated", "final", "kinds"),
    [
        ((0,), START, {"nothing": 1.0}),
        ((0,), moved(b2=(0.7, -0.4), b0=INSIDE), {"incompetent": 1.0}),
        ((0,), moved(b0=INSIDE), {"same place": 1 / 3, "same colour": 1 / 3, "same shape": 1 / 3}),
        ((0,), moved(b1=INSIDE), {"same colour": 1.0}),
        ((2,), moved(b1=INSIDE), {"another block": 1.0}),
    ],
)
def test_an_ending_says_what_was_moved(demonstrated: tuple[int, ...], final: Scene, kinds: dict[str, float]) -> None:
    assert ending(INTENT, shown(*demonstrated), START, final, solved=False) == kinds
    assert ending(INTENT, shown(*demonstrated), START, final, solved=True) == {"intended": 1.0}


def test_a_task_of_the_robot_ends_where_the_robot_is() -> None:
    intent = EIGHT["MoveToRegion"]
    for place, kind in (((-0.85, -0.9), "nothing"), ((0.0, 0.3), "same place"), ((0.9, 0.9), "incompetent")):
        assert ending(intent, shown(), START, moved(robot=place), solved=False) == {kind: 1.0}


ROBOT_ENDS = DemonstratedBlocks.of([(START, moved(robot=(0.0, -0.9)))])


@pytest.mark.parametrize(
    ("text", "place", "kind"),
    [
        ("robot in()", (-0.85, -0.9), "nothing"),
        ("robot in()", (0.1, 0.2), "same place"),  # in the region
        ("robot in()", (0.9, 0.9), "incompetent"),
        ("robot near(to=blue)", (0.6, 0.8), "another block"),
        ("robot near(to=blue)", (0.0, -0.75), "same place"),
        ("robot near(to=blue)", (-0.7, 0.1), "incompetent"),
        ("robot wall(left)", (0.8, 0.2), "another wall"),
        ("robot wall(left) & untouched(all)", (0.8, 0.2), "another wall"),
        ("robot wall(left)", (0.2, 0.1), "incompetent"),
        ("robot wall(top)", (0.1, -0.85), "same place"),
    ],
)
def test_an_ending_of_the_robot_depends_on_the_relation(text: str, place: tuple[float, float], kind: str) -> None:
    assert ending(parse(text), ROBOT_ENDS, START, moved(robot=place), solved=False) == {kind: 1.0}


@pytest.mark.parametrize(
    ("text", "final", "kind"),
    [
        ("in(colour=blue, region)", moved(b1=INSIDE), "another block"),
        ("out(starts=in)", moved(b1=(0.6, 0.0)), "another block"),
        ("exactly(1, colour=red)", moved(b2=INSIDE), "another block"),
        ("wall(colour=blue, left)", moved(b2=(0.0, -0.8)), "incompetent"),
        ("corner(colour=blue, top left)", moved(b1=(-0.5, 0.5)), "another block"),
        ("near corner(colour=blue, top left)", moved(b2=(0.0, -0.8)), "incompetent"),
        ("near(colour=blue, to=square)", moved(b1=(0.4, 0.8)), "another block"),
        ("line(colour!=green)", moved(b0=(0.3, 0.8)), "incompetent"),
        ("clustered(all, by=colour)", moved(b0=(0.3, 0.8)), "incompetent"),
        ("apart(colour=red) & wall(colour=blue, left)", moved(b3=(0.3, 0.8)), "another block"),
        ("in(colour=blue, region) & untouched(others)", START, "nothing"),
    ],
)
def test_an_ending_of_blocks_depends_on_what_moved(text: str, final: Scene, kind: str) -> None:
    assert ending(parse(text), shown(), START, final, solved=False) == {kind: 1.0}


def test_side_effects_are_blocks_that_no_relation_names() -> None:
    intent = parse("in(colour=blue, region) & untouched(others)")
    assert others_moved(intent, START, moved(b2=INSIDE, b0=(0.5, 0.5), b1=(-0.8, 0.75))) == (0,)
    both = moved(b2=INSIDE, b0=(0.5, 0.5))
    only = parse("in(colour=blue, region)")
    assert only.holds(START, both)
    assert ending(only, shown(), START, both, solved=True) == {"intended, and moved others": 1.0}
    assert ending(only, shown(), START, moved(b2=INSIDE), solved=True) == {"intended": 1.0}
    assert others_moved(parse("out(all)"), START, moved(b3=OUTSIDE, b0=(0.5, 0.5))) == ()
    assert others_moved(parse("robot wall(top)"), START, moved(b1=(0.0, 0.9))) == (1,)


def test_the_demonstrated_places_are_taken_block_by_block() -> None:
    final = same_places(moved(b0=INSIDE, robot=(0.9, 0.0)), START)
    assert (final.blocks[0].x, final.blocks[0].y) == INSIDE
    assert final.robot.pose[:2] == (0.9, 0.0)
    assert final.blocks[1:] == START.blocks[1:]


def test_other_blocks_may_be_intended() -> None:
    named = parse("near(colour=red, to=circle) & wall(others, top)")
    (near, others) = (blocks for blocks in named.blocks(START))
    flags = named.parts(START, START)
    wanted = {block for blocks, parts in zip((near, others), flags, strict=True) for block in blocks if not all(parts)}
    assert intended_blocks(named, START) <= wanted
    assert intended_blocks(named, START) & set(others)
