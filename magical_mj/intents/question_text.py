"""The text of questions, and how answers in text are read.

A question is a sequence of texts and scenes. A scene is shown as a table of its objects, as a picture with numbered
blocks, or as both. Positions are in world units: the arena is a square from -1 to 1 in both directions, with y upwards.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from typing import Any, Final

import msgspec

from magical_mj.intents.ambiguity import all_conjuncts, rivals
from magical_mj.intents.intent import Intent
from magical_mj.intents.names import NAMES, SETS
from magical_mj.intents.question import LETTERS, Question
from magical_mj.intents.relations import RELATIONS
from magical_mj.intents.selectors import PAIRS, VALUES
from magical_mj.scene import Scene
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.utils.errors import InvalidSceneError, SettingsError

Part = str | Scene
"""A part of a question: a text, or a scene to show."""
MOST_CHARACTERS: Final = 20_000
"""Only this many characters at the end of an answer are read."""
WORLD: Final = """A robot with a gripper moves blocks in a square arena. Positions are (x, y), from (-1, -1) at the \
bottom left to (1, 1) at the top right. A block is about 0.25 wide. The robot has a goal, which is about where blocks \
or the robot end. Which blocks it is about may depend on their colours, shapes or positions at the start."""
TELLS: Final = {
    "choose": "Which of the final scenes reaches the goal? Think step by step if you like. End your answer with a line "
    "of the form ANSWER: LETTER, where LETTER is A, B, C or D.",
    "say": "What is the goal? End your answer with a line of the form ANSWER: GOAL, where GOAL is a text of the "
    "language.",
    "place": "Where should the objects be at the end of an episode that starts in the new scene? Move only what the "
    "goal requires. End your answer with a line of the form ANSWER: JSON, where JSON has the objects that have moved, "
    'such as {"blocks": {"2": [0.31, -0.45]}, "robot": [0.0, 0.6]}. Objects that you leave out stay. Blocks must not '
    "overlap each other or the walls.",
    "act": "Reach the goal in the new scene with the tools. Call done() when it is reached.",
}
IN_ENGLISH: Final = (
    "What is the goal? End your answer with a line of the form ANSWER: SENTENCE, where SENTENCE is a sentence of the "
    "language."
)


MEANINGS: Final = {
    "in": "the blocks end in a goal region; with home, in the region where they started",
    "out": "the blocks end outside all regions",
    "exactly": "NUMBER of the blocks end in the region",
    "wall": "the blocks end at the wall",
    "corner": "the blocks end in the corner",
    "near corner": "the blocks end close to the corner, but not necessarily in it",
    "near": "the blocks end next to the block with this colour, shape or both, which is the only one",
    "apart": "the blocks end far from each other",
    "line": "the blocks end in a line",
    "clustered": "the blocks end in groups of the same colour or shape",
    "untouched": "the blocks end where they started",
    "robot in": "the robot ends in the region",
    "robot near": "the robot ends next to the block",
    "robot wall": "the robot ends at the wall",
}
TEST_MEANINGS: Final = {
    "colour": "the block has the colour, or that of the region",
    "shape": "the block has the shape",
    "like": "it has the same colour, shape or both as the block that starts in the region",
    "starts": "it starts in a region, outside all, in a region of its own colour, or in one of another colour",
    "odd": "it is the only block with its colour, or shape, and all others have the same one",
    "nearest": "it starts nearest to the region, the robot or the block",
    "farthest": "it starts farthest from it",
}
REFERENCE: Final = "COLOUR | SHAPE | COLOUR SHAPE"


def grammar() -> str:
    """The language of intents, as a prompt describes it."""
    relations = "\n".join(f"- {_relation(name)}: {meaning}" for name, meaning in MEANINGS.items())
    tests = "\n".join(f"- {name}={_values(name)}: {meaning}" for name, meaning in TEST_MEANINGS.items())
    pairs = "; ".join(" and ".join(pair) for pair in PAIRS)
    return f"""A goal is one to three relations, joined by &, which must all hold at the end:
{relations}
BLOCKS selects blocks at the start: all, others (those that no other relation selects), one test, or two tests joined \
by a comma ({pairs}). The tests are:
{tests}
COLOUR is one of {", ".join(COLOURS)}, and SHAPE one of {", ".join(SHAPES)}. The tests colour, shape and like can be \
negated, as in colour!=red. With "any" before BLOCKS, one of the blocks is enough.
Examples:
in(colour=red, region) & untouched(others)
near(any, shape=star, to=blue circle)
wall(nearest=region, left)"""


def _relation(name: str) -> str:
    relation = RELATIONS[name]
    arguments = ["NUMBER"] * (name == "exactly") + ["BLOCKS"] * relation.of_blocks
    if relation.arguments != ("",):
        values = REFERENCE if name.endswith("near") else " | ".join(relation.arguments)
        arguments.append(f"{relation.prefix}{values}")
    return f"{name}({', '.join(arguments)})"


def _values(test: str) -> str:
    if test in ("nearest", "farthest"):
        return f"region | robot | {REFERENCE}"
    return {"colour": "COLOUR | region", "shape": "SHAPE"}.get(test, " | ".join(VALUES[test]))


def prompt(question: Question, *, english: bool = False) -> Iterator[Part]:
    """The question, in the order of display.

    Args:
        question: the question.
        english: ask for a sentence instead of a text of the language, for ``say``.
    """
    yield WORLD
    if question.sentence:
        yield f"The goal in words: {question.sentence}"
    for number, scenes in enumerate(question.demonstrations, 1):
        yield f"Demonstration {number} of {len(question.demonstrations)}, which reached the goal. It starts here:"
        yield scenes[0]
        for between in scenes[1:-1]:
            yield "Then:"
            yield between
        yield "It ends here:"
        yield scenes[-1]
    if question.task == "say":
        yield examples(question) if english else grammar()
        yield IN_ENGLISH if english else TELLS["say"]
        return
    yield "The new scene, in which an episode with the same goal starts:"
    yield question.scene
    for letter, scene in zip(LETTERS, question.options, strict=False):
        yield f"Final scene {letter}:"
        yield scene
    yield TELLS[question.task]


def examples(question: Question) -> str:
    """Sentences of other intents, which show the form of an answer in English."""
    own = question.intent
    others = [intent.sentence for intent in SETS["dev"] if intent != own][:8]
    return "The goal is a sentence of a fixed language. These are others of its sentences:\n" + "\n".join(
        f"- {sentence}" for sentence in others
    )


def table(scene: Scene) -> str:
    """The objects of a scene, a line each."""
    robot = scene.robot
    lines = [f"robot at {_place(robot.x, robot.y)}, facing {_heading(robot.angle)}"]
    lines += [
        f"goal region {number}: {region.colour}, x from {_number(region.x_min)} to {_number(region.x_max)}, "
        f"y from {_number(region.y_min)} to {_number(region.y_max)}"
        for number, region in enumerate(scene.regions, 1)
    ]
    lines += [
        f"block {number}: {block.colour} {block.shape} at {_place(block.x, block.y)}"
        for number, block in enumerate(scene.blocks, 1)
    ]
    return "\n".join(lines)


def _place(x: float, y: float) -> str:
    return f"({_number(x)}, {_number(y)})"


def _number(value: float) -> str:
    return f"{value + 0.0:.2f}".replace("-0.00", "0.00")


def _heading(angle: float) -> str:
    names = ("up", "up left", "left", "down left", "down", "down right", "right", "up right")
    return names[round(angle / (math.pi / 4)) % 8]


_ANSWER: Final = re.compile(r"(?im)^[ \t>*_`#-]*(?:final )?answer[*_` \t]*:[*_` \t]*(.*)")


def read_answer(question: Question, text: str, *, english: bool = False) -> str | Scene:
    """The answer that a text ends with, in the form that `Question.check` takes.

    Raises:
        SettingsError: if the text contains no such answer.
    """
    found = list(_ANSWER.finditer(text[-MOST_CHARACTERS:]))
    if not found:
        raise SettingsError(
            f"the question asks for a line of the form ANSWER: ..., and the text ends with {text[-80:]!r}"
        )
    last = found[-1]
    line = last[1].strip().strip("*`").strip()
    if question.task == "choose":
        letter = re.fullmatch(rf"\(?([{LETTERS}{LETTERS.lower()}])\)?\.?", line)
        if letter is None:
            raise SettingsError(f"the answer is one of the letters {', '.join(LETTERS)}, not {line[:80]!r}")
        return letter[1].upper()
    if question.task == "say":
        return _intent_text(question, line) if english else line
    return _final_scene(question.scene, text[-MOST_CHARACTERS:][last.start(1) :])


def _final_scene(scene: Scene, text: str) -> Scene:
    start, end = text.find("{"), text.rfind("}")
    try:
        answer = msgspec.json.decode(text[start : end + 1], type=dict[str, Any])
        moved = msgspec.convert(answer.get("blocks", {}), dict[int, tuple[float, float]], strict=False)
        driven = msgspec.convert(answer.get("robot"), tuple[float, float] | None, strict=False)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise SettingsError(f"the answer is not the JSON that the question asks for: {error}") from None
    unknown = sorted(set(moved) - set(range(1, len(scene.blocks) + 1)))
    if unknown:
        raise SettingsError(f"the new scene has the blocks 1 to {len(scene.blocks)}, not {unknown[0]}")
    blocks = [
        (*moved[number], block.angle) if number in moved else block.pose for number, block in enumerate(scene.blocks, 1)
    ]
    robot = scene.robot.pose if driven is None else (*driven, scene.robot.angle)
    try:
        return scene.moved(robot, blocks)
    except InvalidSceneError as error:
        raise SettingsError(f"the answer has an impossible position: {error}") from None


def _intent_text(question: Question, sentence: str) -> str:
    known = {**_sentences()} | {_plain(one.sentence): str(one) for one in [*rivals(question.watched), question.intent]}
    found = known.get(_plain(sentence))
    if found is None:
        raise SettingsError(f"the language does not have this sentence: {sentence[:200]!r}")
    return found


@lru_cache(maxsize=1)
def _sentences() -> Mapping[str, str]:
    """The sentences of the sets' intents, and of all intents with one relation -> their texts."""
    single: Iterable[Intent] = (Intent((one,)) for one in all_conjuncts())
    every = [*single, *(intent for name in NAMES for intent in SETS[name])]
    return {_plain(intent.sentence): str(intent) for intent in every}


def _plain(sentence: str) -> str:
    return re.sub(r"[\s.,]+", " ", sentence.strip("\"' ")).strip().lower()
