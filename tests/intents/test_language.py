"""The language of intents: texts, truth values, scores; the eight tasks in it; what demonstrations leave open."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from magical_mj import TASKS, demos
from magical_mj.intents import EIGHT, explain, parse, rivals
from magical_mj.intents.ambiguity import Judge, all_conjuncts
from magical_mj.intents.canonical import implies
from magical_mj.intents.intent import Intent, intent_of
from magical_mj.intents.relations import Conjunct
from magical_mj.intents.selectors import REST
from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.tasks.registry import ENVIRONMENTS, sample_scene, score
from magical_mj.utils.errors import IntentError, InvalidSceneError, MagicalError

REGION = GoalRegion("blue", -0.4, -0.4, 0.4, 0.4)
START = Scene(
    Robot(-0.9, -0.9, 0.0),
    (
        Block("star", "red", 0.8, 0.8, 0.0),
        Block("square", "red", -0.8, 0.8, 0.0),
        Block("circle", "blue", 0.8, -0.8, 0.0),
        Block("star", "green", 0.0, 0.0, 0.0),
    ),
    (REGION,),
)
"""Two red blocks and a blue one outside a blue region, and a green star in it."""
SCENES = 1_000


def moved(**places: tuple[float, float]) -> Scene:
    """The scene with the blocks b0 to b3, or the robot, at other places."""
    poses = [(*places.get(f"b{index}", (block.x, block.y)), block.angle) for index, block in enumerate(START.blocks)]
    return START.moved((*places.get("robot", START.robot.pose[:2]), 0.0), poses)


IN, OUT = (0.1, 0.2), (-0.8, -0.3)


@pytest.mark.parametrize(
    ("text", "reached", "missed"),
    [
        ("in(colour=red, region)", moved(b0=IN, b1=(-0.2, 0.2)), moved(b0=IN)),
        ("in(any, colour=red, region)", moved(b1=IN), moved(b2=IN)),
        ("in(colour=region, region)", moved(b2=IN), moved(b0=IN)),
        ("in(colour=red, shape=star, region)", moved(b0=IN), moved(b1=IN)),
        ("in(like=shape, region)", moved(b0=IN), moved(b3=OUT)),
        ("in(odd=shape, region)", None, moved(b1=IN)),  # two blocks have a shape of their own
        ("in(nearest=robot, region)", moved(b3=IN, robot=(0.9, 0.0)), moved(b3=OUT)),
        ("out(starts=in)", moved(b3=OUT), START),
        ("exactly(2, all)", moved(b0=IN), moved(b0=IN, b1=(-0.2, 0.2))),
        ("wall(colour=blue, left)", moved(b2=(-0.8, 0.0)), moved(b2=(-0.7, 0.0))),
        ("corner(shape=circle, top right)", moved(b2=(0.6, 0.6)), moved(b2=(0.55, 0.55))),
        ("near corner(shape=circle, top right)", moved(b2=(0.55, 0.55)), moved(b2=(0.2, 0.2))),
        ("near(colour=blue, to=green star)", moved(b2=(0.3, 0.0)), moved(b2=(0.6, 0.0))),
        ("near(colour=blue, to=star)", None, moved(b2=(0.3, 0.0))),  # there are two stars
        ("apart(colour=red)", START, moved(b1=(0.4, 0.8))),
        ("line(colour!=green)", moved(b0=(0.3, 0.8), b1=(0.0, 0.8), b2=(-0.3, 0.8)), START),
        ("robot in()", moved(robot=(0.0, 0.3)), START),
        ("robot near(to=blue)", moved(robot=(0.5, -0.8)), START),
        ("robot wall(top)", moved(robot=(0.0, 0.9)), START),
        ("in(colour=blue, region) & untouched(others)", moved(b2=IN), moved(b2=IN, b0=(0.5, 0.8))),
        ("in(colour=yellow, region)", None, START),  # there is none
        ("in(colour=blue, region) & out(colour=yellow)", moved(b2=IN), START),
    ],
)
def test_an_intent_holds_where_it_says(text: str, reached: Scene | None, missed: Scene) -> None:
    intent = parse(text)
    assert parse(str(intent)) == intent
    assert not intent.holds(START, missed)
    assert intent.score(START, missed) < 1.0
    if reached is not None:
        assert intent.holds(START, reached)
        assert intent.score(START, reached) == 1.0
    assert intent.sentence[0].isupper()
    assert intent.sentence[-1] == "."
    assert intent.bits > 0


def test_scores_count_objects_beyond_those_of_the_start() -> None:
    intent = parse("in(colour=red, region)")
    assert intent.score(START, START) == 0.0
    assert intent.score(START, moved(b0=IN)) == 0.5
    both = parse("in(all, region)")  # one of four is inside at the start
    assert both.share(START, START) == 0.25
    assert both.score(START, moved(b0=IN)) == pytest.approx(1 / 3)
    assert both.score(START, moved(b3=OUT)) == 0.0


def test_texts_have_one_canonical_form() -> None:
    text = "untouched( others ) & in( shape = star ,colour=red, region) & in(colour=red, shape=star, region)"
    assert str(parse(text)) == "in(colour=red, shape=star, region) & untouched(others)"


@pytest.mark.parametrize(
    ("text", "place", "says"),
    [
        ("in(colour=red)", 3, "one of region, home"),
        ("fetch(all)", 0, "a relation: in, out"),
        ("in(colour=purple, region)", 10, "one of red, green, blue, yellow, region"),
        ("in(all, region) | out(all)", 16, "& and another relation"),
        ("near(all, to=big star)", 10, "to=red star"),
        ("robot in(all)", 9, "the end of the brackets"),
        ("exactly(colour=red)", 8, "a number from 1 to 9"),
        ("in(odd!=colour, region)", 3, "can be negated"),
        ("in(odd=colour, like=both, region)", 15, "one test, or two of colour and shape"),
    ],
)
def test_a_wrong_text_shows_where(text: str, place: int, says: str) -> None:
    with pytest.raises(IntentError) as raised:
        parse(text)
    first, second = str(raised.value).split("\n")
    assert first == text
    assert second.index("^") == place
    assert says in second


@pytest.mark.parametrize(
    "text",
    ["untouched(others)", "line(all) & untouched(others)", "line(all) & in(all, region) & out(all) & robot in()"],
)
def test_an_intent_names_something_and_has_three_relations_at_most(text: str) -> None:
    with pytest.raises(IntentError):
        parse(text)


def rearranged(scene: Scene, rng: np.random.Generator) -> Scene:
    """The scene with some blocks anywhere, in a region, or near the first block, so that goals are often reached."""
    robot = (*rng.uniform(-1, 1, 2), 0.0) if rng.random() < 0.5 else scene.robot.pose
    poses = [block.pose for block in scene.blocks]
    for index, choice in enumerate(rng.random(len(poses))):
        if choice < 0.35:
            poses[index] = (*rng.uniform(-1, 1, 2), 0.0)
        elif choice < 0.6 and scene.regions:
            x_min, y_min, x_max, y_max = scene.regions[rng.integers(len(scene.regions))].box
            poses[index] = (rng.uniform(x_min, x_max), rng.uniform(y_min, y_max), 0.0)
        elif choice < 0.8:
            poses[index] = (*(np.array(poses[0][:2]) + rng.normal(0, 0.2, 2)), 0.0)
    return scene.moved(robot, poses)


@pytest.mark.parametrize("task", TASKS)
def test_the_eight_hold_exactly_where_the_tasks_score_is_one(task: str) -> None:
    rng, reached = np.random.default_rng(0), 0
    starts = [sample_scene(task, variant, seed) for name, variant in ENVIRONMENTS if name == task for seed in range(8)]
    for number in range(SCENES):
        start = starts[number % len(starts)]
        final = rearranged(start, rng)
        solved = score(task, start, final) == 1.0
        assert EIGHT[task].holds(start, final) == solved, (start, final)
        reached += solved
    demonstration = demos.load(task)[0].scenes()
    assert EIGHT[task].holds(demonstration[0], demonstration[-1])
    assert reached or task.startswith("Cluster")


@pytest.mark.parametrize("task", ["MatchRegions", "FixColour", "ClusterShape"])
def test_rivals_are_what_direct_evaluation_finds(task: str) -> None:
    ends = [(scenes[0], scenes[-1]) for scenes in (demo.scenes() for demo in demos.load(task)[:10])]

    def consistent(intent: Intent) -> bool:
        reached = all(intent.holds(start, end) and not intent.holds(start, start) for start, end in ends)
        return reached and intent.grounded(ends[0][0])

    found, rng = rivals(ends, bits=22.0), np.random.default_rng(0)
    assert [intent.bits for intent in found] == sorted(intent.bits for intent in found)
    assert all(consistent(found[index]) for index in rng.integers(len(found), size=40))
    known, conjuncts = set(found), [one for one in all_conjuncts() if one.selector != REST]
    for index in rng.integers(len(conjuncts), size=200):
        intent = Intent((conjuncts[index],))
        assert (intent in known) == (consistent(intent) and intent.bits <= 22.0), intent
    for one, two in ((conjuncts[i], conjuncts[j]) for i, j in rng.integers(len(conjuncts), size=(200, 2))):
        intent, repeats = intent_of([one, two]), implies(one, two) or implies(two, one)
        if not repeats or len(intent.conjuncts) == 1:
            assert (intent in known) == (consistent(intent) and intent.bits <= 22.0), intent
    judge = Judge(found[::5])
    start, end = ends[0]
    assert judge.reached(start, end).all()
    rearrangements = [rearranged(start, rng) for _ in range(20)]
    flags = np.array([judge.reached(start, final) for final in rearrangements])
    assert flags.any() or task.startswith("Cluster")
    for number, intent in enumerate(judge.intents[:60]):
        assert flags[:, number].tolist() == [intent.holds(start, final) for final in rearrangements], intent


def test_equal_meanings_have_one_text() -> None:
    rng = np.random.default_rng(0)
    starts = [
        sample_scene(task, "All", seed) for task in ("MatchRegions", "FindDupe", "FixColour") for seed in range(4)
    ]
    conjuncts = [one for one in all_conjuncts() if one.selector != REST]
    alike = [one for one in conjuncts if one.relation == "in" and one.argument == "region"]
    shortened = 0
    for number in range(1_500):
        group = alike if number % 2 else conjuncts
        pair = tuple(group[index] for index in rng.integers(len(group), size=2))
        both = intent_of([*pair])
        if len(both.conjuncts) == 2:
            continue
        shortened += 1
        for start in starts:
            for final in (rearranged(start, rng), rearranged(start, rng)):
                assert both.holds(start, final) == Intent(pair).holds(start, final), pair
    assert shortened > 10


@pytest.mark.parametrize(
    ("text", "canonical"),
    [
        ("in(any, all, region) & in(all, region)", "in(all, region)"),
        ("in(any, colour=red, region) & in(any, colour=red, shape=star, region)", None),
        ("corner(all, any) & corner(all, top left)", "corner(all, top left)"),
        ("corner(all, top left) & near corner(all, top left)", "corner(all, top left)"),
        ("out(all) & out(colour=red)", "out(all)"),
        ("in(any, all, region) & exactly(2, all)", "exactly(2, all)"),
        ("in(any, nearest=robot, region)", "in(nearest=robot, region)"),
        ("in(any, like=both, region) & in(any, like=shape, region)", "in(any, like=both, region)"),
        ("robot wall(any) & robot wall(left)", "robot wall(left)"),
    ],
)
def test_relations_implied_by_another_are_left_out(text: str, canonical: str | None) -> None:
    shorter = "in(any, colour=red, shape=star, region)" if canonical is None else canonical
    assert str(parse(text)) == shorter


def test_rivals_say_something() -> None:
    for task in ("MoveToCorner", "MoveToRegion", "ClusterColour"):
        ends = [(scenes[0], scenes[-1]) for scenes in (demo.scenes() for demo in demos.load(task)[:3])]
        for intent in rivals(ends, bits=20.0):
            assert intent.grounded(ends[0][0]), intent
            assert "others" not in str(intent) or "(all" not in str(intent)


@pytest.mark.parametrize(
    ("text", "sentences"),
    [
        ("untouched(colour=red)", ["Leave all red blocks where they are.", "Do not move any red blocks."]),
        ("apart(starts=out)", ["Move apart all blocks that start outside the regions."]),
        (
            "out(shape!=star)",
            [
                "Make sure that all blocks that are not stars are outside all regions.",
                "Let no region contain any blocks that are not stars.",
            ],
        ),
        (
            "exactly(2, shape!=star)",
            [
                "Have in the region exactly two blocks that are not stars.",
                "Let the region contain exactly two blocks that are not stars.",
            ],
        ),
    ],
)
def test_long_descriptions_come_last_and_negations_say_any(text: str, sentences: list[str]) -> None:
    assert list(parse(text).paraphrases)[: len(sentences)] == sentences


def test_paraphrases_say_the_same_in_other_words() -> None:
    intent = parse("in(any, colour!=red, shape!=star, region) & untouched(nearest=robot)")
    first, *others = intent.paraphrases
    assert (
        first
        == intent.sentence
        == (
            "Bring into the region at least one non-red block that is not a star, "
            "and leave the block nearest to the robot at the start where it is."
        )
    )
    assert len(set(others)) == 5
    for conjunct in all_conjuncts():
        if conjunct.selector != REST:
            sentences = Intent((conjunct,)).paraphrases
            assert len(sentences) > 1
            assert not any("{" in sentence or "  " in sentence for sentence in sentences)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("near(all, to=blue circle)", "Bring all blocks next to the blue circle."),
        ("corner(all, any)", "Push all blocks into corners."),
        ("corner(any, all, any)", "Push at least one block into a corner."),
        ("wall(colour=red, any) & robot wall(any)", "Push all red blocks to walls, and drive to a wall."),
        ("in(others, region) & untouched(colour=red)", "Leave all red blocks where they are, and bring all other "),
        ("out(like=both) & robot in()", "starts in the region, not counting that block, are outside all regions, and "),
        ("in(colour=red, region) & out(starts=mismatched)", "Bring all red blocks into a region, and make sure that "),
    ],
)
def test_sentences_say_which_blocks_and_walls(text: str, sentence: str) -> None:
    assert sentence in parse(text).sentence


def test_intents_that_differ_in_a_scene_differ_in_all_sentences() -> None:
    """Half of the pairs differ in one word of their texts. None of them shares a sentence, at any strength of words."""
    rng, differ = np.random.default_rng(0), 0
    starts = [sample_scene(task, "All", seed) for task in ("MatchRegions", "FindDupe", "FixColour") for seed in (0, 1)]
    ends = [(start, rearranged(start, rng)) for start in starts for _ in range(3)]
    conjuncts = list(all_conjuncts())
    groups: dict[object, list[Conjunct]] = {}
    for one in conjuncts:
        for key in ((one.relation, one.argument), (one.selector, one.relation)):
            groups.setdefault(key, []).append(one)

    def pick(among: Sequence[Conjunct]) -> Conjunct:
        return among[int(rng.integers(len(among)))]

    while differ < 4_000:
        shared, one, other = pick(conjuncts), pick(conjuncts), pick(conjuncts)
        if rng.random() < 0.5:
            alike = (one.relation, one.argument) if rng.random() < 0.5 else (one.selector, one.relation)
            other = pick(groups[alike])
        try:
            pair = [intent_of([shared, one]), intent_of([shared, other])]
        except IntentError:
            continue
        if pair[0] == pair[1]:
            continue
        said = [{*intent.paraphrases, *itertools.chain.from_iterable(intent.wordings)} for intent in pair]
        if not said[0].isdisjoint(said[1]):
            held = [[intent.holds(*end) for end in ends] for intent in pair]
            assert held[0] == held[1], pair
        differ += 1


def test_words_are_25_sentences_for_each_intent() -> None:
    intent = parse("in(colour=red, region) & near(shape=circle, to=red square)")
    assert [len(set(group)) for group in intent.wordings] == [5] * 5
    assert (
        intent.wordings[3][0] == "In the end, all red objects are in the zone, and all discs are next to the red box."
    )
    sentences = {intent.sentence, *itertools.chain.from_iterable(intent.wordings)}
    assert len(sentences) == 26
    assert all(text[0].isupper() and text.endswith(".") for text in sentences)


def test_an_end_is_explained_by_what_was_reached() -> None:
    reached = explain(START, moved(b1=IN))
    assert parse("in(any, colour=red, region)") in reached
    assert parse("in(colour=red, region)") not in reached
    assert parse("exactly(2, all)") in reached
    assert parse("in(colour=red, shape=square, region) & untouched(others)") in reached
    assert explain(START, START) == []


def test_explanations_about_what_moved_come_first() -> None:
    reached = explain(START, moved(b2=IN))
    texts = list(map(str, reached))
    assert texts.index("in(colour=blue, region)") < texts.index("exactly(2, all)")
    about_moved = [text for text in texts if "shape=circle" in text or "colour=blue" in text or "colour=region" in text]
    assert set(texts[:3]) <= set(about_moved)
    assert reached != sorted(reached, key=lambda intent: intent.bits)
    assert set(reached) == set(rivals([(START, moved(b2=IN))]))


def test_a_selector_that_means_nothing_holds_nowhere() -> None:
    without = replace(START, regions=())
    assert not parse("in(all, region)").holds(without, without)
    assert parse("in(all, region)").score(without, without) == 0.0


ODD = (
    "clustered(all, by=shape)",
    "clustered(colour=red, by=shape)",
    "in(colour=red, region) & apart(others)",
    "in(colour=red, region) & exactly(1, others)",
    "in(all, region) & wall(all, any) & near(all, to=red)",
)


def test_any_intents_can_be_judged_together() -> None:
    intents, rng, found = [parse(text) for text in ODD], np.random.default_rng(0), []
    judge = Judge(intents)
    for _ in range(200):
        final = START.moved(blocks=[(*rng.uniform(-0.9, 0.9, 2).tolist(), 0.0) for _ in START.blocks])
        holds = [intent.holds(START, final) for intent in intents]
        assert judge.holds(START, final).tolist() == holds
        found.append(holds)
    assert np.array(found).any(axis=0)[:4].all()


def test_the_final_scene_is_of_the_same_episode() -> None:
    """With other blocks, a number in the place of a block would be about another one."""
    other = replace(START, blocks=START.blocks[::-1])
    for call in (parse("in(colour=red, region)").holds, parse("line(all)").score, explain):
        with pytest.raises(InvalidSceneError, match="the final scene must have the initial scene's blocks"):
            call(START, other)
        with pytest.raises(InvalidSceneError, match="the final scene must have the initial scene's goal regions"):
            call(START, replace(START, regions=()))


@pytest.mark.parametrize(
    "wrong", ["FindDupe", [], [(1, 2)], [START], [(START,)], [(START, replace(START, regions=()))]]
)
def test_rivals_are_of_demonstrations_or_scenes(wrong: Any) -> None:
    with pytest.raises(MagicalError):
        rivals(wrong)
