"""Questions about what demonstrations were for."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from magical_mj.intents import parse, question_of, questions
from magical_mj.intents.choices import SHORTCUTS
from magical_mj.intents.question import LETTERS, Question
from magical_mj.intents.question_files import write
from magical_mj.intents.question_text import grammar, prompt, read_answer, table
from magical_mj.intents.relations import RELATIONS
from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.scene.geometry import check_scene
from magical_mj.utils.errors import SettingsError

SETTINGS = {"scenes": 2, "limit": 6}


@pytest.fixture(scope="module")
def made() -> list[Question]:
    return list(questions("choose", "combined", **SETTINGS))


def question(task: str) -> Question:
    """A question about "Bring all red blocks into the region", whose answer is easily seen."""
    region = GoalRegion("green", -0.3, -0.3, 0.3, 0.3)
    blocks = (Block("star", "red", 0.7, 0.7, 0.0), Block("square", "blue", -0.7, 0.7, 0.0))
    start = Scene(Robot(0.0, -0.7, 0.0), blocks, (region,))
    end = start.moved(blocks=[(0.0, 0.0, 0.0), blocks[1].pose])
    return Question(
        task,
        "hand-made",
        "dev",
        "",
        "",
        parse("in(colour=red, region)"),
        ((start, end),),
        "",
        start,
        own=((start, end),),
    )


def test_one_option_satisfies_the_intent_and_it_is_the_answer(made: list[Question]) -> None:
    assert {one.kind for one in made} == {"logic", "prior"}
    for one in made:
        right = [one.intent.holds(one.scene, end) for end in one.options]
        assert [letter for letter, flag in zip(LETTERS, right, strict=True) if flag] == [one.answer]
        assert one.check(one.answer).right
        assert one.readings[LETTERS.index(one.answer)] == "intended"


def test_all_scenes_are_legal_and_new(made: list[Question]) -> None:
    for one in made:
        for scene in (*one.options, *(scene for shown in one.demonstrations for scene in shown)):
            check_scene(scene)
        assert one.scene not in [shown[0] for shown in one.demonstrations]


def test_demonstrations_reach_the_intent(made: list[Question]) -> None:
    for one in made:
        assert all(one.intent.holds(shown[0], shown[-1]) for shown in one.demonstrations)


def test_the_demonstrations_of_logic_refute_the_wrong_readings(made: list[Question]) -> None:
    for one in made:
        readings = [reading for reading in one.readings if reading not in ("intended", *SHORTCUTS)]
        for reading in map(parse, readings):
            allowed = [
                reading.grounded(start) and reading.holds(start, end) and not reading.holds(start, start)
                for start, end in one.watched
            ]
            assert all(allowed) == (one.kind == "prior")


def test_a_wrong_answer_says_which_reading_it_follows(made: list[Question]) -> None:
    for one in made:
        for letter, reading in zip(LETTERS, one.readings, strict=True):
            assert letter == one.answer or one.check(letter).misread == reading


def test_another_process_asks_the_same_questions(made: list[Question]) -> None:
    code = (
        "from magical_mj.intents import questions\n"
        f"print([one.digest for one in questions('choose', 'combined', **{SETTINGS!r})])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == str([one.digest for one in made])


def test_other_seeds_ask_other_questions(made: list[Question]) -> None:
    (other,) = questions("choose", "combined", scenes=2, limit=1, seed=1)
    assert other.scene != made[0].scene
    assert other.demonstrations != made[0].demonstrations


def test_a_question_survives_json(made: list[Question]) -> None:
    assert question_of(json.loads(json.dumps(made[0].data))) == made[0]


@pytest.mark.parametrize(
    ("given", "shown", "words"), [("sentence", 0, True), ("both", 1, True), ("nothing", 0, False), ("wrong", 1, False)]
)
def test_what_a_question_gives(given: str, shown: int, words: bool) -> None:
    (one,) = questions("say", "dev", scenes=1, limit=1, given=given)
    assert len(one.demonstrations) == shown
    assert one.sentence == (one.intent.sentence if words else "")
    assert (one.demonstrations == one.own) == (given == "both")


def test_more_demonstrations_than_scenes_end_in_other_ways() -> None:
    distinct = set[int]()
    for one in questions("say", "dev", scenes=1, demonstrations=3, limit=4):
        assert len({shown[0] for shown in one.demonstrations}) == 1
        distinct.add(len({shown[-1] for shown in one.demonstrations}))
    assert max(distinct) > 1


@pytest.mark.slow
def test_frames_show_an_episode_of_the_expert() -> None:
    (one,) = questions("say", "dev", scenes=1, frames=3, limit=1)
    (shown,) = one.demonstrations
    assert len(shown) == 5
    assert one.intent.holds(shown[0], shown[-1])


@pytest.mark.parametrize(
    "wrong", [{"scenes": 3}, {"scenes": 4, "demonstrations": 3}, {"frames": -1}, {"scenes": 1, "contrasting": True}]
)
def test_settings_that_no_question_has_are_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(SettingsError):
        questions("choose", "dev", **wrong)


def test_said_intents_agree_as_far_as_they_mean_the_same() -> None:
    right = question("say").check("in(colour=red, region)")
    assert (right.score, right.right) == (1.0, True)
    other = question("say").check("in(shape=star, region)")
    assert 0.0 < other.score < 1.0
    assert other.misread == "in(shape=star, region)"
    assert question("say").check("in(colour=pink, region)").problem


def test_placed_blocks_are_right_clean_or_wrong() -> None:
    place = question("place")
    here, other = place.scene.blocks
    right = place.scene.moved(blocks=[(0.1, 0.0, 0.0), other.pose])
    assert (place.check(right).right, place.check(right).clean) == (True, True)
    stray = place.check(place.scene.moved(blocks=[(0.1, 0.0, 0.0), (-0.7, 0.2, 0.0)]))
    assert (stray.right, stray.clean) == (True, False)
    overlapping = place.check(place.scene.moved(blocks=[(0.0, 0.0, 0.0), (0.05, 0.0, 0.0)]))
    assert not overlapping.right
    assert "overlap" in overlapping.problem
    assert not place.check(place.scene.moved(blocks=[here.pose, (0.0, 0.0, 0.0)])).right
    assert place.check(place.scene).problem == "nothing has moved"


@pytest.mark.parametrize(
    ("text", "letter"),
    [
        ("ANSWER: B", "B"),
        ("**Answer:** (c)", "C"),
        ("ANSWER: A\nNo, wait.\nANSWER: D.", "D"),
        ("> final answer: b", "B"),
    ],
)
def test_letters_are_read_as_people_write_them(text: str, letter: str) -> None:
    assert read_answer(question("choose"), text) == letter


@pytest.mark.parametrize("text", ["", "B", "ANSWER: E", "ANSWER: A or B", "ANSWER:\nB"])
def test_texts_without_a_letter_are_no_answer(text: str) -> None:
    with pytest.raises(SettingsError):
        read_answer(question("choose"), text)


@pytest.mark.parametrize(
    "text", ['ANSWER: {"blocks": {"1": [0.1, 0.2]}}', 'ANSWER: ```json\n{\n "blocks": {"1": [0.1, 0.2]}\n}\n```']
)
def test_places_are_read_from_json(text: str) -> None:
    final = read_answer(question("place"), text)
    assert isinstance(final, Scene)
    assert [block.pose[:2] for block in final.blocks] == [(0.1, 0.2), (-0.7, 0.7)]


@pytest.mark.parametrize(
    "text", ["ANSWER: {}x", 'ANSWER: {"blocks": {"3": [0, 0]}}', 'ANSWER: {"blocks": {"1": [1e999, 0]}}', "ANSWER: [1]"]
)
def test_other_json_is_refused_or_moves_nothing(text: str) -> None:
    try:
        final = read_answer(question("place"), text)
    except SettingsError:
        return
    assert final == question("place").scene


def test_sentences_are_read_as_intents() -> None:
    say = question("say")
    assert read_answer(say, f"ANSWER: {say.intent.sentence.upper()}", english=True) == str(say.intent)
    with pytest.raises(SettingsError):
        read_answer(say, "ANSWER: Put the red things in the box.", english=True)


def test_a_table_has_every_object() -> None:
    assert table(question("place").scene).splitlines() == [
        "robot at (0.00, -0.70), facing up",
        "goal region 1: green, x from -0.30 to 0.30, y from -0.30 to 0.30",
        "block 1: red star at (0.70, 0.70)",
        "block 2: blue square at (-0.70, 0.70)",
    ]


def test_the_prompt_explains_every_relation_and_never_gives_the_answer() -> None:
    text = grammar()
    assert all(f"- {name}(" in text for name in RELATIONS)
    shown = "\n".join(part for part in prompt(question("say")) if isinstance(part, str))
    assert "ANSWER: GOAL" in shown
    assert question("say").intent.sentence not in shown


def test_files_contain_questions_with_pictures(made: list[Question], tmp_path: Path) -> None:
    assert write(made[:2], tmp_path / "out", "test") == 2
    lines = [json.loads(line) for line in (tmp_path / "out" / "questions.jsonl").read_text().splitlines()]
    assert [question_of(json.loads(line["question"])) for line in lines] == made[:2]
    for line in lines:
        pictures = [tmp_path / "out" / name for name in json.loads(line["images"])]
        assert len(pictures) == 2 * 2 + 1 + 4
        assert all(picture.read_bytes().startswith(b"\x89PNG") for picture in pictures)
    described = json.loads((tmp_path / "out" / "croissant.json").read_text())
    assert {field["name"] for field in described["recordSet"][0]["field"]} == set(lines[0])
    with pytest.raises(SettingsError):
        write(made[:1], tmp_path / "out", "test")


@pytest.mark.parametrize("setting", [{"limit": -1}, {"limit": 1.5}, {"seed": -1}, {"scenes": 2.0}, {"frames": True}])
def test_invalid_numbers_are_explained(setting: dict[str, Any]) -> None:
    (name,) = setting
    with pytest.raises(SettingsError, match=f"{name} must be an integer of at least"):
        questions("say", "dev", **setting)
