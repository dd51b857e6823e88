"""Measures how ambiguous demonstrations are, for the eight tasks and intents of the test sets.

    python -m tools.ambiguity        writes a table in docs/rivals.md and the picture docs/intents-rivals.png

Plans replace demonstrations after the first scene, since rivals depend on the initial and the final scene only. An
intent of n bits has the weight 2 to the power of -n. The missing bits are the logarithm to base 2 of the weight of all
intents that are still possible, relative to that of the true one. It takes some minutes on one core.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Sequence
from functools import cache
from itertools import compress
from typing import Any, Final, NamedTuple

import numpy as np

from magical_mj.demos import load
from magical_mj.intents import EIGHT, Intent, rivals
from magical_mj.intents.ambiguity import Ends, Judge, all_conjuncts, ends_of
from magical_mj.intents.attribution import BITS
from magical_mj.intents.canonical import implies
from magical_mj.intents.contrast import contrasting_scenes, random_scene
from magical_mj.intents.intent import conjunct_bits, intent_bits
from magical_mj.intents.names import TESTS, tasks_in
from magical_mj.intents.plans import planned
from magical_mj.intents.relations import RELATIONS, Conjunct
from magical_mj.intents.scenes import colours_rule, count_rule, redrawn, shapes_rule
from magical_mj.intents.selectors import ALL, REST
from magical_mj.intents.tasks import Task, spec_of
from magical_mj.scene import Scene
from tools.tables import ROOT, filled, table

PICTURE: Final = ROOT / "docs" / "intents-rivals.png"
COMMAND: Final = "python -m tools.ambiguity"
SCENES: Final = 8
"""The largest number of demo scenes."""
EVERY: Final = 10
"""The curves are of each tenth intent of the test sets."""
STARTS: Final = 10
"""The number of initial scenes that a picture of a solved scene is judged with."""
START_RANGE: Final = 0.8
"""Blocks and the robot may have started within this square (half side, world units)."""
KINDS: Final = {
    "random": "random colours and poses",
    "wide": "random counts, shapes, colours and poses",
    "contrasting": "contrasting",
}


class Case(NamedTuple):
    """An intent, and what demonstrations in its first demo scene show."""

    intent: Intent
    first: tuple[Ends, ...]


class Left(NamedTuple):
    """What is still possible: the number of rivals, and the missing bits."""

    rivals: float
    bits: float


def eight() -> dict[str, Case]:
    """The benchmark's tasks, with the shipped demonstrations."""
    return {task: Case(intent, tuple(map(ends_of, load(task)))) for task, intent in EIGHT.items()}


def case_of(task: Task) -> Case:
    """A task of the sets, with the plan in its demo scene."""
    return Case(task.intent, (planned(task.intent, spec_of(task).demo),))


def sample() -> list[Case]:
    """Some of the test intents."""
    return [case_of(task) for name in TESTS for task in tasks_in(name)[::EVERY]]


def left(case: Case, possible: Iterable[Intent]) -> Left:
    """The intents that are still possible. The true one always is, also if it is longer than `BITS`."""
    bits = np.array([rival.bits for rival in possible if rival != case.intent])
    return Left(len(bits), float(np.log2(1.0 + np.exp2(case.intent.bits - bits).sum())))


def curve(case: Case, kind: str) -> list[Left]:
    """What demonstrations in 1 to `SCENES` demo scenes leave."""
    remaining = rivals(case.first, BITS)
    found = [left(case, remaining)]
    for scene in scenes(case, kind):
        remaining = list(compress(remaining, Judge(remaining).reached(*planned(case.intent, scene))))
        found.append(left(case, remaining))
    return found


def scenes(case: Case, kind: str) -> list[Scene]:
    """The demo scenes after the first."""
    rng, first = np.random.default_rng(0), case.first[0][0]
    if kind == "wide":
        rules = (count_rule, colours_rule, shapes_rule)
        return [redrawn(case.intent, rng, first, *rules) for _ in range(SCENES - 1)]
    if kind == "random":
        return [random_scene(case.intent, rng, first) for _ in range(SCENES - 1)]

    def rng_of(*numbers: int) -> np.random.Generator:
        return np.random.default_rng([0, *numbers])

    return contrasting_scenes(case.intent, rng_of, first, SCENES - 1)


