"""Measures shortcuts on the test sets of intents, makes the demonstrations that the package ships, and a picture.

python -m tools.intents floors JOBS    writes magical_mj/intents/floors.json and a table in docs/intents-evaluation.md
python -m tools.intents picture        draws docs/intents.png
python -m tools.intents leave-out JOBS
replaces the further demo scenes of test sets that the expert cannot solve, in magical_mj/intents/sets.jsonl
python -m tools.intents demonstrations JOBS
makes those of the test sets, and writes the file that the package ships; called again, it continues.
One second of a core each, and minutes for a few of them
"""

from __future__ import annotations

import itertools
import json
import lzma
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import replace
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from magical_mj.demos import stored
from magical_mj.demos.recording import STRIDE
from magical_mj.engine import Engine
from magical_mj.experts import expert_of
from magical_mj.intents.by_set import FLOORS, floors
from magical_mj.intents.draws import Draws, in_sets
from magical_mj.intents.expert_data import with_scenes
from magical_mj.intents.floors import shortcuts
from magical_mj.intents.given import DEMONSTRATIONS_GIVEN
from magical_mj.intents.intent import parse
from magical_mj.intents.names import TESTS, tasks_in
from magical_mj.intents.plans import planned
from magical_mj.intents.tasks import PREFIX, Task, spec_of, task_of, with_further
from magical_mj.scene import Scene
from magical_mj.tasks.registry import sample_scene
from tools.intent_criteria import SCENES, TEST_VARIANTS, test_scenes
from tools.intent_sets import write_sets
from tools.pages import ROOT, filled
from tools.tables import table

MEASURED: Final = 5
"""The number of scenes of Layout, and of All, for measuring shortcuts. They are other scenes than those for
choosing the sets."""
PLAYS: Final = 3
"""The number of experts that try a further demo scene before it is replaced."""
GIVEN: Final = 4
"""The number of demonstrations that an intent should have in each kind of scenes."""
SHOWN: Final = ((1, False), (4, True), (4, False))
"""The demo scenes of these demonstrations: their number, and whether they are contrasting."""
PICTURED: Final = (
    "in(colour=red, region) & untouched(others)",
    "near(all, to=blue star)",
    "wall(nearest=region, left)",
    "line(all)",
)
"""The intents in the picture of the docs."""


# Floors


def satisfied(draws: Draws) -> dict[str, float]:
    """Shortcut -> how often its plan satisfies an intent: a share of some scenes."""
    intent, spec = task_of(draws.task).intent, spec_of(task_of(draws.task), draws)
    scenes = test_scenes(spec, SCENES + MEASURED)[-MEASURED * len(TEST_VARIANTS) :]
    return {
        name: float(np.mean([intent.holds(scene, shortcut.end(intent, spec.demo, scene)) for scene in scenes]))
        for name, shortcut in shortcuts.items()
    }


def write_floors(jobs: int) -> None:
    """Writes the file of floors, and the table of the docs."""
    tests = [draws for draws in in_sets() if draws.set in TESTS]
    with ProcessPoolExecutor(jobs) as pool:
        shares = list(pool.map(satisfied, tests))
    floors = {
        name: {
            shortcut: round(float(np.mean([share[shortcut] for share, draws in zip(shares, tests, strict=True)
                                           if draws.set == name])), 4)
            for shortcut in shortcuts
        }
        for name in TESTS
    }  # fmt: skip
    FLOORS.write_text(json.dumps(floors, indent=1) + "\n", encoding="utf-8")
    page = ROOT / "docs" / "intents-evaluation.md"
    tables = {"floors": floors_table()}
    page.write_text(filled(page.read_text("utf-8"), tables, "python -m tools.intents floors"), "utf-8")


def floors_table() -> str:
    """The shares of the test scenes that shortcuts solve, and the efforts, by set."""
    rows = [(name, *(f"{floors()[set_][name]:.2f}" for set_ in TESTS)) for name in floors()[TESTS[0]]]
    members = {name: [draws for draws in in_sets() if draws.set == name] for name in TESTS}
    for text, value in (("*blocks to move*", "moves"), ("*actions of a plan*", "cost"), ("*horizon*", "steps")):
        medians = [float(np.median([getattr(draws, value) for draws in members[name]])) for name in TESTS]
        rows.append((text, *(f"{median:.1f}" if value == "moves" else f"{median:.0f}" for median in medians)))
    return table(("Shortcut", *TESTS), rows)


