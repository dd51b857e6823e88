"""Measures shortcuts on the test sets of intents, makes the demonstrations that the package ships, and a picture.

python -m tools.intents floors JOBS    writes magical_mj/intents/floors.json and a table in docs/intents-evaluation.md
python -m tools.intents picture        draws docs/intents.png
python -m tools.intents demonstrations 1000 JOBS
makes the first 1,000 of those of the test sets, and writes the file that
the package ships, and a table in docs/intents-evaluation.md; called again,
it continues. One second of a core each, and minutes for a few of them
"""

from __future__ import annotations

import itertools
import json
import lzma
import sys
from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from magical_mj.demos import stored
from magical_mj.engine import Engine
from magical_mj.intents.by_set import FLOORS, floors
from magical_mj.intents.draws import Draws, in_sets
from magical_mj.intents.expert_data import with_scenes
from magical_mj.intents.floors import shortcuts
from magical_mj.intents.given import DEMONSTRATIONS_GIVEN
from magical_mj.intents.intent import parse
from magical_mj.intents.names import TESTS, tasks_in
from magical_mj.intents.plans import planned
from magical_mj.intents.tasks import (
    PREFIX,
    spec_of,
    task_of,
)
from magical_mj.utils.errors import DemonstrationError
from tools.intent_criteria import SCENES, TEST_VARIANTS, test_scenes
from tools.pages import ROOT, filled
from tools.tables import table

MEASURED: Final = 5
"""The number of scenes of Layout, and of All, for measuring shortcuts. They are other scenes than those for
choosing the sets."""
GIVEN: Final = 4
"""The number of demonstrations that an intent should have in each kind of scenes."""
SHOWN: Final = (
    ("one scene", 1, False),
    ("four contrasting scenes", 4, True),
    ("four random scenes", 4, False),
)
"""The demo scenes of these demonstrations: a text, their number, and whether they are contrasting."""
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
    write_table("floors", floors_table())


def floors_table() -> str:
    """The shares of the test scenes that shortcuts solve, and the efforts, by set."""
    rows = [(name, *(f"{floors()[set_][name]:.2f}" for set_ in TESTS)) for name in floors()[TESTS[0]]]
    members = {name: [draws for draws in in_sets() if draws.set == name] for name in TESTS}
    for text, value in (("*blocks to move*", "moves"), ("*actions of a plan*", "cost"), ("*horizon*", "steps")):
        medians = [float(np.median([getattr(draws, value) for draws in members[name]])) for name in TESTS]
        rows.append((text, *(f"{median:.1f}" if value == "moves" else f"{median:.0f}" for median in medians)))
    return table(("Shortcut", *TESTS), rows)


def write_table(name: str, content: str) -> None:
    """Writes a table into docs/intents-evaluation.md. The table is named after the command."""
    page = ROOT / "docs" / "intents-evaluation.md"
    page.write_text(filled(page.read_text("utf-8"), {name: content}, f"python -m tools.intents {name}"), "utf-8")


# Demonstrations


class Wanted(NamedTuple):
    """A demonstration that the package should ship: its key, and that of the same one in a task with one demo scene."""

    key: stored.Key
    made: stored.Key


def wanted() -> Iterator[Wanted]:
    """Those of the test sets, the most needed first.

    For each intent four in one scene and four in contrasting ones; then for each four in random ones; then four more in
    one scene. The first is the same in all three, since the first demo scene is.
    """
    tasks = [f"{PREFIX}{task}" for each in zip(*map(tasks_in, TESTS), strict=True) for task in each]
    first = [(scenes, contrasting, range(GIVEN)) for _, scenes, contrasting in SHOWN]
    more = [(1, False, range(GIVEN, DEMONSTRATIONS_GIVEN))]
    for kinds in (first[:2], first[2:], more):
        for task, (scenes, contrasting, numbers) in itertools.product(tasks, kinds):
            for number in numbers:
                key = (with_scenes(task, scenes, contrasting=contrasting), "Demo", number)
                yield Wanted(key, key if number else (task, "Demo", 0))


def demonstrations(first: int, jobs: int) -> None:
    """Makes the first of the `wanted` demonstrations, and ships all that were made."""
    every = list(wanted())
    path = ROOT / "out" / "intents" / stored.default_path().name
    known = dict(stored.shipped())
    try:
        stored.complete(dict.fromkeys(one.made for one in every[:first]), path, known=known, jobs=jobs)
    except DemonstrationError as error:
        print(error, file=sys.stderr)
    made = {**known, **stored.read(path)}
    found = [msgspec.structs.replace(made[one.made], task=one.key[0]) for one in every if one.made in made]
    stored.shipped_path().write_bytes(lzma.compress(b"\n".join(map(msgspec.json.encode, found)), preset=9))
    print(f"{stored.shipped_path()}: {len(found)} of {len(every)} demonstrations")
    write_table("demonstrations", shipped_table({one.key for one in found}))


def shipped_table(keys: AbstractSet[stored.Key]) -> str:
    """The number of intents of each set that have four demonstrations, by their scenes, and eight in one scene."""
    rows = []
    kinds = [(*kind, GIVEN) for kind in SHOWN] + [("one scene, eight", 1, False, DEMONSTRATIONS_GIVEN)]
    for text, scenes, contrasting, given in kinds:
        counts = []
        for name in TESTS:
            tasks = (with_scenes(f"{PREFIX}{task}", scenes, contrasting=contrasting) for task in tasks_in(name))
            counts.append(str(sum(all((task, "Demo", number) in keys for number in range(given)) for task in tasks)))
        rows.append((text, *counts))
    return table(("Demonstrations in", *TESTS), rows)


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
        case ["demonstrations", first, jobs]:
            demonstrations(int(first), int(jobs))
        case ["picture"]:
            picture()
        case _:
            sys.exit(__doc__)