def by_picture(case: Case) -> Left:
    """The intents that a picture of the solved scene leaves: the blocks may have started anywhere."""
    start, end = case.first[0]
    rng, shape = np.random.default_rng(0), (STARTS, len(end.blocks) + 1, 3)
    poses = rng.uniform(-START_RANGE, START_RANGE, shape).tolist()
    starts = [start, *(end.moved(robot, blocks) for robot, *blocks in poses)]
    return left(case, {rival for scene in starts for rival in rivals([(scene, end)], BITS)})


def by_sentence(case: Case) -> Left:
    """What the sentence leaves of the rivals after one demo scene."""
    return left(case, [rival for rival in rivals(case.first, BITS) if rival.sentence == case.intent.sentence])


@cache
def language() -> tuple[int, float]:
    """The number of intents of one or two relations and up to `BITS` bits, and the sum of their weights."""
    conjuncts = sorted(all_conjuncts(), key=conjunct_bits)
    bits = np.array([conjunct_bits(one) for one in conjuncts])
    lengths = [intent_bits([one]) for one in conjuncts if one.selector != REST and intent_bits([one]) <= BITS]
    for place, one in enumerate(conjuncts):
        end = int(np.searchsorted(bits, BITS - intent_bits([one]), side="right"))
        lengths += [intent_bits([one, other]) for other in conjuncts[place + 1 : end] if joined(one, other)]
    return len(lengths), float(np.exp2(-np.array(lengths)).sum())


def joined(one: Conjunct, other: Conjunct) -> bool:
    """Whether two relations make an intent."""
    if REST in (one.selector, other.selector):
        first = other if one.selector == REST else one
        return RELATIONS[first.relation].of_blocks and first.selector not in (ALL, REST)
    return not implies(one, other) and not implies(other, one)


def nothing(case: Case) -> Left:
    """The intents that are possible before anything is shown."""
    number, weight = language()
    return Left(number, math.log2(weight) + case.intent.bits)


def median(found: Sequence[Left]) -> list[str]:
    """The medians of the numbers of rivals and of the missing bits, as cells."""
    number = float(np.median([one.rivals for one in found]))
    cell = f"{number:,.0f}" if number.is_integer() else f"{number:,.1f}"
    return [cell, f"{np.median([one.bits for one in found]):.1f}"]


Curves = dict[str, list[list[Left]]]


def known() -> str:
    """Rivals left by each kind of evidence: medians over the eight tasks and a sample of intents. Draws the picture."""
    groups = [list(eight().values()), sample()]
    curves: list[Curves] = [{kind: [curve(case, kind) for case in group] for kind in KINDS} for group in groups]
    draw(curves, ["The eight tasks", f"{len(groups[1])} test intents"])
    rows = [
        ("nothing", *(cell for group in groups for cell in median(list(map(nothing, group))))),
        ("a picture of the solved scene", *(cell for group in groups for cell in median(list(map(by_picture, group))))),
        ("demonstrations in one scene", *(cell for one in curves for cell in median([c[0] for c in one["random"]]))),
    ]
    for kind, name in KINDS.items():
        cells = (cell for one in curves for cell in median([c[-1] for c in one[kind]]))
        rows.append((f"in {SCENES} scenes: {name}", *cells))
    rows.append(
        ("one scene and the sentence", *(cell for group in groups for cell in median(list(map(by_sentence, group)))))
    )
    head = ("Known", "Rivals, eight tasks", "Missing bits", f"Rivals, {len(groups[1])} intents", "Missing bits")
    return table(head, rows)


def draw(curves: Sequence[Curves], titles: Sequence[str]) -> None:
    """The picture: rivals left over the number of demo scenes, medians and quartiles."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    panels: Any = figure.subplots(1, len(curves), sharey=True)
    numbers = range(1, SCENES + 1)
    for axes, one, title in zip(panels, curves, titles, strict=True):
        for kind, name in KINDS.items():
            counts = np.array([[found.rivals for found in curve] for curve in one[kind]])
            low, middle, high = np.percentile(counts, [25, 50, 75], axis=0)
            (line,) = axes.plot(numbers, middle, marker="o", label=name)
            axes.fill_between(numbers, low, high, color=line.get_color(), alpha=0.15)
        axes.set_yscale("symlog", linthresh=1)
        axes.set_title(title)
        axes.set_xlabel("demo scenes")
        axes.grid(alpha=0.3)
    panels[0].set_ylabel(f"rivals left, of up to {BITS:.0f} bits")
    panels[0].set_ylim(bottom=0)
    panels[1].legend()
    figure.savefig(PICTURE, dpi=100)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    page = ROOT / "docs" / "rivals.md"
    tables = {"known": known()}
    page.write_text(filled(page.read_text("utf-8"), tables, COMMAND), "utf-8")
