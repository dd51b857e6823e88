"""What intents of the sets must fulfil, and a check of the members of the file.

An intent is accepted if it has scenes, and each of its relations adds something to the others. An intent of a test set
is accepted if no shortcut (`magical_mj.intents.shortcuts`) satisfies it in more than a tenth of 40 scenes of Layout and
All, and no training intent means the same, with `untouched(others)` or without. The intents of `seen`, `combined`,
`selector` and `relation` with the same number differ in one respect.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

import msgspec
import numpy as np

from magical_mj.intents import SETS
from magical_mj.intents.draws import Draws, in_sets
from magical_mj.intents.floors import RULES, shortcuts, shown
from magical_mj.intents.intent import Intent
from magical_mj.intents.names import TESTS
from magical_mj.intents.plans import cost, planned
from magical_mj.intents.readings import moved_blocks
from magical_mj.intents.relations import Conjunct
from magical_mj.intents.scenes import keeps
from magical_mj.intents.selectors import REST
from magical_mj.intents.tasks import LEAST_STEPS, Task, first_demo, found_draws, spec_of, task_of, with_further
from magical_mj.scene import Scene
from magical_mj.tasks.spec import TaskSpec
from magical_mj.utils.errors import IntentError, PlacementError
from magical_mj.variants import vary

DEMOS: Final = 4
"""The number of random demo scenes of a test intent that the file has, and of contrasting ones."""
MATCHED: Final = ("seen", "combined", "selector", "relation")
TEST_VARIANTS: Final = ("Layout", "All")
SCENES: Final = 20
"""The number of scenes of Layout, and of All, in which shortcuts are tried."""
FLOOR: Final = 0.1
"""A shortcut satisfies a test intent in at most this share of the scenes."""
GLANCE, GLANCE_MOST = 4, 0.25
"""The same in a first look, in fewer scenes."""
CHANCE: Final = 0.34
"""The same for random places and training intents, in six scenes."""
LONGER: Final = 0.35
"""The largest relative difference of costs of matched intents."""
MORE: Final = 0.75
"""The largest difference of the numbers of blocks that they move."""


def examined(task: Task, *, test: bool = False, left_out: tuple[str, ...] = ()) -> tuple[Draws, TaskSpec] | str:
    """The draws and the definition of a task, or why it is not accepted.

    An intent needs scenes, and each of its relations must add something. Random placement of its blocks must not
    satisfy it too often. In test sets, no shortcut must. Scenes with the digests `left_out` are not used as further
    demo scenes.
    """
    intent = task.intent
    try:
        first = first_demo(intent, task.seed)
        spec = spec_of(task, Draws(str(task), LEAST_STEPS, first))
        if test and (why := floor(intent, spec, GLANCE, GLANCE_MOST)):
            return why
        scenes = test_scenes(spec, 3)
        for one in intent.conjuncts:
            if (rest := without(intent, one)) and not keeps(one):
                reached = sum(intent.holds(*planned(rest, scene)) for scene in scenes)
                if reached > len(scenes) / 2:
                    return f"{one} adds nothing"
        if not test:
            random = shortcuts["random places"]
            share = sum(intent.holds(scene, random.end(intent, spec.demo, scene)) for scene in scenes) / len(scenes)
            return f"random places satisfy {share:.0%}" if share > CHANCE else (found_draws(intent, task.seed), spec)
        if why := floor(intent, spec, SCENES, FLOOR):
            return why
        found, more = found_draws(intent, task.seed), effort(intent, spec)
        draws = msgspec.structs.replace(found, left_out=left_out, **more)
        for contrasting in (False, True):
            draws = with_further(replace(task, demos=DEMOS, contrasting=contrasting), draws)
        return draws, spec_of(task, draws)
    except (IntentError, PlacementError) as error:
        return str(error)


def test_scenes(spec: TaskSpec, number: int) -> list[Scene]:
    """The first test scenes of each of Layout and All. Those of the last task are kept."""
    if spec.name not in _DRAWN:
        _DRAWN.clear()
    known = _DRAWN.setdefault(spec.name, [])
    for seed in range(len(known) // len(TEST_VARIANTS), number):
        known += [vary(spec, variant, seed) for variant in TEST_VARIANTS]
    return known[: number * len(TEST_VARIANTS)]


_DRAWN: dict[str, list[Scene]] = {}
"""Name of a task -> its test scenes."""


def without(intent: Intent, one: Conjunct) -> Intent | None:
    """The intent without a conjunct, and without `others` if nothing else selects blocks; None if nothing is left."""
    left = [other for other in intent.conjuncts if other != one]
    if not any(other.definition.of_blocks and other.selector != REST for other in left):
        left = [other for other in left if other.selector != REST]
    return Intent(tuple(left)) if left else None


def floor(intent: Intent, spec: TaskSpec, number: int, share: float) -> str:
    """The shortcut that satisfies an intent in a larger share of some test scenes; empty if none does.

    Those that choose the right blocks are found first, since this takes no plans.
    """
    scenes = test_scenes(spec, number)
    most, demonstration = share * len(scenes), shown(intent, spec.demo)
    for name, rule in RULES.items():
        if sum(_same_blocks(rule(demonstration, scene), intent, scene) for scene in scenes) > most:
            return name
    counts = Counter[str]()
    for scene in scenes:
        for name, shortcut in shortcuts.items():
            counts[name] += intent.holds(scene, shortcut.end(intent, spec.demo, scene))
            if counts[name] > most:
                return name
    return ""


def _same_blocks(blocks: Sequence[tuple[int, ...]], intent: Intent, scene: Scene) -> bool:
    """Whether a shortcut moves the blocks that a plan of the intent moves in a scene."""
    moved = shown(intent, scene).moved
    return len(blocks) == len(moved) and all(set(one) == set(other) for one, other in zip(blocks, moved, strict=True))


def effort(intent: Intent, spec: TaskSpec) -> dict[str, float]:
    """The mean cost of plans in the test scenes, and the mean number of blocks that they move."""
    scenes = test_scenes(spec, SCENES // 2)
    moves = [len(moved_blocks(*planned(intent, scene))) for scene in scenes]
    return {
        "cost": round(float(np.mean([cost(intent, scene) for scene in scenes])), 1),
        "moves": round(float(np.mean(moves)), 2),
    }


def twin(test: Intent, spec: TaskSpec, others: Iterable[Intent]) -> Intent | None:
    """Another intent that means the same in the test scenes, perhaps with `untouched(others)` added; None if none does.

    Each holds at the ends of the plans of the other.
    """
    scenes = test_scenes(spec, SCENES)
    ends = [planned(test, scene) for scene in scenes]
    for other in others:
        if all(other.holds(*end) for end in ends) and all(test.holds(*planned(other, scene)) for scene in scenes):
            return other
    return None


def alike(one: Draws, other: Draws) -> bool:
    """Whether plans are about as long, and move about as many blocks."""
    return abs(other.cost / one.cost - 1) <= LONGER and abs(other.moves - one.moves) <= MORE


def problem(draws: Draws) -> str:
    """How a member of the file differs from what its set accepts; empty if it does not.

    It must have the draws that a search finds, and no training intent may mean the same.
    """
    task, test = task_of(draws.task), draws.set in TESTS
    found = examined(task, test=test, left_out=draws.left_out)
    if isinstance(found, str):
        return found
    if msgspec.structs.replace(found[0], set=draws.set) != draws:
        return f"a search finds {found[0]}"
    if draws.set in ("train", "seen"):  # those of seen are training intents
        return ""
    same = twin(task.intent, found[1], SETS["train"])
    return f"{same} means the same" if same else ""


def unmatched() -> list[str]:
    """The matched intents whose plans are longer or shorter than those of `seen`, or move other numbers of blocks."""
    sets = {name: [draws for draws in in_sets() if draws.set == name] for name in MATCHED}
    pairs = [(seen, other) for name in MATCHED for seen, other in zip(sets["seen"], sets[name], strict=True)]
    return [other.task for seen, other in pairs if not alike(seen, other)]


def check(every: int) -> None:
    """Examines each member with a number that `every` divides, and whether the matched sets are matched."""
    problems = [f"{task}: not matched" for task in unmatched()]
    for number, draws in enumerate(in_sets()):
        if number % every == 0 and (why := problem(draws)):
            problems.append(f"{draws.set}, {draws.task}: {why}")
    if problems:
        sys.exit("\n".join(problems))
    print(f"{len(in_sets()[::every])} of {len(in_sets())} members are as a search finds them")
