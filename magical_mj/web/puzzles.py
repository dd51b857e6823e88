"""Puzzles: a person sees two demonstrations of an intent, without its sentence, and plays it in other scenes.

puzzles.json contains the puzzles that the page chooses from; `python -m tools.puzzles` writes it. The page checks
intents as goals: a goal lists, for one initial scene, each relation with the indices of its blocks.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import msgspec

from magical_mj.demos import stored
from magical_mj.demos.recording import replayed
from magical_mj.intents import Intent, parse
from magical_mj.intents.expert_data import with_scenes
from magical_mj.intents.names import task_intent
from magical_mj.intents.relations import RELATIONS, Conjunct
from magical_mj.intents.selectors import UngroundedError, block_of
from magical_mj.intents.tasks import PREFIX, task_of
from magical_mj.policies.interface import actions_of
from magical_mj.scene import Scene
from magical_mj.tasks.registry import Pair, sample_scene, task_name, task_spec
from magical_mj.web.page_data import scene_data

DEMONSTRATIONS: Final = 2
"""The number of demonstrations. Each has its own demo scene."""
VARIANTS: Final = ("Demo", "Layout", "All")
SCENES: Final = 4
"""The number of scenes in each variant other than Demo."""
FILE: Final = Path(__file__).with_name("puzzles.json")


@dataclass(frozen=True)
class Puzzle:
    """An intent with the demonstrations that a player sees.

    Attributes:
        task: the task, with its demo scenes.
        demonstrations: the actions in the demo scenes, a letter for each.
        rivals: the simplest other intents that all demonstrations have reached; () if they are not known.
    """

    task: str
    demonstrations: tuple[str, ...]
    rivals: tuple[str, ...] = ()

    @property
    def intent(self) -> Intent:
        """The intent that a player must guess."""
        return task_intent(self.task)

    @property
    def name(self) -> str:
        """The name on the page and in addresses."""
        return task_of(self.task.removeprefix(PREFIX)).name

    @property
    def environments(self) -> list[Pair]:
        """The puzzle's environments on the page."""
        return [(self.name, variant) for variant in VARIANTS]

    def reached_instead(self, initial: Scene, final: Scene) -> Intent | None:
        """The simplest of the rivals that an episode has reached at its end, and not at its start."""
        return first_reached(map(parse, self.rivals), initial, final)


def first_reached(rivals: Iterable[Intent], initial: Scene, final: Scene) -> Intent | None:
    """The first of some intents that an episode has reached at its end, and not at its start."""
    reached = (rival for rival in rivals if _holds(rival, initial, final))
    return next((rival for rival in reached if not _holds(rival, initial, initial)), None)


def _holds(intent: Intent, initial: Scene, final: Scene) -> bool:
    return intent.grounded(initial) and intent.holds(initial, final)


@cache
def puzzles() -> tuple[Puzzle, ...]:
    """The puzzles in puzzles.json."""
    return tuple(msgspec.json.decode(FILE.read_bytes(), type=list[Puzzle]))


def puzzle_of(task: str) -> Puzzle:
    """The puzzle of any intent. If puzzles.json does not contain it, the expert makes the demonstrations.

    Raises:
        IntentError: if no scene was found for the intent.
        DemonstrationError: if the expert does not solve it.
    """
    name = with_scenes(task_name(task), DEMONSTRATIONS)
    known = next((puzzle for puzzle in puzzles() if puzzle.task == name), None)
    if known is not None:
        return known
    keys = [(name, "Demo", seed) for seed in range(DEMONSTRATIONS)]
    made = stored.complete(keys, stored.default_path(), known=stored.shipped(), jobs=1)
    return Puzzle(name, tuple(demo.actions for demo in made))


def goal_data(intent: Intent, initial: Scene) -> list[dict[str, Any]] | None:
    """An intent in an initial scene as JSON data: its relations with their blocks.

    None if a relation is undefined in the scene.
    """
    try:
        intent.parts(initial, initial)
    except UngroundedError:
        return None
    pairs = zip(intent.conjuncts, intent.blocks(initial), strict=True)
    return [_conjunct_data(conjunct, blocks, initial) for conjunct, blocks in pairs]


def _conjunct_data(conjunct: Conjunct, blocks: tuple[int, ...], initial: Scene) -> dict[str, Any]:
    """A relation. If its argument refers to a block, it is replaced by the block's index."""
    relation, argument = RELATIONS[conjunct.relation], conjunct.argument
    if relation.each is not None:
        flags = relation.each(argument, initial, initial)
        blocks = tuple(index for index in blocks if flags[index] is not None)
    return {
        "relation": conjunct.relation,
        "blocks": blocks,
        "argument": block_of(argument, initial) if conjunct.relation in ("near", "robot near") else argument,
        "number": conjunct.number,
        "some": conjunct.any_of,
    }


def puzzle_scenes(puzzle: Puzzle, variant: str) -> dict[str, Any]:
    """The page's data of a puzzle's environment, in the form of `magical_mj.web.page_data.environment_scenes`."""
    demo, number = variant == "Demo", DEMONSTRATIONS if variant == "Demo" else SCENES
    rivals = [parse(rival) for rival in puzzle.rivals]
    solved = replayed(puzzle.task, "Demo", 0, actions_of(puzzle.demonstrations[0]), "expert", 0).scenes()[-1]
    return {
        "horizon": task_spec(puzzle.task).horizon("paper"),
        "demonstrations": [],
        "scenes": [
            {
                "seed": seed,
                "expert": puzzle.demonstrations[seed] if demo else "",
                "scene": scene_data(scene := sample_scene(puzzle.task, variant, seed)),
                "goal": goal_data(puzzle.intent, scene),
                "rivals": [
                    {"sentence": rival.sentence, "goal": goal_data(rival, scene)}
                    for rival in rivals
                    if rival.grounded(scene)
                ],
            }
            for seed in range(number)
        ],
        "puzzle": {"task": puzzle.task, "sentence": puzzle.intent.sentence, "solved": scene_data(solved)},
    }