# Demonstrations


class Wanted(NamedTuple):
    """A demonstration that the package should ship: its key, and that of the same one in a task with one demo scene."""

    key: stored.Key
    made: stored.Key


def demonstrable(draws: Draws) -> Draws:
    """The draws, without further demo scenes that the expert cannot solve."""
    for contrasting in (False, True):
        task = replace(task_of(draws.task), demos=GIVEN, contrasting=contrasting)
        while (failed := _failed(task, draws)) is not None:
            draws = msgspec.structs.replace(draws, left_out=(*draws.left_out, failed.digest()))
            draws = with_further(task, draws)
    return draws


def _failed(task: Task, draws: Draws) -> Scene | None:
    """The first further demo scene without a demonstration, shipped or played; None if all have one."""
    name = f"{PREFIX}{task}"
    for number, scene in enumerate(spec_of(task, draws).demos):
        known = stored.shipped().get((name, "Demo", number))
        if number and (known is None or known.scene != scene.digest()) and not _solved(name, number, scene):
            return scene
    return None


def _solved(task: str, number: int, scene: Scene) -> bool:
    """Whether one of the first experts that would demonstrate a scene solves it."""
    for attempt in range(PLAYS):
        with closing(Engine(task, "Demo", scene=scene)) as engine:
            expert = expert_of(engine, task, number + attempt * STRIDE)
            while not engine.step(expert()):
                pass
            if engine.score() == 1.0:
                return True
    return False


def leave_out(jobs: int) -> None:
    """Replaces the further demo scenes that the expert cannot solve."""
    every = in_sets()
    with ProcessPoolExecutor(jobs) as pool:
        tests = pool.map(demonstrable, (draws for draws in every if draws.set in TESTS))
        write_sets(next(tests) if draws.set in TESTS else draws for draws in every)


def wanted() -> Iterator[Wanted]:
    """Those of the test sets: for each intent four in each kind of scenes, and four more in one scene.

    The first is the same in all three kinds, since the first demo scene is.
    """
    tasks = [f"{PREFIX}{task}" for name in TESTS for task in tasks_in(name)]
    for task, (scenes, contrasting) in itertools.product(tasks, SHOWN):
        for number in range(GIVEN if scenes > 1 else DEMONSTRATIONS_GIVEN):
            key = (with_scenes(task, scenes, contrasting=contrasting), "Demo", number)
            yield Wanted(key, key if number else (task, "Demo", 0))


def demonstrations(jobs: int) -> None:
    """Makes the `wanted` demonstrations that the package does not have, and ships all."""
    every = list(wanted())
    path = ROOT / "out" / "intents" / stored.default_path().name
    known = {key: one for key, one in stored.shipped().items() if sample_scene(*key).digest() == one.scene}
    made = stored.complete((one.made for one in every), path, known=known, jobs=jobs)
    found = [msgspec.structs.replace(demo, task=one.key[0]) for one, demo in zip(every, made, strict=True)]
    stored.shipped_path().write_bytes(lzma.compress(b"\n".join(map(msgspec.json.encode, found)), preset=9))
    print(f"{stored.shipped_path()}: {len(found)} demonstrations")


# The picture


def picture() -> None:
    """Draws the initial scene of some intents, and the final scene of a plan, into docs/intents.png."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 5.6), layout="constrained")
    panels: Any = figure.subfigures(2, 2, wspace=0.04, hspace=0.04)
    for panel, text in zip(panels.flat, PICTURED, strict=True):
        intent = parse(text)
        start = intent.spec().demo
        panel.suptitle(f"{text}\n{intent.sentence}", fontsize=8)
        for axes, scene in zip(panel.subplots(1, 2), planned(intent, start), strict=True):
            with closing(Engine.of_scene(scene, renderer="software")) as engine:
                axes.imshow(engine.render("allo", 240))
            axes.set_axis_off()
    figure.savefig(ROOT / "docs" / "intents.png", dpi=100)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["floors", jobs]:
            write_floors(int(jobs))
        case ["leave-out", jobs]:
            leave_out(int(jobs))
        case ["demonstrations", jobs]:
            demonstrations(int(jobs))
        case ["picture"]:
            picture()
        case _:
            sys.exit(__doc__)
